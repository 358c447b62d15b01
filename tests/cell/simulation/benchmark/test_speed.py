"""Test the arithmetic of the timings with a fake clock and a fake recognition. No real time is measured."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import nan
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.simulation.benchmark import scaling, speed, tables
from cell.simulation.benchmark.scaling import Growth, Row, is_linear, make_rows
from cell.simulation.benchmark.speed import Input, Speed, Timing, simulated_input
from recognition.errors import NoDepthError
from recognition.preprocessing.target_cloud import Scene

VIEW_S, REST_S = 1.0, 5.0
"""Time of the fake recognition for each view and after the last view, seconds."""


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds

    def recognise(self, views: Iterable[object], *others: Any) -> SimpleNamespace:
        count = 0
        for _ in views:
            count += 1
            self.now += VIEW_S
        self.now += REST_S
        quality = SimpleNamespace(views=[SimpleNamespace(points=10)] * count)
        return SimpleNamespace(model=SimpleNamespace(timing_s={"rest": REST_S}, quality=quality))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(speed, "time", clock)
    monkeypatch.setattr("recognition.pipeline.recognise", clock.recognise)
    return clock


@pytest.fixture(scope="module")
def given() -> Input:
    return simulated_input((160, 100), views=4, scene="arc", seed=1, camera="ideal")


def test_recognition_is_timed_as_a_whole(clock: Clock, given: Input) -> None:
    two = replace(given, views=given.views[:2])
    timings = speed.time_recognition([given, two], given, runs=3)
    assert timings == [
        Timing(4 * VIEW_S + REST_S, {"rest": REST_S}, 40),
        Timing(2 * VIEW_S + REST_S, {"rest": REST_S}, 20),
    ]


def test_a_slow_input_has_fewer_runs(clock: Clock, given: Input) -> None:
    began = clock.now
    speed.time_recognition([given], replace(given, views=()), runs=50)
    # After the warm-up without views, runs of 9 s are repeated until 10 s have passed.
    assert clock.now - began == REST_S + 2 * (4 * VIEW_S + REST_S)


def test_time_after_the_last_view_excludes_the_other_views(clock: Clock, given: Input) -> None:
    assert speed.time_after_last_view(given, given, runs=3) == pytest.approx(VIEW_S + REST_S)


def test_the_same_arguments_give_the_same_input(given: Input) -> None:
    again = simulated_input((160, 100), views=4, scene="arc", seed=1, camera="ideal")
    assert [(view.depth == other.depth).all() for view, other in zip(given.views, again.views, strict=True)] == [
        True
    ] * 4


def test_a_longer_string_is_captured_from_the_same_distance() -> None:
    short, long = (
        simulated_input((80, 50), views=2, scene="long", distance_m=0.5, camera="ideal", length_m=length)
        for length in (0.4, 2.0)
    )
    for given in (short, long):
        assert np.linalg.norm(given.views[0].T_base_camera[:3, 3]) == pytest.approx(0.5, abs=0.01)


def test_growth_is_linear_until_a_step_is_not() -> None:
    def timed(*seconds: float) -> tuple[Row, ...]:
        return make_rows([1.0, 2.0, 4.0][: len(seconds)], [Timing(s, {}, 7) for s in seconds])

    assert [row.ratio for row in timed(0.5, 1.0, 1.5)] == [1.0, 2.0, 3.0]
    assert [row.size_ratio for row in timed(0.5, 1.0, 1.5)] == [1.0, 2.0, 4.0]
    assert is_linear(timed(0.5, 1.0, 2.0))
    assert is_linear(timed(0.5, 0.4, 0.6)), "slower growth than linear is accepted"
    assert not is_linear(timed(0.5, 0.6, 2.4)), "the last step grows with the square"
    assert not is_linear(timed(0.5, 2.0, 3.0)), "six times the time for four times the size"
    # A factor of up to 2 ** 1.2 = 2.3 for the double size, or one slow size in the middle, counts as scatter.
    assert is_linear(timed(0.5, 1.1))
    assert is_linear(timed(0.5, 1.3, 2.0))


def test_a_series_with_a_refused_size_is_not_linear_and_has_the_reason() -> None:
    series = make_rows([0.4, 10.0], [Timing(0.3, {}, 5), "too-crowded: the workspace is wrong"])
    assert series[1] == Row(10.0, 0, None, None, 25.0, "too-crowded: the workspace is wrong")
    assert not is_linear(series)


def test_a_refusal_is_a_result_of_the_timing(monkeypatch: pytest.MonkeyPatch, given: Input) -> None:
    clock = Clock()

    def recognise(views: Sequence[object], *others: Any) -> SimpleNamespace:
        if len(views) == 1:
            raise NoDepthError("dark")
        return clock.recognise(views, *others)

    monkeypatch.setattr(speed, "time", clock)
    monkeypatch.setattr("recognition.pipeline.recognise", recognise)
    one = replace(given, views=given.views[:1])
    first, second, third = scaling.time_inputs([given, one, given], given)
    assert (first, second) == (third, "no-depth: dark")
    assert isinstance(first, Timing)
    assert first.seconds == 4 * VIEW_S + REST_S


def test_the_tables_show_every_figure() -> None:
    shown = tables.speed_table(Speed(0.31, 6.2, 20.0, 0.12, 0.84, 123.4, {"preprocess": 0.1}))
    for figure in ("0.310 s", "6.200 s", "20.0", "0.120 s", "0.840 s", "123 MB"):
        assert figure in shown
    series = make_rows([1.0, 4.0], [Timing(0.25, {}, 5), "no-depth: dark"])
    shown = tables.growth_table(Growth(points=series, views=series[:1], length=series[:1]))
    lines = shown.splitlines()
    assert lines[2] == "| 1 pixels per view | 5 | 1.0 | 0.250 s | 1.0 | NO |"
    assert lines[3] == "| 4 pixels per view | - | 4.0 | refused | - | NO |"
    assert lines[4] == "| 1 views | 5 | 1.0 | 0.250 s | 1.0 | yes |"


def test_the_time_of_the_literal_baseline_is_that_of_its_fastest_run(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, given: Input
) -> None:
    durations_s = iter([9.0, 3.0, 2.0])  # The first run is the warm-up.
    monkeypatch.setattr(
        "cell.simulation.benchmark.reference.recognise_literally", lambda *_: clock.sleep(next(durations_s, nan))
    )
    assert speed.time_literal(Input(given.views, 0.0042, Scene()), given, runs=2) == 2.0
