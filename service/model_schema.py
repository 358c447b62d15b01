"""The point chain model's JSON document, described for OpenAPI and checked in tests; recognition writes it.

Documents may gain members; readers must pass over those that they do not know.
"""

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from service.described import Described

Point = tuple[float, float, float]
"""x, y, z, metres, base frame."""


class _Document(Described):
    model_config = ConfigDict(extra="allow")


class ChainDocument(_Document):
    """One string as ordered points of its centre line."""

    id: int
    """Its place among the chains."""
    closed: bool
    """A ring: the last point is followed by the first, which is not repeated."""
    radius_m: float
    """Of the string: the told one, or the measured one where the data contradict that."""
    length_m: float
    """Along the centre line; of a closed one all the way round."""
    points: list[Point]
    """Of the centre line, from one end to the other."""
    arc_length_m: list[float]
    """Along the centre line from the first point to each point; the first is 0."""
    sigma_m: list[float]
    """How well each point is known; twice as much is meant to hold the true line at 95 of 100 points."""
    views: list[int]
    """How many views saw each point; 0 = bridged."""
    ends: tuple[Literal["free", "unseen"], Literal["free", "unseen"]]
    """Of the first and the last point: whether the string was seen to stop there."""


class StrandPointDocument(_Document):
    """A place on a chain."""

    chain: int
    """Its id."""
    s_m: float
    """Arc length from the chain's first point."""


class CrossingDocument(_Document):
    """Two strands lying over one another."""

    id: int
    """Its place among the crossings."""
    point: Point
    """Between the two centre lines."""
    over: StrandPointDocument
    """The place on the upper strand."""
    under: StrandPointDocument
    """The place on the lower strand."""
    gap_m: float
    """How much higher the upper centre line lies."""
    angle_rad: float
    """Between the directions of the two strands seen from above, 0 to pi / 2."""
    sign: Literal[-1, 1]
    """Of the crossing, right-handed: 1 where the lower strand goes from right to left as seen along the upper one."""
    confidence: float = Field(ge=0, le=1)
    """That over and under are the right way round."""


class EndElementDocument(_Document):
    """An end of an open chain."""

    id: int
    kind: Literal["end"]
    chain: int
    which: Literal["first", "last"]
    s_m: float
    end: Literal["free", "unseen"]


class CrossingElementDocument(_Document):
    """A crossing, in which two passes meet."""

    id: int
    kind: Literal["crossing"]
    crossing: int
    """Its id among the model's crossings."""
    sign: Literal[-1, 1]
    over: StrandPointDocument
    under: StrandPointDocument


class SegmentElementDocument(_Document):
    """The string from one end or crossing pass to the next."""

    id: int
    kind: Literal["segment"]
    chain: int
    s_m: tuple[float, float]
    """Arc lengths where it begins and ends; a closed chain's last segment ends beyond the chain's length."""


class PDataDocument(_Document):
    """Elements and how they follow one another along the chains.

    matrix[i][j] is not 0 where element j comes next after element i: 1 at a crossing's over pass, -1 at its under
    pass, 2 at an end (or for a closed chain without crossings, which follows itself).
    """

    elements: list[
        Annotated[EndElementDocument | CrossingElementDocument | SegmentElementDocument, Field(discriminator="kind")]
    ]
    """`id` is the place in this list, the row and the column of the matrix."""
    matrix: list[list[Literal[-1, 0, 1, 2]]]


class TopologyDocument(_Document):
    """How strands lie over one another."""

    gauss_code: list[list[tuple[int, Literal["over", "under"], Literal[-1, 1]]]]
    """For each chain its crossings in the order in which it meets them: (crossing id, role, sign)."""
    p_data: PDataDocument


Row = tuple[float, float, float, float]


class GraspDocument(_Document):
    """A place where the configured gripper can take a string."""

    chain: int
    """The id of the one that is gripped."""
    s_m: float
    """Where: arc length from the chain's first point."""
    T_base_grasp: tuple[Row, Row, Row, Row]
    """z = approach, x = closing direction, origin on the string's centre line."""
    opening_m: float
    """Between the fingers before they close."""
    reach_m: float
    """How far the fingertips go beyond the origin, along z."""
    clearance_m: float
    """Of fingers and palm on their way, from other strands and things."""
    table_clearance_m: float
    """Of the fingertips, from the table."""
    score: float = Field(ge=0, le=1)
    """The higher the better: room for the gripper, views that saw the string, far from ends and crossings, small
    sigma, straight and level."""


class ViewQualityDocument(_Document):
    """What became of one view."""

    index: int
    """The viewpoint's number."""
    used: bool
    """It is in the model."""
    reason: str | None
    """Why it is not."""
    points: int
    """Of the string's height that it gave."""
    fitness: float | None
    """The share of them where another view measured the same surface."""
    rms_m: float | None
    """How far apart these are."""
    correction_m: float | None
    """How far the view was moved from where arm and hand-eye calibration put it."""
    correction_rad: float | None
    """How far it was turned."""


class QualityDocument(_Document):
    """How far the model can be trusted."""

    views: list[ViewQualityDocument]
    """All of them, in the order of their numbers."""
    ambiguities: list[str]
    """What could not be decided, in words: the model may be wrong there."""
    warnings: list[str]
    """What was left out, and what speaks against what was told, in words."""


class ModelDocument(_Document):
    """Strings as ordered point chains, with their crossings."""

    schema_: Literal["pointchain/1"] = Field(alias="schema")
    frame: Literal["base"]
    """The robot's base, in which all points and poses are."""
    method: str
    """By which it was recognised."""
    parameters: dict[str, float]
    """The paper's symbols; r_m is the string's radius."""
    chains: list[ChainDocument]
    """The strings."""
    crossings: list[CrossingDocument]
    """Where strands lie over one another."""
    topology: TopologyDocument
    grasps: list[GraspDocument]
    """The best first."""
    quality: QualityDocument
    timing_s: dict[str, float]


class GraspsDocument(_Document):
    """The grasps of a model, by themselves."""

    schema_: Literal["pointchain/1"] = Field(alias="schema")
    frame: Literal["base"]
    grasps: list[GraspDocument]
    """The best first."""
