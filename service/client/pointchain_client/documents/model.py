"""The point chain model, schema `pointchain/2`. Metres, radians, seconds, base frame."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, TypeAlias

from pointchain_client.documents.decoding import (
    Counts,
    DecodeError,
    Joints,
    Matrix,
    Point,
    Points,
    Pose,
    Values,
    decode,
    derived,
)
from pointchain_client.documents.findings import Finding, Verdict
from pointchain_client.errors import ModelError

SCHEMA = "pointchain/2"
"""Name and version of the JSON document."""
FRAME = "base"
"""Frame of all points and poses."""
End: TypeAlias = str
"""Kind of an end of a chain.

`free`: the end of the string was observed. `unobserved`: the string may continue there. `touching`: the end faces
another end, and one string may continue there; or it meets the side of a strand, and may be joined to it.
"""
Interval: TypeAlias = tuple[float, float]
"""Arc lengths of the two ends of a part of a chain, metres."""


@dataclass(frozen=True, eq=False)
class Chain:
    """One string as ordered points of its centre line."""

    id: int
    """Number of the chain in the model, from 0."""
    closed: bool
    """Whether the string is a ring, so that the last point connects to the first, which is not repeated."""
    radius_m: float
    """Radius of the string, metres."""
    length_m: float
    """Length of the centre line, metres. For a ring, the length of the whole ring."""
    points: Points
    """(N, 3) points of the centre line, metres, base frame, in order from one end to the other."""
    arc_length_m: Values
    """(N,) arc length from the first point to each point, metres."""
    sigma_m: Values
    """(N,) standard deviation of the position of each point across the string, metres."""
    views: Counts
    """(N,) number of views that saw the string at each point; 0 where no view did, for example under a crossing."""
    ends: tuple[End, End]
    """Kinds of the first and the last end."""
    trust: Verdict
    """Verdict on this chain."""
    trusted_m: tuple[Interval, ...]
    """Parts of the chain without a doubt, as arc lengths of their start and end, metres."""

    def is_trusted(self, s_m: float) -> bool:
        """Return whether no doubt and no blocking finding concerns a position of the chain.

        Args:
            s_m: Arc length of the position, metres. Beyond an end of an open chain, the position is the end.
        """
        s_m = s_m % self.length_m if self.closed and self.length_m > 0 else min(max(s_m, 0.0), self.length_m)
        turns = (0.0, self.length_m) if self.closed else (0.0,)
        return math.isfinite(s_m) and not any(
            start <= s_m + turn <= stop for start, stop in self._doubtful_m() for turn in turns
        )

    def _doubtful_m(self) -> list[Interval]:
        """Return the parts between the trusted parts. A doubt includes the two ends of its part."""
        if not self.trusted_m:
            return [(0.0, self.length_m)]
        edges = [0.0, *(edge for part in self.trusted_m for edge in part), self.length_m]
        parts = list(zip(edges[::2], edges[1::2], strict=True))
        inner = parts[1:-1]
        return [*(part for part in (parts[0], parts[-1]) if part[0] < part[1]), *inner]


@dataclass(frozen=True)
class StrandPoint:
    """A position on a chain."""

    chain: int
    """Id of the chain."""
    s_m: float
    """Arc length from the first point of the chain, metres."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """Crossing of two strands, which may belong to the same chain."""

    id: int
    """Number of the crossing in the model, from 0."""
    point: Point
    """(3,) midpoint of the two centre lines at the crossing, metres, base frame."""
    over: StrandPoint
    """Position of the crossing on the upper strand."""
    under: StrandPoint
    """Position of the crossing on the lower strand."""
    gap_m: float
    """Height of the upper centre line above the lower one, metres."""
    angle_rad: float
    """Angle between the strands, seen from above, 0 to pi/2 radians."""
    sign: int
    """Crossing sign for the directions of the chains, +1 (right-handed) or -1 (left-handed)."""
    confidence: float
    """Probability that `over` and `under` are assigned correctly, 0.5 to 1."""
    trust: Verdict
    """Verdict on this crossing."""


@dataclass(frozen=True)
class GraspMotion:
    """Poses of the flange that carry out a grasp, as `T_base_flange`, (4, 4), metres.

    Move to `pregrasp`, open the gripper, move to `grasp` in a straight line, close, and move to `retreat` in a straight
    line.
    """

    pregrasp: Pose
    """Pose in front of the grasp, back along the approach direction."""
    grasp: Pose
    """Pose at the grasp."""
    retreat: Pose
    """Pose after the lift, back along the approach direction."""


@dataclass(frozen=True, eq=False)
class GraspReach:
    """Whether the arm can carry out a grasp, and with which joint angles."""

    reachable: bool
    """Whether a posture with a free, straight descent exists."""
    q_pregrasp_rad: Joints | None
    """(6,) joint angles at the pre-grasp, radians. None if the grasp is not reachable."""
    q_grasp_rad: Joints | None
    """(6,) joint angles at the grasp, radians, where a straight line of the flange from the pre-grasp ends. None if
    the grasp is not reachable."""
    turned: bool
    """Whether the gripper is turned by pi about its approach direction. `T_base_flange` of the grasp is turned, too."""
    path_free: bool | None
    """Whether the straight line in joint space from the home posture to the pre-grasp is free of collisions. None if
    the grasp is not reachable."""
    reason: str | None
    """Code of the reason why the grasp is not reachable, for example `collision-camera`. None if it is reachable."""
    message: str | None
    """The reason for people. None if the grasp is reachable."""


@dataclass(frozen=True)
class Grasp:
    """A pose in which the configured parallel gripper can grasp a string."""

    chain: int
    """Id of the chain."""
    s_m: float
    """Arc length along the chain, metres."""
    T_base_grasp: Pose
    """(4, 4) grasp pose in the base frame, metres. The origin lies on the centre line. z is the approach direction, and
    x is the closing direction: across the string, to the left of the chain direction. A rotation by pi about z gives an
    equivalent grasp."""
    opening_m: float
    """Distance between the fingers before they close, metres."""
    reach_m: float
    """Distance of the fingertips beyond the origin, along z, metres."""
    clearance_m: float
    """Minimum distance of fingers and palm from other strands and objects during the approach, metres. Distances
    above 0.03 are reported as 0.03."""
    table_clearance_m: float
    """Minimum distance of the fingertips from the table, or from an object under them, metres."""
    score: float
    """Quality of the grasp, from 0 to 1 (best)."""
    trusted: bool
    """Whether no doubt concerns the part of the string between the fingers."""
    id: int
    """Number of the grasp in the model, from 0. It is the index in the list."""
    cluster: int
    """Cluster of neighbouring grasps on a chain. Its first grasp is its best, and the others are within 20 mm of it
    along the string."""
    sigma_m: float
    """Largest sigma of the string between the fingers, metres."""
    end_distance_m: float | None
    """Distance to the nearest end along the string, metres. None on a ring."""
    over_distance_m: float | None
    """Distance along the string to the nearest crossing where it is the upper strand, metres, or None."""
    under_distance_m: float | None
    """Distance along the string to the nearest crossing where it is the lower strand, metres, or None."""
    chains_above: tuple[int, ...]
    """Chains that lie, or may lie, over this string within 60 mm of the grasp along it. A lift takes them along."""
    object_above_m: float | None
    """Height above the grasp of the lowest object that lies over this string within 60 mm of the grasp, metres. None if
    no object is in the way of a lift of 60 mm."""
    T_base_flange: GraspMotion
    """Poses of the flange that carry out the grasp."""
    reach: GraspReach | None = None
    """Whether the arm can carry out the grasp. None in models, and where the reach was not determined."""


@dataclass(frozen=True)
class ViewQuality:
    """How recognition used one view."""

    index: int
    """Index of the viewpoint."""
    used: bool
    """Whether the view is part of the model."""
    reason: str | None
    """Why the view was excluded; None if it was used."""
    code: str | None
    """Code of the finding on the view; None if it was used."""
    points: int
    """Number of points above the height threshold."""
    fitness: float | None
    """Share of these points that another view measured on the same surface, 0 to 1."""
    rms_m: float | None
    """Root mean square distance of these points from the surface of the other views, metres."""
    correction_m: float | None
    """Translation of the view from its pose by arm and hand-eye calibration, metres."""
    correction_rad: float | None
    """Rotation of the view from its pose by arm and hand-eye calibration, radians."""


@dataclass(frozen=True)
class Quality:
    """Whether the model can be trusted. Read this before you use the rest of the model."""

    verdict: Verdict
    """Verdict on the whole model."""
    findings: tuple[Finding, ...]
    """What was excluded, what is uncertain, and what must not be used, the most serious first."""
    views: tuple[ViewQuality, ...]
    """One entry per view, by index."""

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """The findings that are not notes."""
        return tuple(finding for finding in self.findings if finding.severity != "note")


@dataclass(frozen=True)
class EndElement:
    """One end of an open chain."""

    KIND: ClassVar[str] = "end"
    """Value of `kind`."""
    id: int
    """Index of the element."""
    kind: str
    """`end`."""
    chain: int
    """Id of the chain."""
    which: str
    """`first` or `last`."""
    s_m: float
    """Arc length of the end along the chain, metres."""
    end: End
    """Kind of the end, as in `Chain.ends`."""


@dataclass(frozen=True)
class CrossingElement:
    """A crossing, called "node" in the paper."""

    KIND: ClassVar[str] = "crossing"
    """Value of `kind`."""
    id: int
    """Index of the element."""
    kind: str
    """`crossing`."""
    crossing: int
    """Id of the crossing in the model."""
    sign: int
    """Crossing sign, +1 or -1."""
    over: StrandPoint
    """Position of the crossing on the upper strand."""
    under: StrandPoint
    """Position of the crossing on the lower strand."""


@dataclass(frozen=True)
class SegmentElement:
    """The part of a chain from one end or crossing pass to the next."""

    KIND: ClassVar[str] = "segment"
    """Value of `kind`."""
    id: int
    """Index of the element."""
    kind: str
    """`segment`."""
    chain: int
    """Id of the chain."""
    s_m: Interval
    """Arc lengths of its start and end, metres. The last segment of a ring ends beyond the length of the ring."""


@dataclass(frozen=True)
class OtherElement:
    """An element of a kind that this release of the client does not know."""

    id: int
    """Index of the element."""
    kind: str
    """Kind of the element."""


@dataclass(frozen=True, eq=False)
class PData:
    """P-data: ends, crossings and segments, and the order in which they follow one another along the chains."""

    elements: tuple[EndElement | CrossingElement | SegmentElement | OtherElement, ...]
    """The elements, by id."""
    matrix: Matrix
    """(E, E) successors of the E elements. `matrix[i, j]` is not 0 if element j follows element i. It is 1 at the over
    pass of a crossing, -1 at its under pass, and 2 at an end. A ring without crossings is one segment that follows
    itself, with 2."""


@dataclass(frozen=True, eq=False)
class Topology:
    """The topology of the strings, without lengths."""

    gauss_code: tuple[tuple[tuple[int, str, int], ...], ...]
    """For each chain, its crossings in order from its first point as (crossing id, `over` or `under`, sign)."""
    p_data: PData
    """P-data of the strings."""


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from. Values that are not known are None."""

    release: str | None
    """Release of Pointchain that made the model."""
    scan: str | None
    """Id of the scan in the service."""
    captured_at: str | None
    """Time of the last view, RFC 3339 in UTC. The model shows the scene at this moment."""
    recording_sha256: str | None
    """SHA-256 of the recording."""
    calibration_sha256: str | None
    """SHA-256 of the hand-eye calibration."""
    simulated: bool | None
    """Whether the arm or the camera was simulated."""
    intensity_views: int | None = None
    """Number of views that have an intensity image, or None in models of earlier releases."""


@dataclass(frozen=True, eq=False)
class ChainMatch:
    """A chain that is in both models."""

    chain: int
    """Id of the chain in the model now."""
    before: int
    """Id of the chain in the model before."""
    change: str
    """`unmoved`, `moved` with its shape, or `deformed`."""
    T_now_before: Pose
    """(4, 4) rigid motion, metres, base frame. It maps points of the string before to points now. The identity if the
    string is unmoved; an approximation if it is deformed."""
    rms_m: float
    """Root mean square distance of the lines after the motion, metres."""
    displacement_m: float
    """Largest distance of a point of the string before from the same point now, metres."""
    is_reversed: bool
    """Whether the chain now runs in the opposite direction."""
    s_offset_m: float
    """Arc length, on a ring now, of the first point before, metres. 0 on open chains."""
    confidence: float
    """Probability that it is the same string, 0 to 1."""


@dataclass(frozen=True, eq=False)
class Changes:
    """Changes since an earlier scan of the same table."""

    scan: str
    """Id of the earlier scan."""
    matches: tuple[ChainMatch, ...]
    """Chains in both models, in the order of their ids now."""
    new: tuple[int, ...]
    """Ids of the chains that are only in the model now."""
    gone: tuple[int, ...]
    """Ids of the chains that are only in the model before."""


@dataclass(frozen=True, eq=False)
class Model:
    """All strings of a scene as ordered point chains, with their crossings and grasps.

    Each field is the member of the JSON document with the same name.
    """

    schema: str
    """Name and version of the document."""
    frame: str
    """Frame of all points and poses, `base`."""
    method: str
    """Method that made the model."""
    parameters: Mapping[str, float]
    """Values of the method parameters. Each key is a symbol of the paper with a unit suffix, for example `r_m`."""
    chains: tuple[Chain, ...]
    """The strings, in the order of `x + y / 2` of their means."""
    crossings: tuple[Crossing, ...]
    """All crossings of two strands."""
    topology: Topology
    """Gauss code and P-data."""
    grasps: tuple[Grasp, ...]
    """Grasps on all chains, the best first."""
    quality: Quality
    """Verdict, findings and views."""
    timing_s: Mapping[str, float]
    """Duration of each stage, seconds."""
    provenance: Provenance | None = None
    """Where the model comes from. None if recognition was called as a library."""
    since: Changes | None = None
    """Changes since an earlier scan. None unless the request asked for them."""
    document: Mapping[str, Any] = derived(default_factory=dict, repr=False)
    """The JSON document that the model was read from."""

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Return the model of a JSON document.

        Args:
            document: The document. Unknown members are ignored.

        Raises:
            ModelError: The document is not a model of schema `pointchain/2`, or it contradicts itself. The message
                names the member at fault.
        """
        try:
            if not isinstance(document, Mapping):
                raise DecodeError(f"the document must be an object, not {type(document).__name__}")
            schema = document.get("schema")
            if isinstance(schema, str) and schema != SCHEMA:
                raise DecodeError(f"the document is of schema {schema!r}; this version of the client reads {SCHEMA!r}")
            model = decode(cls, document)
            _check(model)
        except DecodeError as error:
            raise ModelError(f"not a point chain model: {error}") from error
        return replace(model, document=document)

    def chain(self, chain: int) -> Chain:
        """Return a chain by its id.

        Raises:
            KeyError: The model has no chain with this id.
        """
        for found in self.chains:
            if found.id == chain:
                return found
        raise KeyError(f"the model has no chain with the id {chain}; it has {[found.id for found in self.chains]}")

    def trusted(self, chain: int, s_m: float | None = None) -> bool:
        """Return whether a program may act on a chain, or on a position of a chain, without a person.

        Args:
            chain: Id of the chain.
            s_m: Arc length of the position, metres. None: the verdict on the whole chain must be `accept`.

        Raises:
            KeyError: The model has no chain with this id.
        """
        found = self.chain(chain)
        return found.trust == "accept" if s_m is None else found.is_trusted(s_m)


def _check(model: Model) -> None:
    """Raise DecodeError if a model has another frame, or if it contradicts itself."""
    if model.frame != FRAME:
        raise DecodeError(f"the member frame must be {FRAME}, not {model.frame!r}")
    for chain in model.chains:
        lengths = [len(values) for values in (chain.points, chain.arc_length_m, chain.sigma_m, chain.views)]
        if len(set(lengths)) > 1:
            raise DecodeError(
                f"chain {chain.id} has {lengths[0]} points, {lengths[1]} arc lengths, {lengths[2]} sigmas and "
                f"{lengths[3]} view counts; the numbers must be equal"
            )
    known = {chain.id for chain in model.chains}
    referred = {position.chain for crossing in model.crossings for position in (crossing.over, crossing.under)}
    referred |= {grasp.chain for grasp in model.grasps}
    referred |= {chain for finding in model.quality.findings for chain in finding.chains}
    if not referred <= known:
        raise DecodeError(f"the model refers to chains that it does not have: {sorted(referred - known)}")
    named = {finding.crossing for finding in model.quality.findings if finding.crossing is not None}
    if missing := sorted(named - {crossing.id for crossing in model.crossings}):
        raise DecodeError(f"the model refers to crossings that it does not have: {missing}")
