"""Unobserved ends, with unexplained surface ahead of them, and touching ends, which face each other."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.assembly.chain_ends import (
    END_PART_RADII,
    MAX_FACING_GAP_RADII,
    mark_ends_at_unexplained_surface,
    mark_ends_before_low_parts,
    mark_ends_without_free_space,
    mark_touching_ends,
    unobserved_end_findings,
)
from recognition.model.chains import Chain, End
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest
from tests.recognition.captured_strings import captured

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


def test_an_end_with_a_piece_in_line_is_unobserved(table_1: ChainParameters) -> None:
    (found,) = mark_ends_at_unexplained_surface([ALONG_X], [AHEAD], table_1)
    assert found.ends == ("free", "unobserved")
    (found,) = mark_ends_at_unexplained_surface([replace(ALONG_X, points=ALONG_X.points[::-1])], [AHEAD], table_1)
    assert found.ends == ("unobserved", "free")


def test_a_string_that_bends_away_is_in_line(table_1: ChainParameters) -> None:
    # An arc of radius 20 mm, farther than 8.4 mm from the chain's end.
    turn = np.radians(np.arange(26, 60, 2))
    bent = np.column_stack([0.1 + 0.02 * np.sin(turn), 0.02 * (1 - np.cos(turn)), np.full(len(turn), R)])
    (found,) = mark_ends_at_unexplained_surface([ALONG_X], [bent], table_1)
    assert found.ends == ("free", "unobserved")


@pytest.mark.parametrize(
    "elsewhere", [line((114, 0), (130, 0)), line((100, 9), (100, 30)), line((90, 9), (106, 12)), line((20, 9), (60, 9))]
)
def test_surface_far_away_or_aside_is_another_object(table_1: ChainParameters, elsewhere: np.ndarray) -> None:
    (found,) = mark_ends_at_unexplained_surface([ALONG_X], [elsewhere], table_1)
    assert found.ends == ("free", "free")


def test_from_a_thicker_chain_it_may_be_farther(table_1: ChainParameters) -> None:
    (found,) = mark_ends_at_unexplained_surface([replace(ALONG_X, radius_m=0.006)], [line((113, 0), (130, 0))], table_1)
    assert found.ends == ("free", "unobserved")


def test_an_unobserved_end_stays_unobserved_and_a_ring_has_no_end(table_1: ChainParameters) -> None:
    (found,) = mark_ends_at_unexplained_surface([replace(ALONG_X, ends=("unobserved", "free"))], [AHEAD], table_1)
    assert found.ends == ("unobserved", "unobserved")
    ring = replace(ALONG_X, closed=True)
    assert mark_ends_at_unexplained_surface([ring], [AHEAD], table_1) == (ring,)


def test_no_unexplained_surface_or_no_chains(table_1: ChainParameters) -> None:
    assert mark_ends_at_unexplained_surface([ALONG_X], [], table_1) == (ALONG_X,)
    assert mark_ends_at_unexplained_surface([], [AHEAD], table_1) == ()


def test_a_chain_of_two_points_has_a_direction(table_1: ChainParameters) -> None:
    (found,) = mark_ends_at_unexplained_surface([chain(line((99, 0), (100, 0)))], [AHEAD], table_1)
    assert found.ends == ("free", "unobserved")


def numbered_chain(number: int, points: NDArray[np.float64], ends: tuple[End, End] = ("free", "free")) -> Chain:
    return Chain(number, False, FRAGMENT_R, points, np.full(len(points), 1e-4), np.full(len(points), 8), ends)


def along_x(begin_m: float, end_m: float, y_m: float = 0.0) -> NDArray[np.float64]:
    x = np.linspace(begin_m, end_m, 40)
    return np.column_stack([x, np.full(40, y_m), np.full(40, FRAGMENT_R)])


def test_ends_that_face_each_other_are_touching() -> None:
    # The chains overlap, which two strings cannot.
    chains, findings = mark_touching_ends(
        [numbered_chain(0, along_x(0.0, 0.1)), numbered_chain(1, along_x(0.098, 0.2))]
    )
    assert [one.ends for one in chains] == [("free", "touching"), ("touching", "free")]
    assert [(found.code, found.severity) for found in findings] == [("ends-touching", "doubt")] * 2
    assert [(found.chains, found.end) for found in findings] == [((0,), "last"), ((1,), "first")]
    part = END_PART_RADII * FRAGMENT_R
    for found, span, x in zip(findings, ((0.1 - part, 0.1), (0.0, part)), (0.1, 0.098), strict=True):
        assert found.s_range_m == pytest.approx(span, abs=1e-12)
        assert found.point_m == pytest.approx((x, 0.0, FRAGMENT_R), abs=1e-12)
        # The gap of 2 mm is smaller than the limit.
        assert found.value == pytest.approx(0.002, abs=1e-12)
        assert found.limit == pytest.approx(MAX_FACING_GAP_RADII * FRAGMENT_R, abs=1e-12)
        assert "an end of chain 0 and an end of chain 1 face each other at (98, 0, 4) mm" in found.message


def test_the_ends_of_a_ring_that_does_not_close_are_touching() -> None:
    turn = np.linspace(0.0, 2 * np.pi - 0.05, 200)
    ring = np.column_stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), np.full(200, FRAGMENT_R)])
    (one,), findings = mark_touching_ends([numbered_chain(0, ring)])
    assert one.ends == ("touching", "touching")
    assert {(found.code, found.chains, found.end) for found in findings} == {
        ("ends-touching", (0,), "first"),
        ("ends-touching", (0,), "last"),
    }
    assert all(found.message.startswith("the ends of chain 0 face each other") for found in findings)


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
    chains, findings = mark_touching_ends([numbered_chain(0, along_x(0.0, 0.1)), numbered_chain(1, other)])
    assert [one.ends for one in chains] == [("free", "free")] * 2
    assert findings == []


def test_an_end_is_free_only_if_free_space_is_seen_ahead_of_it(table_1: ChainParameters) -> None:
    views = captured(line((0, 0), (150, 0)))
    # the string goes on at the last end of the chain, as after a gap in the measurement
    assert mark_ends_without_free_space([ALONG_X], views, table_1)[0].ends == ("free", "unobserved")
    assert mark_ends_without_free_space([ALONG_X], views[:1], table_1)[0].ends == ("free", "unobserved")
    assert mark_ends_without_free_space([ALONG_X], [], table_1)[0].ends == ("free", "free"), "without depth images"
    touching = replace(ALONG_X, ends=("free", "touching"))
    assert mark_ends_without_free_space([touching], views, table_1)[0].ends == ("free", "touching")
    ring = replace(ALONG_X, closed=True)
    assert mark_ends_without_free_space([ring], views, table_1)[0].ends == ("free", "free")


def test_an_end_is_unobserved_where_no_depth_was_measured_ahead_of_it(table_1: ChainParameters) -> None:
    views = captured(ALONG_X.points)
    assert mark_ends_without_free_space([ALONG_X], views, table_1)[0].ends == ("free", "free")
    for view in views:
        assert view.image is not None
        rows, columns = np.indices(view.image.depth.shape)
        ahead = (np.array([0.11, 0.0, R]) - view.image.T_base_camera[:3, 3]) @ view.image.T_base_camera[:3, :3]
        column, row = (ahead @ view.image.K.T)[:2] / ahead[2]
        view.image.depth[np.hypot(rows - row, columns - column) < 30] = 0  # 30 pixels are about 18 mm
    assert mark_ends_without_free_space([ALONG_X], views, table_1)[0].ends == ("free", "unobserved")


@pytest.mark.parametrize(
    ("start_mm", "end_mm", "is_seen_to_end"),
    [
        ((130, 0), (200, 0), False),  # 30 mm on, in line
        ((125, 20), (125, 90), False),  # round a bend
        ((145, 0), (200, 0), True),  # farther than 9 r
        ((95, 20), (95, 90), True),  # behind the end
        ((125, 90), (125, 20), False),  # the last end of the other chain
        ((130, -40), (130, 40), True),  # the side of another string
    ],
)
def test_an_end_that_another_faces_is_unobserved_in_a_single_view(
    start_mm: tuple[float, float], end_mm: tuple[float, float], is_seen_to_end: bool, table_1: ChainParameters
) -> None:
    other = chain(line(start_mm, end_mm))
    (found, facing) = mark_ends_before_low_parts([ALONG_X, other], [], table_1)
    assert found.ends == ("free", "free" if is_seen_to_end else "unobserved")
    assert ("unobserved" in facing.ends) == (not is_seen_to_end)


def test_surface_beyond_a_low_part_leaves_an_end_unobserved(table_1: ChainParameters) -> None:
    (found,) = mark_ends_before_low_parts([ALONG_X], [line((130, 0), (140, 0))], table_1)
    assert found.ends == ("free", "unobserved")
    for elsewhere in (line((150, 0), (160, 0)), line((110, 20), (110, 30))):
        assert mark_ends_before_low_parts([ALONG_X], [elsewhere], table_1) == (ALONG_X,)
    assert mark_ends_before_low_parts([], [AHEAD], table_1) == ()


def test_no_chains_and_closed_chains_have_no_touching_ends() -> None:
    assert mark_touching_ends([]) == ((), [])
    closed = Chain(0, True, FRAGMENT_R, along_x(0.0, 0.001), np.full(40, 1e-4), np.full(40, 8), ("free", "free"))
    (same,), findings = mark_touching_ends([closed])
    assert (same.ends, findings) == (closed.ends, [])


def test_an_unobserved_end_is_a_doubt_and_at_the_border_a_note(table_1: ChainParameters) -> None:
    unobserved = replace(ALONG_X, id=3, ends=("unobserved", "unobserved"))
    # The last end is 2 mm from the border, less than r_f.
    scene = Scene(workspace_m=((-0.1, 0.102), (-0.1, 0.1), (0.0, 0.1)))
    first, last = unobserved_end_findings([unobserved, ALONG_X], scene, table_1)
    assert (first.code, first.severity, first.chains, first.end) == ("end-unobserved", "doubt", (3,), "first")
    assert (last.code, last.severity, last.chains, last.end) == ("end-at-border", "note", (3,), "last")
    assert first.point_m == pytest.approx((0.0, 0.0, R), abs=1e-12)
    assert last.point_m == pytest.approx((0.1, 0.0, R), abs=1e-12)
    assert first.s_range_m == pytest.approx((0.0, END_PART_RADII * R), abs=1e-12)
    assert last.s_range_m == pytest.approx((0.1 - END_PART_RADII * R, 0.1), abs=1e-12)


def test_the_part_of_a_short_chain_at_its_end_is_the_whole_chain(table_1: ChainParameters) -> None:
    short = chain(line((0, 0), (10, 0)))
    for ends in (("unobserved", "free"), ("free", "unobserved")):
        (found,) = unobserved_end_findings([replace(short, ends=ends)], Scene(), table_1)
        assert found.s_range_m == pytest.approx((0.0, 0.01), abs=1e-12)


@pytest.mark.parametrize(("scene", "seed"), [("overhand-knot", 13), ("settled", 14), ("coil", 12)])
def test_a_string_fragmented_by_a_radius_too_small_has_a_doubt(scene: str, seed: int) -> None:
    scan = simulate(make_scene(scene, seed), camera_model("ideal"), seed)
    known = Scene(scan.header.table_z_m, scan.header.workspace_m)
    model = recognise(scan.views, RecognitionRequest(radius_m=0.003), known).model
    # The radius is 29 % too small: a model without a doubt about the ends of the pieces must be the true one. Where the
    # string breaks depends on the processor. A piece ends at another piece, or at the side of a strand.
    whole = len(model.chains) == 1 and len(model.crossings) == len(scan.truth["crossings"])
    codes = {found.code for found in model.quality.doubts}
    assert whole or codes & {"ends-touching", "possible-branch"}
