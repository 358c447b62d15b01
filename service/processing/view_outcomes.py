"""Outcome of each view: whether recognition used it, and how far registration moved it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from recognition.result import Recognition


@dataclass(frozen=True)
class ViewOutcome:
    """Outcome of one view."""

    index: int
    """Index of the view."""
    exclusion_reason: Literal["empty", "inconsistent"] | None
    """Why the view was not used. None: it was used."""
    correction_m: float | None
    """Distance by which registration moved the view, metres. None: not registered."""
    correction_rad: float | None
    """Angle by which registration turned the view, radians. None: not registered."""


def view_outcomes(recognition: "Recognition") -> tuple[ViewOutcome, ...]:
    """Return the outcome of each view that recognition was given."""
    registered = recognition.registration
    compared = set() if registered is None else {view.index for view in registered.views}

    def exclusion_reason(index: int) -> Literal["empty", "inconsistent"]:
        return "inconsistent" if index in compared else "empty"

    return tuple(
        ViewOutcome(
            view.index, None if view.used else exclusion_reason(view.index), view.correction_m, view.correction_rad
        )
        for view in recognition.model.quality.views
    )
