"""How recognition's time grows with points per view, with views and with the length of the string."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log

from cell.simulation.benchmark.processes import in_fresh_process
from cell.simulation.benchmark.speed import (
    CROSSINGS,
    SMALL,
    THUMBNAIL,
    Input,
    Timing,
    simulated_input,
    time_recognition,
)
from recognition.errors import RecognitionError

RESOLUTIONS = (SMALL, (905, 565), (1280, 800))
"""Once, twice and four times the pixels."""
VIEWS = (4, 8, 16, 32)
LENGTHS_M = (0.4, 1.0, 2.0, 5.0, 10.0)
DISTANCE_M = 0.6
"""From where all lengths are seen: from one distance, so that points grow as the length does."""
RUNS = 3
LINEAR_EXPONENT = 1.2
"""Time that grows with a power of the size no higher than this counts as linear: timings scatter by some per cent."""


@dataclass(frozen=True)
class Row:
    """One size of the input."""

    size: float
    """Pixels a view, views, or metres of string."""
    points: int
    """Points of string height in all views, as the model tells them."""
    seconds: float | None
    """None where recognition refused it."""
    ratio: float | None
    """To the first row's seconds."""
    size_ratio: float
    refused: str | None = None


@dataclass(frozen=True)
class Growth:
    """The three series."""

    points: tuple[Row, ...]
    views: tuple[Row, ...]
    length: tuple[Row, ...]

    def linear(self) -> dict[str, bool]:
        """For each series whether time grows no faster than the size."""
        return {name: linear(rows) for name, rows in vars(self).items()}


def measure_growth(say: Callable[[str], object]) -> Growth:
    """The three series; `say` is told what is being done."""
    thumbnail = simulated_input(THUMBNAIL, crossings=CROSSINGS)

    def series(name: str, sizes: Sequence[float], simulated: Callable[[int], Input]) -> tuple[Row, ...]:
        say(f"growth with {name}: {', '.join(f'{size:g}' for size in sizes)}")
        # Laid and simulated here: the process that is timed is given the views only.
        inputs = [simulated(k) for k in range(len(sizes))]
        return rows(sizes, in_fresh_process(timed, inputs, thumbnail))

    return Growth(
        points=series(
            "pixels a view",
            [float(width * height) for width, height in RESOLUTIONS],
            lambda k: simulated_input(RESOLUTIONS[k], crossings=CROSSINGS),
        ),
        views=series("views", VIEWS, lambda k: simulated_input(SMALL, views=VIEWS[k], crossings=CROSSINGS)),
        length=series(
            "length",
            LENGTHS_M,
            lambda k: simulated_input(SMALL, scene="long", distance_m=DISTANCE_M, length_m=LENGTHS_M[k]),
        ),
    )


def rows(sizes: Sequence[float], timings: Sequence[Timing | str]) -> tuple[Row, ...]:
    """Rows from sizes and timings; a timing that is text is why recognition refused that size."""
    first = timings[0].seconds if isinstance(timings[0], Timing) else None
    result = []
    for size, timing in zip(sizes, timings, strict=True):
        if isinstance(timing, str):
            result.append(Row(size, 0, None, None, size / sizes[0], timing))
        else:
            ratio = None if first is None else timing.seconds / first
            result.append(Row(size, timing.points, timing.seconds, ratio, size / sizes[0]))
    return tuple(result)


def linear(series: Sequence[Row]) -> bool:
    """Whether neither the whole series nor its last step grows faster than `LINEAR_EXPONENT` allows.

    A power above one shows in the last step, however much the start hides it. Not when a size was refused.
    """
    done = [(row.size, row.seconds) for row in series if row.seconds is not None]
    if len(done) < len(series):
        return False
    last_size, last_seconds = done[-1]
    return all(
        log(last_seconds / seconds) <= LINEAR_EXPONENT * log(last_size / size)
        for size, seconds in (done[0], *done[-2:])
    )


def timed(inputs: Sequence[Input], thumbnail: Input) -> list[Timing | str]:
    """Each input's timing, or why recognition refused it."""
    timings: list[Timing | str] = []
    for given in inputs:
        try:
            timings += time_recognition([given], thumbnail, RUNS)
        except RecognitionError as error:
            timings.append(f"{error.slug}: {error}")
    return timings
