"""Measure how the time of recognition grows with points per view, with views and with the length of the string."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log

from cell.simulation.benchmark.speed import (
    CROSSINGS,
    SMALL,
    THUMBNAIL,
    Input,
    Timing,
    simulated_input,
    time_recognition,
)
from cell.simulation.benchmark.worker_pool import in_fresh_process
from recognition.errors import RecognitionError

RESOLUTIONS = (SMALL, (905, 565), (1280, 800))
"""One, two and four times the pixels."""
VIEWS = (4, 8, 16, 32)
LENGTHS_M = (0.4, 1.0, 2.0, 5.0, 10.0)
DISTANCE_M = 0.6
"""Distance of the camera for all lengths, so that the points grow with the length."""
RUNS = 3
LINEAR_EXPONENT = 1.2
"""Growth by this power of the size or less counts as linear, since timings scatter by some per cent."""


@dataclass(frozen=True)
class Row:
    """Result for one size of the input."""

    size: float
    """Pixels per view, views, or metres of string."""
    points: int
    """Points of string height in all views, as the model reports them."""
    seconds: float | None
    """None when recognition refused the input."""
    ratio: float | None
    """Ratio to the seconds of the first row."""
    size_ratio: float
    refused: str | None = None


@dataclass(frozen=True)
class Growth:
    """The three series."""

    points: tuple[Row, ...]
    views: tuple[Row, ...]
    length: tuple[Row, ...]

    def linear(self) -> dict[str, bool]:
        """Return for each series whether its time grows no faster than its size."""
        return {name: linear(rows) for name, rows in vars(self).items()}


def measure_growth(say: Callable[[str], object]) -> Growth:
    """Measure the three series. `say` is called with a message on what is measured."""
    thumbnail = simulated_input(THUMBNAIL, crossings=CROSSINGS)

    def series(name: str, sizes: Sequence[float], simulated: Callable[[int], Input]) -> tuple[Row, ...]:
        say(f"growth with {name}: {', '.join(f'{size:g}' for size in sizes)}")
        # Scenes are simulated here, so that the timed process receives the views only.
        inputs = [simulated(k) for k in range(len(sizes))]
        return rows(sizes, in_fresh_process(timed, inputs, thumbnail))

    return Growth(
        points=series(
            "pixels per view",
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
    """Return one row for each size. A timing that is text is the reason why recognition refused that size."""
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
    """Return whether neither the whole series nor its last step grows faster than `LINEAR_EXPONENT` allows.

    A higher power shows in the last step, even if the constant time of small inputs hides it before. A series with a
    refused size is not linear.
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
    """Return the timing of each input, or the reason why recognition refused it."""
    timings: list[Timing | str] = []
    for given in inputs:
        try:
            timings += time_recognition([given], thumbnail, RUNS)
        except RecognitionError as error:
            timings.append(f"{error.slug}: {error}")
    return timings
