"""Recognition from end to end, in the order of the paper's flowchart (Fig. 2)."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from recognition.model import METHODS, Method, PointChainModel
from recognition.parameters import ChainParameters
from recognition.preprocess import DepthView, Scene


@dataclass(frozen=True, eq=False)
class Recognition:
    """A model and what led to it."""

    model: PointChainModel
    stages: Mapping[str, Any] = field(default_factory=dict)
    """Results of the stages by name, kept for drawing."""


def recognise(
    views: Iterable[DepthView],
    parameters: ChainParameters,
    scene: Scene | None = None,
    method: Method = "enhanced",
    on_stage: Callable[[str], None] | None = None,
) -> Recognition:
    """placeholder while the stages are being written"""
    raise RuntimeError("being written")


__all__ = ["METHODS", "Recognition", "recognise"]
