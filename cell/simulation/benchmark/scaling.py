"""Measure how the time of recognition grows with pixels per view, number of views, and length of the string."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import log

from cell.config.camera_names import DEFAULT_CAMERA, CameraName
from cell.simulation.benchmark.speed import (
    CROSSINGS,
    SMALL,
    THUMBNAIL,
    Input,
    Timing,
    simulated_input,
    time_recognition,
)
from cell.simulation.benchmark.worker_pool import run_in_fresh_process
from recognition.errors import RecognitionError

RESOLUTIONS = (SMALL, (905, 565), (1280, 800))
"""Width and height of the depth images, with one, two and four times the pixels."""
VIEWS = (4, 8, 16, 32)
"""Numbers of views."""
LENGTHS_M = (0.4, 1.0, 2.0, 5.0, 10.0)
"""Lengths of the string, metres."""
DISTANCE_M = 0.6
"""Distance of the camera for all lengths, metres. It is constant, so the number of points grows with the length."""
RUNS = 3
"""Maximum number of runs of a timing."""
LINEAR_EXPONENT = 1.2
"""Maximum exponent of a growth that counts as linear. It exceeds 1 because timings scatter by some per cent."""


@dataclass(frozen=True)
class Row:
    """Result for one size of the input."""

    size: float
    """Pixels per view, number of views, or length of the string in metres."""
    points: int
    """Number of points above the table in all views, or 0 if recognition refused the input."""
    seconds: float | None
    """Time of recognition, or None if recognition refused the input."""
    ratio: float | None
    """Ratio of `seconds` to the first row, or None if recognition refused one of the two inputs."""
    size_ratio: float
    """Ratio of `size` to the first row."""
    refused: str | None = None
    """Slug and message of the refusal, or None."""


@dataclass(frozen=True)
class Growth:
    """Growth of the time in three series."""

    points: tuple[Row, ...]
    """Series of pixels per view."""
    views: tuple[Row, ...]
    """Series of numbers of views."""
    length: tuple[Row, ...]
    """Series of string lengths."""

    def linear(self) -> dict[str, bool]:
        """Return whether the time of each series grows linearly or more slowly, by the name of the series."""
        return {name: is_linear(rows) for name, rows in vars(self).items()}


def measure_growth(on_progress: Callable[[str], object], camera: CameraName = DEFAULT_CAMERA) -> Growth:
    """Measure the three series.

    Args:
        on_progress: Called with a progress message before each series.
        camera: Camera that sees the scenes.
    """
    simulated = partial(simulated_input, camera=camera)
    thumbnail = simulated(THUMBNAIL, crossings=CROSSINGS)

    def series(name: str, sizes: Sequence[float], make_input: Callable[[int], Input]) -> tuple[Row, ...]:
        on_progress(f"growth with {name}: {', '.join(f'{size:g}' for size in sizes)}")
        # The scans are simulated in this process, so that the time_inputs process only recognises.
        inputs = [make_input(k) for k in range(len(sizes))]
        return make_rows(sizes, run_in_fresh_process(time_inputs, inputs, thumbnail))

    return Growth(
        points=series(
            "pixels per view",
            [float(width * height) for width, height in RESOLUTIONS],
            lambda k: simulated(RESOLUTIONS[k], crossings=CROSSINGS),
        ),
        views=series("views", VIEWS, lambda k: simulated(SMALL, views=VIEWS[k], crossings=CROSSINGS)),
        length=series(
            "length",
            LENGTHS_M,
            lambda k: simulated(SMALL, scene="long", distance_m=DISTANCE_M, length_m=LENGTHS_M[k]),
        ),
    )


def make_rows(sizes: Sequence[float], timings: Sequence[Timing | str]) -> tuple[Row, ...]:
    """Return one row for each size.

    Args:
        sizes: Size of each input.
        timings: Timing of each input. A string is the slug and message with which recognition refused the input.
    """
    first = timings[0].seconds if isinstance(timings[0], Timing) else None
    result = []
    for size, timing in zip(sizes, timings, strict=True):
        if isinstance(timing, str):
            result.append(Row(size, 0, None, None, size / sizes[0], timing))
        else:
            ratio = None if first is None else timing.seconds / first
            result.append(Row(size, timing.points, timing.seconds, ratio, size / sizes[0]))
    return tuple(result)


def is_linear(series: Sequence[Row]) -> bool:
    """Return whether the time grows with the size by an exponent of at most `LINEAR_EXPONENT`.

    The condition applies to the whole series and to its last step. The last step shows a higher exponent that the
    constant time of small inputs hides. A series with a refused input is not linear.
    """
    done = [(row.size, row.seconds) for row in series if row.seconds is not None]
    if len(done) < len(series):
        return False
    last_size, last_seconds = done[-1]
    return all(
        log(last_seconds / seconds) <= LINEAR_EXPONENT * log(last_size / size)
        for size, seconds in (done[0], *done[-2:])
    )


def time_inputs(inputs: Sequence[Input], thumbnail: Input) -> list[Timing | str]:
    """Return the timing of each input, or the slug and message with which recognition refused the input."""
    timings: list[Timing | str] = []
    for given in inputs:
        try:
            timings += time_recognition([given], thumbnail, RUNS)
        except RecognitionError as error:
            timings.append(f"{error.slug}: {error}")
    return timings
