"""The point chain model: what recognition answers with. Metres, radians, seconds, base frame."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters
from recognition.polyline import arc_length
from recognition.topology import PData, gauss_code, p_data

SCHEMA = "pointchain/1"

Method = Literal["matching", "enhanced", "graph"]
METHODS: tuple[Method, ...] = ("matching", "enhanced", "graph")

End = Literal["free", "unseen"]


@dataclass(frozen=True, eq=False)
class Chain:
    """One string as ordered points of its centre line."""

    id: int
    closed: bool
    """The last point connects to the first."""
    radius_m: float
    points: NDArray[np.float64]
    """(N, 3), from one end to the other, about r_n apart."""
    sigma_m: NDArray[np.float64]
    """(N,), one sigma of each point's position across the string."""
    views: NDArray[np.int64]
    """(N,), how many views saw the string there; 0 = bridged under a crossing."""
    ends: tuple[End, End]
    """`free`: a real end was seen; `unseen`: it left the workspace or could not be followed."""

    @property
    def arc_length_m(self) -> NDArray[np.float64]:
        """(N,), distance of each point from the first, along the chain."""
        return arc_length(self.points)

    @property
    def length_m(self) -> float:
        """Length of the chain; of a closed one, all the way round."""
        gap = float(np.linalg.norm(self.points[0] - self.points[-1])) if self.closed else 0.0
        return float(self.arc_length_m[-1]) + gap


@dataclass(frozen=True)
class StrandPoint:
    """A place on a chain."""

    chain: int
    """The chain's id."""
    s_m: float
    """Arc length along it."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """Two strands lying over one another."""

    id: int
    point: NDArray[np.float64]
    """(3,), between the two centre lines."""
    over: StrandPoint
    under: StrandPoint
    gap_m: float
    """Measured height of the over strand's centre line above the under strand's."""
    angle_rad: float
    """Between the strands seen from above, 0 to pi/2."""
    sign: int
    """Right-handed crossing sign for the chains' directions, +1 or -1."""
    confidence: float
    """That over and under are the right way round, 0.5 to 1."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """A place where a parallel gripper can take a string."""

    chain: int
    """The chain's id."""
    s_m: float
    """Arc length along it."""
    T_base_grasp: NDArray[np.float64]
    """(4, 4): z = approach, x = closing direction (across the string, to the left of the chain's direction), origin
    on the centre line. Turned by pi about z it is the same grasp."""
    opening_m: float
    """Between the fingers before they close."""
    reach_m: float
    """How far the fingertips go beyond the origin, along z."""
    clearance_m: float
    """Least distance of fingers and palm on their way from other strands and things; at most 30 mm is told."""
    table_clearance_m: float
    """Least distance of the fingertips from the table."""
    score: float
    """0 to 1, the best 1."""


@dataclass(frozen=True)
class ViewQuality:
    """What became of one view."""

    index: int
    used: bool
    reason: str | None
    """Why it was left out."""
    points: int
    """Points of the string's height that it gave."""
    fitness: float | None = None
    """Share of its points beside which, within r, another view has measured the same surface."""
    rms_m: float | None = None
    """Root mean square distance of those from the other views' surface."""
    correction_m: float | None = None
    """How far levelling and registration moved it from where arm and hand-eye calibration put it, at its centroid."""
    correction_rad: float | None = None


@dataclass(frozen=True)
class Quality:
    """How far the model can be trusted."""

    views: tuple[ViewQuality, ...] = ()
    ambiguities: tuple[str, ...] = ()
    """What could not be decided."""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class PointChainModel:
    """All strings of a scene, with their crossings.

    The fields are those of the JSON document, whose `topology` is `gauss_code()` and `p_data()` here, and whose
    `parameters` have no unit in their names here (`parameters.r`).
    """

    method: Method
    parameters: ChainParameters
    chains: tuple[Chain, ...] = ()
    crossings: tuple[Crossing, ...] = ()
    quality: Quality = field(default_factory=Quality)
    timing_s: Mapping[str, float] = field(default_factory=dict)
    frame: str = "base"
    grasps: tuple[Grasp, ...] = ()
    """The best first."""

    def to_json(self) -> dict[str, Any]:
        """The model as the JSON document of schema `pointchain/1`: only finite numbers, places to a micrometre."""
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
        """For each chain the crossings it meets in order: `[crossing id, "over" or "under", sign]`."""
        return gauss_code(self.chains, self.crossings)

    def p_data(self) -> PData:
        """Ends, crossings and segments, and the matrix of which follows which."""
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
