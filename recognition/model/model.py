"""The point chain model, the result of recognition. Metres, radians, seconds, base frame."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from recognition.model.chains import Chain, Crossing, Grasp
from recognition.model.document import (
    chain_document,
    crossing_document,
    grasp_document,
    p_data_document,
    parameters_document,
)
from recognition.model.topology import PData, gauss_code, p_data
from recognition.parameters import ChainParameters

SCHEMA = "pointchain/1"
"""Name and version of the JSON document."""

Method = Literal["matching", "enhanced", "graph"]
"""Name of a method. `matching` and `enhanced` are the methods of the paper."""
METHODS: tuple[Method, ...] = ("matching", "enhanced", "graph")
"""All methods."""


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
    """What could not be decided, for example which strand of a crossing is over."""
    warnings: tuple[str, ...] = ()
    """What was excluded, and what looks wrong, for example a radius that differs from the given one."""


@dataclass(frozen=True, eq=False)
class PointChainModel:
    """All strings of a scene, with their crossings and grasps.

    The fields have the names of the JSON document, with two differences. The document has `topology` in place of
    `gauss_code()` and `p_data()`. The names of its parameters have a unit (`r_m` in place of `r`).
    """

    method: Method
    """Method that made the model (`matching`, `enhanced` or `graph`)."""
    parameters: ChainParameters
    """Parameters that were used."""
    chains: tuple[Chain, ...] = ()
    """The strings, the longest first."""
    crossings: tuple[Crossing, ...] = ()
    """All crossings, numbered from 0."""
    quality: Quality = field(default_factory=Quality)
    """Views, ambiguities and warnings."""
    timing_s: Mapping[str, float] = field(default_factory=dict)
    """Duration of each stage, seconds."""
    frame: str = "base"
    """Frame of all coordinates."""
    grasps: tuple[Grasp, ...] = ()
    """Grasps on all chains, the best first."""

    def to_json(self) -> dict[str, Any]:
        """Return the model as a JSON document of schema `pointchain/1`.

        All numbers are finite. Positions and lengths are rounded to a micrometre.
        """
        return {
            "schema": SCHEMA,
            "frame": self.frame,
            "method": self.method,
            "parameters": parameters_document(self.parameters),
            "chains": [chain_document(chain) for chain in self.chains],
            "crossings": [crossing_document(crossing) for crossing in self.crossings],
            "topology": {"gauss_code": self.gauss_code(), "p_data": p_data_document(self.p_data())},
            "grasps": [grasp_document(grasp) for grasp in self.grasps],
            "quality": asdict(self.quality),
            "timing_s": {stage: round(seconds, 6) for stage, seconds in self.timing_s.items()},
        }

    def gauss_code(self) -> list[list[list[Any]]]:
        """Return for each chain the crossings along it, in order: `[crossing id, "over" or "under", sign]`."""
        return gauss_code(self.chains, self.crossings)

    def p_data(self) -> PData:
        """Return the ends, crossings and segments, and the matrix that says which follows which."""
        return p_data(self.chains, self.crossings)
