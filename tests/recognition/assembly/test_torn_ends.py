"""Ends that face one another in one place are told: one string, torn, as likely as two."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.simulation.camera import camera_model
from cell.simulation.scenes import make_scene
from cell.simulation.simulate import simulate
from recognition.assembly.torn_ends import mark_fragmented_ends
from recognition.model.model import Chain, End
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene

R = 0.004


def chain(number: int, points: NDArray[np.float64], ends: tuple[End, End] = ("free", "free")) -> Chain:
    return Chain(number, False, R, points, np.full(len(points), 1e-4), np.full(len(points), 8), ends)


def along_x(begin_m: float, end_m: float, y_m: float = 0.0) -> NDArray[np.float64]:
    x = np.linspace(begin_m, end_m, 40)
    return np.column_stack([x, np.full(40, y_m), np.full(40, R)])


def test_two_that_face_one_another_are_one_maybe() -> None:
    # They reach over one another, which two strings cannot.
    chains, doubts = mark_fragmented_ends([chain(0, along_x(0.0, 0.1)), chain(1, along_x(0.098, 0.2))])
    assert [one.ends for one in chains] == [("free", "unseen"), ("unseen", "free")]
    (said,) = doubts
    assert "an end of chain 0 and one of chain 1 face one another at (98, 0, 4) mm" in said


def test_a_ring_that_does_not_close_is_told() -> None:
    turn = np.linspace(0.0, 2 * np.pi - 0.05, 200)
    ring = np.column_stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), np.full(200, R)])
    (one,), doubts = mark_fragmented_ends([chain(0, ring)])
    assert one.ends == ("unseen", "unseen")
    assert doubts[0].startswith("the ends of chain 0 face one another")


@pytest.mark.parametrize(
    "other",
    [
        along_x(0.1 + 2.5 * R, 0.2),  # a gap that can be seen
        along_x(0.1, 0.0, 2 * R),  # side by side: the ends look the same way
        along_x(0.05, 0.2, 2 * R),  # side by side, and past one another
        np.array([[0.1, y, R] for y in np.linspace(1.2 * R, 0.1, 40)]),  # an end against a strand's end, from the side
    ],
)
def test_other_ends_are_as_they_were(other: NDArray[np.float64]) -> None:
    chains, doubts = mark_fragmented_ends([chain(0, along_x(0.0, 0.1)), chain(1, other)])
    assert [one.ends for one in chains] == [("free", "free")] * 2
    assert doubts == []


def test_none_and_closed_ones() -> None:
    assert mark_fragmented_ends([]) == ((), [])
    closed = Chain(0, True, R, along_x(0.0, 0.001), np.full(40, 1e-4), np.full(40, 8), ("free", "free"))
    (same,), doubts = mark_fragmented_ends([closed])
    assert (same.ends, doubts) == (closed.ends, [])


@pytest.mark.parametrize(("scene", "seed"), [("overhand-knot", 13), ("settled", 14), ("coil", 12)])
def test_a_string_torn_by_a_radius_told_too_small_is_not_believed(scene: str, seed: int) -> None:
    scan = simulate(make_scene(scene, seed), camera_model("oak-d-pro"), seed)
    known = Scene(scan.header.table_z_m, scan.header.workspace_m)
    model = recognise(scan.views, ChainParameters.for_radius(0.003), known).model
    # Whatever a radius that is 29 % off makes of it: a model without a doubt is the true one.
    whole = len(model.chains) == 1 and len(model.crossings) == len(scan.truth["crossings"])
    assert whole or any("they may be one string, torn" in said for said in model.quality.ambiguities)
