"""The JSON document of a model, schema `pointchain/2`: the one definition for writing, reading and OpenAPI.

Each class reads the fields of the dataclass that it describes. Positions and lengths are rounded to a micrometre.
Topology and verdicts are computed from the rounded numbers, so a model that is read gives the same document again.
Documents may gain members, and readers must ignore the members that they do not know.
"""

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field
from pydantic.json_schema import SkipJsonSchema

from recognition.model.chains import Chain, Crossing, End, StrandPoint, WrittenLengths
from recognition.model.changes import Change, ModelChanges
from recognition.model.finding_types import FindingCode, Severity
from recognition.model.findings import Finding, Which
from recognition.model.grasps import Grasp, GraspMotion
from recognition.model.provenance import Provenance
from recognition.model.quality import Quality, ViewQuality
from recognition.model.topology import CrossingElement, Element, EndElement, PData, Role, SegmentElement
from recognition.model.trust import ChainTrust, Interval, Verdict
from recognition.parameters import ChainParameters

WITHOUT_UNIT = ("rho_t", "R_t")
"""Parameters without a unit. The names of the others get the unit in the document (`r_m`)."""
ELEMENT_KINDS: dict[type[Element], str] = {EndElement: "end", CrossingElement: "crossing", SegmentElement: "segment"}
"""Kind of each element of P-data in the document."""


def _rounded(decimals: int) -> BeforeValidator:
    """Return a validator that rounds numbers, and turns arrays into rounded lists. -0.0 becomes 0.0."""

    def to_json_values(value: Any) -> Any:
        match value:
            case np.ndarray():
                return (value.round(decimals) + 0).tolist()
            case float():
                return round(value, decimals) + 0
        return value

    return BeforeValidator(to_json_values)


def _pose_rows(value: Any) -> Any:
    """Turn a pose into rows, its rotation rounded to 9 decimals and its position to a micrometre."""
    if not isinstance(value, np.ndarray):
        return value
    T = value.round(9)
    T[:3, 3] = T[:3, 3].round(6)
    T += 0.0  # turns -0.0 into 0.0
    return T.tolist()


def _round_each(values: Any) -> Any:
    """Round each number of nested sequences to a micrometre. None stays None, and -0.0 becomes 0.0."""
    match values:
        case list() | tuple():
            return [_round_each(value) for value in values]
        case float():
            return round(values, 6) + 0
    return values


ROUNDED_EACH = BeforeValidator(_round_each)


def _is_absent(value: Any) -> bool:
    """Return whether a member does not apply, so that the document omits it."""
    return value is None or value == ()


def _remove_default(schema: dict[str, Any]) -> None:
    """Remove the default of an optional member from its JSON schema, because the document never has null there."""
    schema.pop("default", None)


def _optional() -> Any:
    """Return a field that the document omits if it does not apply."""
    return Field(default=None, exclude_if=_is_absent, json_schema_extra=_remove_default)


Rounded = Annotated[float, _rounded(6)]
"""A number rounded to a micrometre, microradian or microsecond."""
Share = Annotated[float, Field(ge=0, le=1), _rounded(4)]
Code = Annotated[str, Field(json_schema_extra={"enum": list(get_args(FindingCode))})]
"""Code of a finding. A document of a later version may have other codes."""
Point = tuple[float, float, float]
"""x, y, z, metres, base frame."""
Sign = Literal[-1, 1]
Row = tuple[float, float, float, float]


class _Document(BaseModel):
    model_config = ConfigDict(extra="allow", from_attributes=True, use_attribute_docstrings=True, allow_inf_nan=False)

    def _values(self, dataclass: type, **converted: Any) -> dict[str, Any]:
        """Return the values of all fields of a dataclass by name. `converted` values replace those of the document."""
        names = {field.name for field in fields(dataclass)} - converted.keys()
        return {name: getattr(self, name) for name in names} | converted


class ChainDocument(_Document):
    """One string as ordered points of its centre line."""

    id: int
    """Number of the chain in the model, from 0."""
    closed: bool
    """A ring: the last point connects to the first, which is not repeated."""
    radius_m: Rounded
    """Radius of the string: the given radius, or the measured one if the data contradict the given one, metres."""
    length_m: Rounded
    """Length of the centre line, metres. For a ring, the length of the whole ring."""
    points: Annotated[list[Point], _rounded(6)]
    """Points of the centre line, from one end to the other, metres, base frame."""
    arc_length_m: Annotated[list[float], _rounded(6)]
    """Distance of each point from the first one along the chain, metres. The first is 0."""
    sigma_m: Annotated[list[float], _rounded(6)]
    """One sigma of the position of each point across the string, metres."""
    views: Annotated[list[int], _rounded(0)]
    """Number of views that saw the string at each point. 0: the point is bridged."""
    ends: tuple[End, End]
    """First and last end. `free`: the string was seen to end there. `unobserved`: it may continue there. `touching`: it
    faces another end, and one string may continue there; or it meets the side of a strand, and may be joined to it."""
    trust: Verdict
    """Verdict on this chain. `accept`: act. `review`: act on the trusted parts only. `refuse`: do not act."""
    trusted_m: Annotated[list[Interval], ROUNDED_EACH]
    """Parts of the chain without a doubt, as arc lengths of their start and end, metres."""

    @classmethod
    def of(cls, chain: Chain, trust: ChainTrust) -> "ChainDocument":
        """Return the document of a chain."""
        verdicts = {"trust": trust.verdict, "trusted_m": trust.trusted_m}
        names = cls.model_fields.keys() - verdicts.keys()
        return cls.model_validate({name: getattr(chain, name) for name in names} | verdicts)

    def to_chain(self) -> Chain:
        """Return the chain with arrays.

        Raises:
            ValueError: The numbers of points, arc lengths, sigmas and view counts differ.
        """
        if not len(self.points) == len(self.arc_length_m) == len(self.sigma_m) == len(self.views):
            raise ValueError(
                f"chain {self.id} has {len(self.points)} points, {len(self.arc_length_m)} arc lengths, "
                f"{len(self.sigma_m)} sigmas and {len(self.views)} view counts; the numbers must be equal"
            )
        values = self._values(
            Chain,
            points=np.array(self.points, dtype=np.float64).reshape(-1, 3),
            sigma_m=np.array(self.sigma_m, dtype=np.float64),
            views=np.array(self.views, dtype=np.int64),
            written_lengths=WrittenLengths(np.array(self.arc_length_m, dtype=np.float64), self.length_m),
        )
        return Chain(**values)


class StrandPointDocument(_Document):
    """A position on a chain."""

    chain: int
    """Id of the chain."""
    s_m: Rounded
    """Arc length from the first point of the chain, metres."""

    def to_strand_point(self) -> StrandPoint:
        """Return the position."""
        return StrandPoint(self.chain, self.s_m)


class CrossingDocument(_Document):
    """A crossing of two strands, of two chains or of the same chain."""

    id: int
    """Number of the crossing in the model, from 0."""
    point: Annotated[Point, _rounded(6)]
    """Midpoint between the two centre lines, metres, base frame."""
    over: StrandPointDocument
    """Position on the upper strand."""
    under: StrandPointDocument
    """Position on the lower strand."""
    gap_m: Rounded
    """Height of the upper centre line above the lower one, metres."""
    angle_rad: Rounded
    """Angle between the strands, seen from above, 0 to pi / 2 radians."""
    sign: Sign
    """Right-handed crossing sign. 1: the lower strand goes from right to left, seen along the upper one."""
    confidence: Share
    """Probability that over and under are right."""
    trust: Verdict
    """Verdict on this crossing. `review`: which strand is over, or how the strands continue, is not certain."""

    @classmethod
    def of(cls, crossing: Crossing, verdict: Verdict) -> "CrossingDocument":
        """Return the document of a crossing."""
        values = {field.name: getattr(crossing, field.name) for field in fields(crossing)}
        return cls.model_validate(values | {"trust": verdict})

    def to_crossing(self) -> Crossing:
        """Return the crossing with arrays."""
        values = self._values(
            Crossing,
            point=np.array(self.point, dtype=np.float64),
            over=self.over.to_strand_point(),
            under=self.under.to_strand_point(),
        )
        return Crossing(**values)


class EndElementDocument(_Document):
    """One end of an open chain."""

    id: int
    kind: Literal["end"]
    chain: int
    which: Literal["first", "last"]
    s_m: Rounded
    end: End


class CrossingElementDocument(_Document):
    """A crossing, the node of two passes."""

    id: int
    kind: Literal["crossing"]
    crossing: int
    """Id of the crossing in the model."""
    sign: Sign
    over: StrandPointDocument
    under: StrandPointDocument


class SegmentElementDocument(_Document):
    """The part of a string from one end or crossing pass to the next."""

    id: int
    kind: Literal["segment"]
    chain: int
    s_m: tuple[Rounded, Rounded]
    """Arc lengths of its start and end, metres. The last segment of a ring ends beyond the length of the ring."""


class PDataDocument(_Document):
    """Elements and the order in which they follow one another along the chains.

    matrix[i][j] is not 0 if element j follows element i: 1 at the over pass of a crossing, -1 at its under pass, 2 at
    an end. A ring without crossings is one segment that follows itself, with 2.
    """

    elements: list[
        Annotated[EndElementDocument | CrossingElementDocument | SegmentElementDocument, Field(discriminator="kind")]
    ]
    """`id` is the index in this list, and the row and the column of the matrix."""
    matrix: list[list[Annotated[int, Field(ge=-1, le=2)]]]


class TopologyDocument(_Document):
    """The topology of the strings, without lengths."""

    gauss_code: list[list[tuple[int, Role, Sign]]]
    """For each chain, its crossings in order from its first point: (crossing id, role, sign)."""
    p_data: PDataDocument


class GraspMotionDocument(_Document):
    """Poses of the flange that carry out a grasp, `T_base_flange`, metres.

    Move to `pregrasp`, open the gripper, move to `grasp` in a straight line, close, and move to `retreat` in a straight
    line. The gripper has the length and the mounting of the configuration.
    """

    pregrasp: Annotated[tuple[Row, Row, Row, Row], BeforeValidator(_pose_rows)]
    """In front of the grasp, back along the approach direction."""
    grasp: Annotated[tuple[Row, Row, Row, Row], BeforeValidator(_pose_rows)]
    """At the grasp."""
    retreat: Annotated[tuple[Row, Row, Row, Row], BeforeValidator(_pose_rows)]
    """After the lift, back along the approach direction."""

    def to_motion(self) -> GraspMotion:
        """Return the poses as arrays."""
        return GraspMotion(*(np.array(T, dtype=np.float64) for T in (self.pregrasp, self.grasp, self.retreat)))


class GraspDocument(_Document):
    """A pose in which the gripper of the scan can grasp a string."""

    id: int
    """Number of the grasp in the model, from 0. It is the index in the list."""
    cluster: int
    """Cluster of neighbouring grasps on a chain. Its first grasp is its best, and the others are within 20 mm of it
    along the string. The best grasps of different clusters are at least 20 mm apart."""
    chain: int
    """Id of the chain."""
    s_m: Rounded
    """Arc length from the first point of the chain, metres."""
    T_base_grasp: Annotated[tuple[Row, Row, Row, Row], BeforeValidator(_pose_rows)]
    """Pose of the gripper: z = approach, x = closing direction, origin on the centre line."""
    opening_m: Rounded
    """Distance between the fingers before they close, metres."""
    reach_m: Rounded
    """Distance of the fingertips beyond the origin, along z, metres."""
    clearance_m: Rounded
    """Smallest distance of fingers and palm from other strands and objects during the approach, metres. 0.03 means
    0.03 or more."""
    table_clearance_m: Rounded
    """Smallest distance of the fingertips from the table, or from an object under them, metres."""
    score: Share
    """Quality of the grasp, 1 is best. It considers clearance, views, sigma, bend and slope of the string, distances
    from ends and crossings, and tilt, depth, opening and distance from the floor of the fingers."""
    trusted: bool
    """False if a doubt concerns the string between the fingers. Such grasps are only listed on request."""
    sigma_m: Rounded
    """Largest sigma of the string between the fingers, metres."""
    end_distance_m: Rounded | None
    """Distance to the nearest end along the string, metres. Null on a ring."""
    over_distance_m: Rounded | None
    """Distance along the string to the nearest crossing where it is the upper strand, metres. Null if there is none."""
    under_distance_m: Rounded | None
    """Distance along the string to the nearest crossing where it is the lower strand, metres. Null if there is none."""
    chains_above: tuple[int, ...]
    """Chains that lie, or may lie, over this string within 60 mm of the grasp along it. A lift takes them along."""
    object_above_m: Rounded | None
    """Height above the grasp of the lowest object that lies over this string within 60 mm of the grasp, metres. A lift
    of this height touches it. Null if no object is in the way of a lift of 60 mm."""
    T_base_flange: GraspMotionDocument
    """Poses of the flange that carry out the grasp."""

    def to_grasp(self) -> Grasp:
        """Return the grasp with arrays."""
        values = self._values(
            Grasp,
            T_base_grasp=np.array(self.T_base_grasp, dtype=np.float64),
            T_base_flange=self.T_base_flange.to_motion(),
        )
        return Grasp(**values)


class ViewQualityDocument(_Document):
    """How recognition used one view."""

    index: int
    """Index of the viewpoint."""
    used: bool
    """Whether the view is part of the model."""
    reason: str | None
    """Why the view was excluded; null if it was used."""
    code: Code | None
    """Code of the finding on the view; null if it was used."""
    points: int
    """Number of points above the height threshold."""
    fitness: Rounded | None
    """Share of these points that another view measured on the same surface."""
    rms_m: Rounded | None
    """Root mean square distance of these points from the surface of the other views, metres."""
    correction_m: Rounded | None
    """Translation of the view from its pose by arm and hand-eye calibration, metres."""
    correction_rad: Rounded | None
    """Rotation of the view from its pose by arm and hand-eye calibration, radians."""

    def to_view_quality(self) -> ViewQuality:
        """Return the quality of the view."""
        return ViewQuality(**self._values(ViewQuality))


class FindingDocument(_Document):
    """One statement about the model. Members that do not apply are absent."""

    code: Code
    """Machine-readable code. Later versions may add codes: decide by `severity` if a code is unknown."""
    severity: Severity
    """`note` changes nothing, `doubt` may be otherwise, and `blocking` must not be acted on."""
    message: str
    """Description for people. Its text may change."""
    chains: tuple[int, ...] | SkipJsonSchema[None] = _optional()
    """Ids of the chains that the finding concerns. Absent: something outside all chains, or the whole model."""
    crossing: int | SkipJsonSchema[None] = _optional()
    """Id of the crossing that the finding concerns."""
    end: Which | SkipJsonSchema[None] = _optional()
    """End of the chain that the finding concerns."""
    s_range_m: Annotated[list[float], Field(min_length=2, max_length=2), ROUNDED_EACH] | SkipJsonSchema[None] = (
        _optional()
    )
    """Part of the chain that the finding concerns, as arc lengths, metres. It may exceed the length of a ring."""
    point_m: Annotated[list[float], Field(min_length=3, max_length=3), ROUNDED_EACH] | SkipJsonSchema[None] = (
        _optional()
    )
    """Position, metres, base frame."""
    view: int | SkipJsonSchema[None] = _optional()
    """Index of the view that the finding concerns."""
    value: Rounded | SkipJsonSchema[None] = _optional()
    """Measured value that led to the finding. The code determines its meaning and unit."""
    limit: Rounded | SkipJsonSchema[None] = _optional()
    """Limit of the value, in the same unit."""

    def to_finding(self) -> Finding:
        """Return the finding."""
        s_range_m = None if self.s_range_m is None else tuple(self.s_range_m)
        point_m = None if self.point_m is None else tuple(self.point_m)
        return Finding(**self._values(Finding, chains=self.chains or (), s_range_m=s_range_m, point_m=point_m))


def finding_json(finding: Finding) -> dict[str, Any]:
    """Return a finding as JSON values, in the form of the model document."""
    return FindingDocument.model_validate(finding).model_dump(mode="json")


class QualityDocument(_Document):
    """Whether the model can be trusted."""

    verdict: Verdict
    """Verdict on the whole model: `refuse` with a blocking finding on the whole model, `review` with another blocking
    finding or a doubt, otherwise `accept`."""
    findings: list[FindingDocument]
    """What was excluded, what is uncertain, and what must not be used, the most serious first."""
    views: list[ViewQualityDocument]
    """One entry per view, by index."""

    def to_quality(self) -> Quality:
        """Return the quality of the model."""
        views = tuple(view.to_view_quality() for view in self.views)
        return Quality(views, tuple(found.to_finding() for found in self.findings))


class ChainMatchDocument(_Document):
    """A chain that is in both models."""

    chain: int
    """Id of the chain in this model."""
    before: int
    """Id of the chain in the earlier model."""
    change: Change
    """`unmoved`, `moved` with its shape, or `deformed`."""
    T_now_before: Annotated[tuple[Row, Row, Row, Row], BeforeValidator(_pose_rows)]
    """Rigid motion in the table plane that maps points of the string before to points now. The identity if it is
    unmoved, and an approximation if it is deformed."""
    rms_m: Rounded
    """Root mean square distance of the lines after the motion, metres."""
    displacement_m: Rounded
    """Largest distance of a point of the string before from the same point now, metres."""
    is_reversed: bool
    """True: the chain now runs in the opposite direction, so `s_m` now is `length_m - s_m` before on open chains."""
    s_offset_m: Rounded
    """Arc length, on a ring now, of the first point before, metres. 0 on open chains."""
    confidence: Share
    """Probability that it is the same string."""


class ChangesDocument(_Document):
    """Changes since an earlier scan."""

    scan: str
    """Id of the earlier scan."""
    matches: list[ChainMatchDocument]
    """Chains in both models."""
    new: list[int]
    """Ids of chains in this model only."""
    gone: list[int]
    """Ids of chains in the earlier model only."""

    @classmethod
    def of(cls, changes: ModelChanges, scan: str) -> "ChangesDocument":
        """Return the document of the changes since a scan."""
        return cls.model_validate({"scan": scan, "matches": changes.matches, "new": changes.new, "gone": changes.gone})


class ProvenanceDocument(_Document):
    """Where a model comes from. Null where it is not known."""

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
    intensity_views: int | SkipJsonSchema[None] = _optional()
    """Number of views that have an intensity image. Absent in models of earlier releases."""

    def to_provenance(self) -> Provenance:
        """Return the provenance."""
        return Provenance(**self._values(Provenance))


class ModelDocument(_Document):
    """All strings of a scene as ordered point chains, with their crossings and grasps."""

    schema_: Literal["pointchain/2"] = Field(alias="schema")
    frame: Literal["base"]
    """The frame of all points and poses: the base of the robot."""
    method: str
    """Method that made the model."""
    parameters: dict[str, float]
    """Values of the method parameters. Each key is a symbol of the paper with a unit suffix, for example `r_m`."""
    chains: list[ChainDocument]
    """The strings, in the order of `x + y / 2` of their means."""
    crossings: list[CrossingDocument]
    """All crossings of two strands."""
    topology: TopologyDocument
    grasps: list[GraspDocument]
    """Grasps on all chains. First comes the best grasp of each cluster, then all others, each part sorted by score."""
    quality: QualityDocument
    timing_s: dict[str, Rounded]
    """Duration of each stage, seconds."""
    provenance: ProvenanceDocument | SkipJsonSchema[None] = _optional()
    """Where the model comes from. Absent if recognition was called as a library."""
    since: ChangesDocument | SkipJsonSchema[None] = _optional()
    """Changes since an earlier scan. Absent unless the request asks for them."""


def parameters_document(parameters: ChainParameters) -> dict[str, float]:
    """Return the parameters with their units in the keys (`r_m`)."""
    return {name if name in WITHOUT_UNIT else f"{name}_m": value for name, value in asdict(parameters).items()}


def parameters_from_document(document: Mapping[str, float]) -> ChainParameters:
    """Return the parameters of a document.

    Raises:
        InvalidParametersError: A value breaks a condition of Table I.
        TypeError: A parameter is missing or unknown.
    """
    return ChainParameters(**{key.removesuffix("_m"): value for key, value in document.items()})


def p_data_document(p_data: PData) -> PDataDocument:
    """Return the document of P-data, with an id and a kind for each element."""
    elements = [
        {"id": number, "kind": ELEMENT_KINDS[type(element)]} | asdict(element)
        for number, element in enumerate(p_data.elements)
    ]
    return PDataDocument.model_validate({"elements": elements, "matrix": p_data.matrix.tolist()})
