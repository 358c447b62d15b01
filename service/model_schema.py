"""The point chain model's JSON document, described for OpenAPI and checked in tests; recognition writes it.

Documents may gain members; readers must pass over those that they do not know.
"""

from typing import Literal

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


class TopologyDocument(_Document):
    """Crossings in the order in which each chain meets them: (crossing id, role, sign)."""

    gauss_code: list[list[tuple[int, Literal["over", "under"], Literal[-1, 1]]]]


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
    quality: QualityDocument
    timing_s: dict[str, float]
