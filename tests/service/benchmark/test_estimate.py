"""The estimate of the duration of `pointchain bench`."""

import pytest

from cell.simulation.cases import TIERS
from service.benchmark.estimate import (
    GRASP_COSTS,
    TIER_COSTS,
    VIEWS_COSTS,
    Probe,
    accuracy_s,
    cell_s,
    duration,
    grasps_s,
    measure_probe,
    remaining_s,
    scene_cost,
    service_s,
    speed_s,
    views_s,
)
from service.benchmark.views import VIEWS_TIERS

UNIT = Probe(start_s=0.0, case_s=1.0)


def test_every_tier_has_a_cost() -> None:
    assert set(TIER_COSTS) == set(GRASP_COSTS) == set(TIERS)
    assert set(VIEWS_COSTS) == set(VIEWS_TIERS)
    assert all(cost > 0 for costs in TIER_COSTS.values() for cost in costs)


def test_scenes_of_several_kinds_take_their_costs_in_turn() -> None:
    assert [scene_cost("hard", seed) for seed in range(4)] == [*TIER_COSTS["hard"], TIER_COSTS["hard"][0]]
    assert scene_cost("paper", 7) == scene_cost("paper", 0)


def test_accuracy_scales_with_the_machine_the_scenes_and_the_processes() -> None:
    paper = scene_cost("paper", 0)
    assert accuracy_s(["paper"], 6, 1, UNIT) == pytest.approx(6 * paper)
    assert accuracy_s(["paper"], 6, 2, UNIT) == pytest.approx(3 * paper)
    assert accuracy_s(["paper"], 7, 2, UNIT) == pytest.approx(4 * paper), "one process does the last scene"
    assert accuracy_s(["paper"], 6, 2, Probe(5.0, 3.0)) == pytest.approx(5.0 + 9 * paper)
    mixed = accuracy_s(["paper", "photo"], 4, 1, UNIT)
    assert mixed == pytest.approx(4 * paper + 4 * scene_cost("photo", 0))


def test_grasps_take_several_times_as_long_as_accuracy() -> None:
    assert grasps_s(["paper", "photo"], 4, 2, UNIT) > 3 * accuracy_s(["paper", "photo"], 4, 2, UNIT)


def test_views_scale_with_the_scenes_and_the_processes() -> None:
    assert views_s(["paper"], 6, 1, UNIT) == pytest.approx(6 * VIEWS_COSTS["paper"])
    assert views_s(["paper"], 6, 2, UNIT) == pytest.approx(3 * VIEWS_COSTS["paper"])


def test_the_paced_parts_depend_little_on_the_machine() -> None:
    slow = Probe(start_s=0.0, case_s=2.0)
    assert speed_s(slow) == pytest.approx(2 * speed_s(UNIT))
    for part_s in (cell_s, service_s):
        assert part_s(UNIT) < part_s(slow) < 1.2 * part_s(UNIT)


def test_remaining_time_starts_with_the_estimate_and_follows_the_pace() -> None:
    assert remaining_s(100.0, 0.0) == 100.0
    assert remaining_s(100.0, 40.0) == pytest.approx(60.0)
    assert 0.0 < remaining_s(100.0, 200.0) < 20.0, "late and not done"
    assert remaining_s(100.0, 0.0, share_done=0.0) == 100.0
    assert remaining_s(100.0, 25.0, share_done=0.25) == pytest.approx(75.0), "on time"
    assert remaining_s(100.0, 90.0, share_done=0.9) == pytest.approx(10.0)
    # twice as slow as estimated: after 180 s, 20 s are really left
    assert remaining_s(100.0, 180.0, share_done=0.9) == pytest.approx(20.0, abs=2.0)
    assert remaining_s(100.0, 250.0, share_done=1.0) == 0.0


def test_the_probe_times_each_process(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def map_in_processes(work: object, items: range, jobs: int) -> list[float]:
        calls.append((len(items), jobs))
        return [1.0, 3.0]

    monkeypatch.setattr("service.benchmark.estimate.map_in_processes", map_in_processes)
    probe = measure_probe(2)
    assert calls == [(2, 2)]
    assert probe == Probe(start_s=0.0, case_s=2.0)


@pytest.mark.parametrize(("seconds", "text"), [(0.4, "0 s"), (65.2, "65 s"), (179.0, "179 s"), (181.0, "3 min")])
def test_durations_are_in_seconds_or_minutes(seconds: float, text: str) -> None:
    assert duration(seconds) == text
