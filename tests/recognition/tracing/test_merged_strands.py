"""Lines between two merged strands, on surfaces seen from above."""

from collections.abc import Callable

import numpy as np
import pytest

from cell.simulation.cases import make_case, simulate
from cell.simulation.evaluation.metrics import score
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest
from recognition.tracing.fragments import Fragment
from recognition.tracing.merged_strands import split_merged_strands

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
HALF_EYE_M = 0.0135
"""Half the distance between the two crossings."""


def eye(apart: float) -> list[np.ndarray]:
    """Return two strands that cross twice, `apart` radii from one another half way in between.

    Each is over once, by 1.2 r, and half way between the crossings they are at one height. Outside they part at 33
    degrees for each millimetre between them.
    """
    x = np.arange(-0.07, 0.07, 0.001)
    phase = np.clip(x / HALF_EYE_M, -1, 1) * np.pi / 2
    beyond = np.maximum(np.abs(x) - HALF_EYE_M, 0.0)
    y = apart * R / 2 * (np.cos(phase) - beyond * np.pi / 2 / HALF_EYE_M)
    down = np.cos(np.minimum(beyond / 0.04, 1.0) * np.pi) / 2 + 0.5
    lift = 0.6 * R * (1 - np.sin(phase)) * down
    return [np.column_stack([x, y, R + lift]), np.column_stack([x, -y, R + lift[::-1]])]


def fragment(points: np.ndarray) -> Fragment:
    return Fragment(points[::3], np.ones(len(points[::3])))


@pytest.mark.parametrize("seed", [22, 28])
def test_soft_strands_that_cross_twice_nearby_are_separated(seed: int) -> None:
    # Without the cut these two are a strand that turns into the other, and the rest of both.
    scan = simulate(make_case("soft", seed, "ideal"))
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    model = recognise(scan.views, RecognitionRequest(radius_m=scan.truth["radius"]), scene).model
    assert score(model.to_json(), scan.truth).topology


def test_a_line_between_two_strands_is_cut_there_and_only_there(seen: Callable) -> None:
    strands = eye(1.3)
    first, second = strands
    # Over at both crossings: from the one strand to the other.
    wrong = np.where(first[:, :1] < 0, first, second)
    wrong[:, 1] *= np.clip(np.abs(first[:, 0]) / 0.006, 0, 1)
    before, after = split_merged_strands([fragment(wrong)], seen(strands, R)[0], PARAMETERS)
    # What is left runs on the one strand, and on the other, but for a radius in which the two part.
    assert before.points[-1, 0] < -0.002
    assert after.points[0, 0] > 0.002
    assert before.points[-1, 0] > -HALF_EYE_M
    assert after.points[0, 0] < HALF_EYE_M


def test_lines_on_their_own_strands_stay_whole(seen: Callable, heap: Callable, straight: Callable) -> None:
    beside = [straight((-0.06, k * 2 * R, R), (0.06, k * 2 * R, R)) for k in range(3)]
    for strands in (heap((0, 30), 1.2 * R), heap((0, 60, 120), 2 * R), beside, eye(1.3)):
        whole = [fragment(strand) for strand in strands]
        surface = seen(strands, R, noise=0.05 * R)[0]
        assert split_merged_strands(whole, surface, PARAMETERS) == whole


def test_a_string_thicker_than_r_stays_whole(seen: Callable, heap: Callable) -> None:
    strands = heap((0, 70), 2 * R)
    whole = [fragment(strand) for strand in strands]
    surface = seen(strands, R, noise=0.03 * R)[0]
    assert split_merged_strands(whole, surface, ChainParameters.for_radius(0.6 * R)) == whole


def test_a_fragment_no_longer_than_a_radius_is_examined_too(seen: Callable) -> None:
    short = Fragment(np.array([(0.0, 0.0, R), (0.3 * R, 0.0, R), (0.6 * R, 0.1 * R, R)]), np.ones(3))
    assert split_merged_strands([short], seen(eye(1.3), R)[0], PARAMETERS) == [short]


def test_nothing_seen_and_no_fragments() -> None:
    whole = [fragment(eye(1.3)[0])]
    assert split_merged_strands(whole, np.empty((0, 3)), PARAMETERS) == whole
    assert split_merged_strands([], np.empty((0, 3)), PARAMETERS) == []


@pytest.mark.parametrize("seed", range(3))
def test_a_single_strand_that_is_unevenly_widened_is_not_cut(seed: int) -> None:
    # Windows of a stereo camera widen every string, here by 0.3 r with a standard deviation of 0.1 r.
    rng = np.random.default_rng(seed)
    x = np.linspace(-0.15, 0.15, 400)
    widening = np.interp(x, np.linspace(-0.15, 0.15, 40), rng.normal(0.3, 0.1, 40))
    surface = []
    for share in np.linspace(-1, 1, 41):
        height = 1.2 + 0.8 * np.sqrt(1 - share**2)
        surface.append(np.column_stack([x, share * (1 + widening) * R, np.full(len(x), height * R)]))
    middle = np.column_stack([x, np.zeros(len(x)), np.full(len(x), R)])
    (whole,) = split_merged_strands([fragment(middle)], np.vstack(surface), PARAMETERS)
    assert len(whole.points) == len(fragment(middle).points)
