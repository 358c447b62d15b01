"""Quality of a model: how each view was used, what could not be decided, and what looks wrong."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ViewQuality:
    """How recognition used one view."""

    index: int
    """Index of the view."""
    used: bool
    """Whether the view is part of the model."""
    reason: str | None
    """Why the view was excluded; None if it was used."""
    points: int
    """Number of points above the height threshold."""
    fitness: float | None = None
    """Share of the points that have a point of another view on the same surface within r, 0 to 1."""
    rms_m: float | None = None
    """Root mean square distance of these points from the surface of the other views, metres."""
    correction_m: float | None = None
    """Translation of the centroid of the view by alignment to the table and registration, metres."""
    correction_rad: float | None = None
    """Rotation of the view by alignment to the table and registration, radians."""


@dataclass(frozen=True)
class Quality:
    """Whether the model can be trusted. Read this before you use the rest of the model."""

    views: tuple[ViewQuality, ...] = ()
    """One entry per view, by index."""
    ambiguities: tuple[str, ...] = ()
    """Messages about undecided results, for example which strand of a crossing is over."""
    warnings: tuple[str, ...] = ()
    """Messages about excluded data and suspect values, for example a radius that differs from the given radius."""
