"""Names of the stages, and the timer that measures their durations."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from recognition.model.model import Method
from recognition.preprocessing.target_cloud import DepthView

STAGES = ("preprocess", "registration", "centre_line", "matching", "reconstruction", "refinement", "topology", "grasps")
"""Names of all stages in order, as in `on_stage` and `timing_s`. `stages_of` returns the stages of one method."""

Begin = Callable[[str], None]
"""Function that a stage calls with its name when it begins."""


def stages_of(method: Method) -> tuple[str, ...]:
    """Return the stage names of one method: `graph` has `refinement`, the other methods have `reconstruction`."""
    other = "reconstruction" if method == "graph" else "refinement"
    return tuple(stage for stage in STAGES if stage != other)


def ignore_stage(_: str) -> None:
    """Do nothing when a stage begins."""


@dataclass
class StageTimer:
    """Timer that measures the duration of each stage and calls `on_stage` when a stage begins."""

    on_stage: Begin | None
    timing_s: dict[str, float] = field(default_factory=dict)
    """Duration of each stage that has ended, seconds."""
    _stage: str | None = None
    _begin_s: float = 0.0

    def begin(self, stage: str) -> None:
        """End the current stage and begin the next one."""
        self.end()
        self._stage = stage
        self._begin_s = time.perf_counter()
        if self.on_stage is not None:
            self.on_stage(stage)

    def end(self) -> None:
        """End the current stage and store its duration. Without a current stage, do nothing."""
        if self._stage is not None:
            self.timing_s[self._stage] = time.perf_counter() - self._begin_s
        self._stage = None

    def exclude_waiting(self, views: Iterable[DepthView]) -> Iterator[DepthView]:
        """Yield the views. The stage's duration excludes the wait for each view, because the arm moves meanwhile."""
        iterator = iter(views)
        while True:
            requested_s = time.perf_counter()
            view = next(iterator, None)
            self._begin_s += time.perf_counter() - requested_s
            if view is None:
                return
            yield view
