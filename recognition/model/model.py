"""The point chain model, the result of recognition. Metres, radians, seconds, base frame."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length
from recognition.model.topology import PData, gauss_code, p_data
from recognition.parameters import ChainParameters

SCHEMA = "pointchain/1"

Method = Literal["matching", "enhanced", "graph"]
METHODS: tuple[Method, ...] = ("matching", "enhanced", "graph")

End = Literal["free", "unseen"]


@dataclass(frozen=True, eq=False)
class Chain:
    """One string as ordered points of its centre line."""

    id: int
    """Number of the chain in the model, from 0."""
    closed: bool
    """Whether the last point connects to the first."""
    radius_m: float
    """Radius of the string, metres."""
    points: NDArray[np.float64]
    """(N, 3) points of the centre line, metres, base frame, in order from one end to the other."""
    sigma_m: NDArray[np.float64]
    """(N,) one sigma of the position of each point across the string, metres."""
    views: NDArray[np.int64]
    """(N,) number of views that saw the string at each point; 0 = bridged, for example under a crossing."""
    ends: tuple[End, End]
    """First and last end. `free` if it was seen, `unseen` if the string left the workspace or could not be followed."""

    @property
    def arc_length_m(self) -> NDArray[np.float64]:
        """(N,) arc length of each point from the first one, metres."""
        return arc_length(self.points)

    @property
    def length_m(self) -> float:
        """Length of the chain, metres. For a closed chain, this includes the link from the last point to the first."""
        gap = float(np.linalg.norm(self.points[0] - self.points[-1])) if self.closed else 0.0
        return float(self.arc_length_m[-1]) + gap


@dataclass(frozen=True)
class StrandPoint:
    """A position on a chain."""

    chain: int
    """Id of the chain."""
    s_m: float
    """Arc length along the chain, metres."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """A crossing: one strand lies over another strand, of the same chain or of another one."""

    id: int
    """Number of the crossing in the model, from 0."""
    point: NDArray[np.float64]
    """(3,) midpoint between the two centre lines, metres, base frame."""
    over: StrandPoint
    """Position of the crossing on the upper strand."""
    under: StrandPoint
    """Position of the crossing on the lower strand."""
    gap_m: float
    """Measured height of the upper centre line above the lower one, metres."""
    angle_rad: float
    """Angle between the strands, seen from above, 0 to pi/2 radians."""
    sign: int
    """Right-handed crossing sign for the directions of the chains, +1 or -1."""
    confidence: float
    """Probability that `over` and `under` are not exchanged, 0.5 to 1."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """A pose in which a parallel gripper can grasp a string."""

    chain: int
    """Id of the chain."""
    s_m: float
    """Arc length along the chain, metres."""
    T_base_grasp: NDArray[np.float64]
    """(4, 4) grasp pose in the base frame. z is the approach, x the closing direction (across the string, to the left
    of the direction of the chain). The origin lies on the centre line. A rotation by pi about z gives the same
    grasp."""
    opening_m: float
    """Distance between the fingers before they close, metres."""
    reach_m: float
    """Distance of the fingertips beyond the origin, along z, metres."""
    clearance_m: float
    """Smallest distance of fingers and palm from other strands and objects during the approach, metres. Values above
    0.03 are given as 0.03."""
    table_clearance_m: float
    """Smallest distance of the fingertips from the table, metres."""
    score: float
    """Quality of the grasp, from 0 to 1 (best)."""


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
            "parameters": {_parameter_key(name): value for name, value in asdict(self.parameters).items()},
            "chains": [_chain_json(chain) for chain in self.chains],
            "crossings": [_crossing_json(crossing) for crossing in self.crossings],
            "topology": {"gauss_code": self.gauss_code(), "p_data": self.p_data().to_json()},
            "grasps": [_grasp_json(grasp) for grasp in self.grasps],
            "quality": asdict(self.quality),
            "timing_s": {stage: round(seconds, 6) for stage, seconds in self.timing_s.items()},
        }

    def gauss_code(self) -> list[list[list[Any]]]:
        """Return for each chain the crossings along it, in order: `[crossing id, "over" or "under", sign]`."""
        return gauss_code(self.chains, self.crossings)

    def p_data(self) -> PData:
        """Return the ends, crossings and segments, and the matrix that says which follows which."""
        return p_data(self.chains, self.crossings)


def _parameter_key(name: str) -> str:
    return name if name in ("rho_t", "R_t") else f"{name}_m"


def _chain_json(chain: Chain) -> dict[str, Any]:
    return {
        "id": chain.id,
        "closed": chain.closed,
        "radius_m": chain.radius_m,
        "length_m": round(chain.length_m, 6),
        "points": chain.points.round(6).tolist(),
        "arc_length_m": chain.arc_length_m.round(6).tolist(),
        "sigma_m": chain.sigma_m.round(6).tolist(),
        "views": chain.views.tolist(),
        "ends": list(chain.ends),
    }


def _crossing_json(crossing: Crossing) -> dict[str, Any]:
    return {
        "id": crossing.id,
        "point": crossing.point.round(6).tolist(),
        "over": {"chain": crossing.over.chain, "s_m": round(crossing.over.s_m, 6)},
        "under": {"chain": crossing.under.chain, "s_m": round(crossing.under.s_m, 6)},
        "gap_m": round(crossing.gap_m, 6),
        "angle_rad": round(crossing.angle_rad, 6),
        "sign": crossing.sign,
        "confidence": round(crossing.confidence, 4),
    }


def _grasp_json(grasp: Grasp) -> dict[str, Any]:
    T = grasp.T_base_grasp.round(9)
    T[:3, 3] = T[:3, 3].round(6)
    T += 0.0  # no -0.0
    return {
        "chain": grasp.chain,
        "s_m": round(grasp.s_m, 6),
        "T_base_grasp": T.tolist(),
        "opening_m": round(grasp.opening_m, 6),
        "reach_m": round(grasp.reach_m, 6),
        "clearance_m": round(grasp.clearance_m, 6),
        "table_clearance_m": round(grasp.table_clearance_m, 6),
        "score": round(grasp.score, 4),
    }
