"""The point chain model's JSON document, described for OpenAPI and checked in tests; recognition writes it.

Documents may gain members; readers must pass over those that they do not know.
"""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Point = tuple[float, float, float]
"""x, y, z, metres, base frame."""


class _Document(BaseModel):
    model_config = ConfigDict(extra="allow")


class ChainDocument(_Document):
    """One string as ordered points of its centre line."""

    id: int
    closed: bool
    radius_m: float
    length_m: float
    points: list[Point]
    arc_length_m: list[float]
    sigma_m: list[float]
    views: list[int]
    """How many views saw each point; 0 = bridged."""
    ends: tuple[Literal["free", "unseen"], Literal["free", "unseen"]]


class StrandPointDocument(_Document):
    """A place on a chain."""

    chain: int
    s_m: float


class CrossingDocument(_Document):
    """Two strands lying over one another."""

    id: int
    point: Point
    over: StrandPointDocument
    under: StrandPointDocument
    gap_m: float
    angle_rad: float
    sign: Literal[-1, 1]
    confidence: float = Field(ge=0, le=1)


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
    s_m: float
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


class ViewQualityDocument(_Document):
    """What became of one view."""

    index: int
    used: bool
    reason: str | None
    points: int
    fitness: float | None
    rms_m: float | None
    correction_m: float | None
    correction_rad: float | None


class QualityDocument(_Document):
    """How far the model can be trusted."""

    views: list[ViewQualityDocument]
    ambiguities: list[str]
    warnings: list[str]


class ModelDocument(_Document):
    """Strings as ordered point chains, with their crossings."""

    schema_: Literal["pointchain/1"] = Field(alias="schema")
    frame: Literal["base"]
    method: str
    parameters: dict[str, float]
    chains: list[ChainDocument]
    crossings: list[CrossingDocument]
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
