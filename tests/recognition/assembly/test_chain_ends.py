"""Unobserved ends, with unexplained surface ahead of them, and fragmented ends, which face each other."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.assembly.chain_ends import mark_facing_ends, mark_unobserved_ends
from recognition.model.chains import Chain, End
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene

pytestmark = pytest.mark.slow

R = 0.0042
FRAGMENT_R = 0.004


def line(start_mm: tuple[float, float], end_mm: tuple[float, float]) -> np.ndarray:
    """Points 1 mm apart at the height of a string on the table."""
    a, b = np.array([*start_mm, 4.2]) / 1000, np.array([*end_mm, 4.2]) / 1000
    return np.linspace(a, b, round(np.linalg.norm(b - a) * 1000) + 1)


def chain(points: np.ndarray, closed: bool = False) -> Chain:
    count = len(points)
    return Chain(0, closed, R, points, np.zeros(count), np.ones(count, dtype=np.int64), ("free", "free"))


ALONG_X = chain(line((0, 0), (100, 0)))
# Unexplained surface begins 2 r = 8.4 mm from the chain.
AHEAD = line((109, 0), (125, 0))


def test_an_end_with_a_piece_in_line_is_unseen(table_1: ChainParameters) -> None:
    (found,) = mark_unobserved_ends([ALONG_X], [AHEAD], table_1)
    assert found.ends == ("free", "unseen")
    (found,) = mark_unobserved_ends([replace(ALONG_X, points=ALONG_X.points[::-1])], [AHEAD], table_1)
    assert found.ends == ("unseen", "free")


def test_a_string_that_bends_away_is_in_line(table_1: ChainParameters) -> None:
    # An arc of radius 20 mm, farther than 8.4 mm from the chain's end.
    turn = np.radians(np.arange(26, 60, 2))
    bent = np.column_stack([0.1 + 0.02 * np.sin(turn), 0.02 * (1 - np.cos(turn)), np.full(len(turn), R)])
    (found,) = mark_unobserved_ends([ALONG_X], [bent], table_1)
    assert found.ends == ("free", "unseen")


@pytest.mark.parametrize(
    "elsewhere", [line((114, 0), (130, 0)), line((100, 9), (100, 30)), line((90, 9), (106, 12)), line((20, 9), (60, 9))]
)
def test_surface_far_away_or_aside_is_another_object(table_1: ChainParameters, elsewhere: np.ndarray) -> None:
    (found,) = mark_unobserved_ends([ALONG_X], [elsewhere], table_1)
    assert found.ends == ("free", "free")


def test_from_a_thicker_chain_it_may_be_farther(table_1: ChainParameters) -> None:
    (found,) = mark_unobserved_ends([replace(ALONG_X, radius_m=0.006)], [line((113, 0), (130, 0))], table_1)
    assert found.ends == ("free", "unseen")


def test_an_unseen_end_stays_unseen_and_a_ring_has_no_end(table_1: ChainParameters) -> None:
    (found,) = mark_unobserved_ends([replace(ALONG_X, ends=("unseen", "free"))], [AHEAD], table_1)
    assert found.ends == ("unseen", "unseen")
    ring = replace(ALONG_X, closed=True)
    assert mark_unobserved_ends([ring], [AHEAD], table_1) == (ring,)


def test_no_unexplained_surface_or_no_chains(table_1: ChainParameters) -> None:
    assert mark_unobserved_ends([ALONG_X], [], table_1) == (ALONG_X,)
    assert mark_unobserved_ends([], [AHEAD], table_1) == ()


def test_a_chain_of_two_points_has_a_direction(table_1: ChainParameters) -> None:
    (found,) = mark_unobserved_ends([chain(line((99, 0), (100, 0)))], [AHEAD], table_1)
    assert found.ends == ("free", "unseen")


def numbered_chain(number: int, points: NDArray[np.float64], ends: tuple[End, End] = ("free", "free")) -> Chain:
    return Chain(number, False, FRAGMENT_R, points, np.full(len(points), 1e-4), np.full(len(points), 8), ends)


def along_x(begin_m: float, end_m: float, y_m: float = 0.0) -> NDArray[np.float64]:
    x = np.linspace(begin_m, end_m, 40)
    return np.column_stack([x, np.full(40, y_m), np.full(40, FRAGMENT_R)])


def test_ends_that_face_each_other_are_unseen() -> None:
    # The chains overlap, which two strings cannot.
    chains, ambiguities = mark_facing_ends(
        [numbered_chain(0, along_x(0.0, 0.1)), numbered_chain(1, along_x(0.098, 0.2))]
    )
    assert [one.ends for one in chains] == [("free", "unseen"), ("unseen", "free")]
    (message,) = ambiguities
    assert "an end of chain 0 and an end of chain 1 face each other at (98, 0, 4) mm" in message


def test_a_ring_that_does_not_close_is_ambiguous() -> None:
    turn = np.linspace(0.0, 2 * np.pi - 0.05, 200)
    ring = np.column_stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), np.full(200, FRAGMENT_R)])
    (one,), ambiguities = mark_facing_ends([numbered_chain(0, ring)])
    assert one.ends == ("unseen", "unseen")
    assert ambiguities[0].startswith("the ends of chain 0 face each other")


@pytest.mark.parametrize(
    "other",
    [
        along_x(0.1 + 2.5 * FRAGMENT_R, 0.2),  # a gap that can be seen
        along_x(0.1, 0.0, 2 * FRAGMENT_R),  # side by side: the ends have the same direction
        along_x(0.05, 0.2, 2 * FRAGMENT_R),  # side by side, and overlapping
        np.array(
            [[0.1, y, FRAGMENT_R] for y in np.linspace(1.2 * FRAGMENT_R, 0.1, 40)]
        ),  # an end beside the end of another strand
    ],
)
def test_other_ends_are_unchanged(other: NDArray[np.float64]) -> None:
    chains, ambiguities = mark_facing_ends([numbered_chain(0, along_x(0.0, 0.1)), numbered_chain(1, other)])
    assert [one.ends for one in chains] == [("free", "free")] * 2
    assert ambiguities == []


def test_no_chains_and_closed_chains_have_no_fragmented_ends() -> None:
    assert mark_facing_ends([]) == ((), [])
    closed = Chain(0, True, FRAGMENT_R, along_x(0.0, 0.001), np.full(40, 1e-4), np.full(40, 8), ("free", "free"))
    (same,), ambiguities = mark_facing_ends([closed])
    assert (same.ends, ambiguities) == (closed.ends, [])


@pytest.mark.parametrize(("scene", "seed"), [("overhand-knot", 13), ("settled", 14), ("coil", 12)])
def test_a_string_fragmented_by_a_radius_too_small_is_ambiguous(scene: str, seed: int) -> None:
    scan = simulate(make_scene(scene, seed), camera_model("oak-d-pro"), seed)
    known = Scene(scan.header.table_z_m, scan.header.workspace_m)
    model = recognise(scan.views, ChainParameters.for_radius(0.003), known).model
    # The radius is 29 % too small: a model without an ambiguity must be the true one.
    whole = len(model.chains) == 1 and len(model.crossings) == len(scan.truth["crossings"])
    assert whole or any("one string may continue there" in message for message in model.quality.ambiguities)
