import numpy as np
import pytest

from cell.simulation.scenes.planar_crossings import at, plan_crossings
from cell.simulation.scenes.stacking_heights import BEND_RADII, MAX_SLOPE, HeightsError, lay

R = 0.004
STEP = 0.001


def line(start: tuple[float, float], end: tuple[float, float]) -> np.ndarray:
    count = round(float(np.hypot(end[0] - start[0], end[1] - start[1])) / STEP) + 1
    return np.linspace(start, end, count)


CROSS = [line((-0.1, 0.0), (0.1, 0.0)), line((0.003, -0.1), (0.003, 0.1))]


@pytest.mark.parametrize("softness", [1.0, 0.6])
def test_the_over_strand_lies_on_the_under_strand(softness: float) -> None:
    crossings = plan_crossings(CROSS)
    under, over = lay(CROSS, crossings, [False], [R, R], softness)
    # The under strand stays on the table, and the over strand touches it. Both are rows of the linear programme,
    # which is solved to 1e-7 radii.
    assert under == pytest.approx(np.full(len(under), R), abs=1e-8)
    assert at(over[:, None], crossings[0].second[1])[0] == pytest.approx(R + softness * 2 * R, abs=1e-8)
    assert over[[0, -1]] == pytest.approx([R, R], abs=1e-8)


def test_ramps_keep_the_bending_limit() -> None:
    _, over = lay(CROSS, plan_crossings(CROSS), [False], [R, R], 1.0)
    assert np.abs(np.diff(over, 2)).max() / STEP**2 <= 1.0001 / (BEND_RADII[0] * R)
    assert np.abs(np.diff(over)).max() / STEP <= MAX_SLOPE


def test_a_third_strand_is_lifted_onto_two() -> None:
    plan = [*CROSS, line((-0.07, -0.0728), (0.07, 0.0672))]
    crossings = plan_crossings(plan)
    over = {(0, 1): False, (0, 2): False, (1, 2): False}
    heights = lay(plan, crossings, [over[x.first[0], x.second[0]] for x in crossings], [R, R, R], 1.0)
    assert [float(z.max()) for z in heights] == pytest.approx([R, 3 * R, 5 * R], rel=0.1)


def test_strands_that_cannot_pass_each_other_are_rejected() -> None:
    x = np.arange(-0.04, 0.04, STEP)
    plan = [np.column_stack([x, np.zeros_like(x)]), np.column_stack([x, 0.006 * np.sin(2 * np.pi * x / 0.016 + 0.1)])]
    crossings = plan_crossings(plan)
    assert len(crossings) > 5
    # No string can alternate between over and under every 2 r.
    with pytest.raises(HeightsError, match="too close together"):
        lay(plan, crossings, [k % 2 == 0 for k in range(len(crossings))], [R, R], 1.0)


def test_a_thin_strand_lies_on_a_thick_one() -> None:
    crossings = plan_crossings(CROSS)
    under, over = lay(CROSS, crossings, [False], [R, 0.6 * R], 1.0)
    assert under == pytest.approx(np.full(len(under), R), abs=1e-8)
    assert at(over[:, None], crossings[0].second[1])[0] == pytest.approx(2 * R + 0.6 * R, abs=1e-8)
    assert over[[0, -1]] == pytest.approx([0.6 * R, 0.6 * R], abs=1e-8)


def test_a_ring_closes_without_a_step_or_kink() -> None:
    t = np.linspace(0.0, 2 * np.pi, 361)
    ring = 0.06 * np.column_stack([np.cos(t), np.sin(t)])
    ring[-1] = ring[0]
    # The other strand is crossed near the joint of the ring, so the joint is lifted too.
    plan = [ring, line((0.0, 0.0), (0.12, 0.004))]
    (crossing,) = crossings = plan_crossings(plan)
    ring_z, _ = lay(plan, crossings, [True], [R, R], 1.0)
    assert crossing.first[1] < 6
    assert ring_z[0] == ring_z[-1] > 2 * R
    step = np.linalg.norm(ring[1] - ring[0])
    around = np.concatenate([ring_z[-4:-1], ring_z[:4]])
    assert np.abs(np.diff(around, 2)).max() / step**2 <= 1.0001 / (BEND_RADII[0] * R)
