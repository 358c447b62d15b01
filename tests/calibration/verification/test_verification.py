"""Verification with views of a known cell. The noise is that of a good arm, 0.1 mm and 0.02 degrees."""

import json
import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.errors import HandEyeInputError, HandEyeInvalidError, HandEyeMismatchError
from calibration.geometry.transforms import from_rotation_vector, inverse
from calibration.hand_eye import solve_hand_eye
from calibration.observations import Observations
from calibration.result import HandEyeResult
from calibration.storage.hand_eye_file import load_hand_eye, write_hand_eye, write_result
from calibration.target.board import Board
from calibration.target.corner_ordering import symmetric_numberings
from calibration.verification.verification import Verification, VerificationView, verification_findings, verify
from tests.calibration.board_views import NOISE_FREE, Noise, Plan, Recorded, look_at, orbit_plan, realistic_plan, record

pytestmark = pytest.mark.slow

SOLVED_FROM, SEEDS = 15, range(6)
STILL = np.eye(4)
ROUGH_ARM = Noise(pixel_px=0.05, robot_m=2.9e-4, robot_rad=float(np.radians(0.06)))


def plan(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return camera poses of a cell, then two from opposite sides."""
    side = rng.uniform(-np.pi, np.pi)
    two = [look_at(np.radians(30), side + np.pi * k, np.radians((25, -25)[k]), 0.36) for k in range(2)]
    return np.concatenate([realistic_plan(rng, count - 2), two])


@dataclass(frozen=True, eq=False)
class Case:
    recorded: Recorded
    result: HandEyeResult

    def later(self, camera: NDArray[np.float64] = STILL, board: NDArray[np.float64] = STILL) -> Observations:
        """Return the two views after displacements of the camera and the board, each in its own frame."""
        X, Y, observations = self.recorded.X, self.recorded.Y, self.recorded.observations
        # The images are unchanged. The robot would have another pose for the same image.
        T_base_flange = [
            Y @ board @ inverse(Y) @ view.T_base_flange @ X @ inverse(camera) @ inverse(X)
            for view in observations.views[SOLVED_FROM:]
        ]
        views = [
            replace(v, T_base_flange=T) for v, T in zip(observations.views[SOLVED_FROM:], T_base_flange, strict=True)
        ]
        return replace(observations, views=tuple(views))


def orbit_then_two(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return camera poses at one distance, which do not determine the board size, then two from opposite sides."""
    two = [look_at(np.radians(30), np.pi * k, np.radians((25, -25)[k]), 0.4) for k in range(2)]
    return np.concatenate([orbit_plan(rng, count - 2), two])


def realistic_then_near(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return camera poses of a cell, then two from nearly the same side."""
    side = rng.uniform(-np.pi, np.pi)
    two = [look_at(np.radians(tilt), side, 0.0, 0.36) for tilt in (0.1, 22.0)]
    return np.concatenate([realistic_plan(rng, count - 2), two])


@cache
def case(seed: int, noise: Noise | None = None, plan: Plan = plan) -> Case:
    recorded = record(seed, SOLVED_FROM + 2, noise, plan)
    observations = recorded.observations
    return Case(recorded, solve_hand_eye(replace(observations, views=observations.views[:SOLVED_FROM])))


def direction(seed: int) -> NDArray[np.float64]:
    v = np.random.default_rng(seed).normal(size=3)
    return v / np.linalg.norm(v)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_valid_calibration_passes(seed: int) -> None:
    verification = verify(case(seed).result, case(seed).later())
    assert verification.passed
    assert verification.board_displacement_m is None
    assert [view.name for view in verification.views] == ["16", "17"]
    # 0.02 degrees at 0.5 m and 0.1 mm along each of three axes give 0.35 mm, plus the uncertainty of X.
    assert 0.0002 < verification.expected_m < 0.0006
    assert verification.max_deviation_m < 3 * verification.expected_m


def test_without_noise_the_deviation_is_exact() -> None:
    still = case(0, NOISE_FREE)
    verification = verify(still.result, still.later())
    assert verification.passed
    assert verification.max_deviation_m < 1e-9
    moved = verify(still.result, still.later(camera=from_rotation_vector((0.003, 0, 0), (0, 0, 0))))
    assert moved.max_deviation_m == pytest.approx(0.003, abs=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("off_m", "off_degrees"), [(0.003, 0.0), (0.0, 0.6)])
def test_a_moved_camera_is_detected(seed: int, off_m: float, off_degrees: float) -> None:
    u = direction(seed)
    drift = from_rotation_vector(off_m * u, np.radians(off_degrees) * u)
    verification = verify(case(seed).result, case(seed).later(camera=drift))
    assert not verification.passed
    assert verification.board_displacement_m is None
    assert "calibrate again" in verification.message


@pytest.mark.parametrize("seed", range(8))
def test_two_views_together_detect_a_small_displacement(seed: int) -> None:
    # With arm errors of 0.06 degrees, the board of a single view is off by 1 mm, at most 3 mm.
    rough = case(seed, ROUGH_ARM)
    assert verify(rough.result, rough.later()).passed
    later = rough.later(camera=from_rotation_vector(0.002 * direction(seed), (0, 0, 0)))
    assert not verify(rough.result, later).passed


@pytest.mark.parametrize("along", [(0.0, 0.0, 0.003), (0.0, 0.0, -0.003)])
def test_a_camera_moved_along_its_view_is_detected(along: tuple[float, float, float]) -> None:
    verification = verify(case(1).result, case(1).later(camera=from_rotation_vector(along, (0, 0, 0))))
    assert not verification.passed


@pytest.mark.parametrize("seed", SEEDS)
def test_a_moved_board_does_not_fail_the_calibration(seed: int) -> None:
    u = direction(seed)
    moved = from_rotation_vector((0.02 * u[0], 0.02 * u[1], 0.0), (0, 0, 0.3 * u[2]))
    verification = verify(case(seed).result, case(seed).later(board=moved))
    assert verification.passed
    middle = np.append(case(seed).recorded.observations.board.points.mean(axis=0), 1.0)
    way = float(np.linalg.norm((moved @ middle - middle)[:3]))
    assert verification.board_displacement_m == pytest.approx(way, abs=0.001)  # three sigma of the mean of the views
    assert "the board was moved by" in verification.message


def rotation_in_place(degrees: float, tilt_degrees: float = 0.0) -> NDArray[np.float64]:
    """Return a rotation about the normal in the middle of the board, followed by a tilt about one of its sides."""
    middle = np.eye(4)
    middle[:3, 3] = case(0).recorded.observations.board.points.mean(axis=0)
    turned = from_rotation_vector((0, 0, 0), (0, 0, np.radians(degrees)))
    tilted = from_rotation_vector((0, 0, 0), (np.radians(tilt_degrees), 0, 0))
    return middle @ tilted @ turned @ inverse(middle)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("degrees", [1.0, -10.0, 90.0, 179.95])
def test_a_board_rotated_in_place_does_not_fail_the_calibration(degrees: float, seed: int) -> None:
    verification = verify(case(seed).result, case(seed).later(board=rotation_in_place(degrees)))
    assert verification.passed, verification.message
    # The displacement is noise. The rotation is measured to 0.05 degrees, near half a turn with either sign.
    assert verification.board_displacement_m is not None
    assert verification.board_rotation_rad is not None
    assert verification.board_displacement_m < 0.001
    assert np.degrees(verification.board_rotation_rad) == pytest.approx(abs(degrees), abs=0.15)
    expected = f"the board was turned by {np.degrees(verification.board_rotation_rad):.2f} degrees since"
    assert expected in verification.message


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("degrees", [0.4, 1.0, 5.0])
def test_a_camera_rotated_about_its_view_is_not_taken_for_a_rotated_board(degrees: float, seed: int) -> None:
    later = case(seed).later(camera=from_rotation_vector((0, 0, 0), (0, 0, np.radians(degrees))))
    verification = verify(case(seed).result, later)
    assert not verification.passed
    assert "degrees" in verification.message  # the rotation contradicts the calibration, not the position


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("moved", [(0.003, 0.0, 0.0), (0.0, 0.003, 0.0), (0.0, 0.0, 0.003)])
def test_a_moved_camera_is_detected_with_similar_views(moved: tuple[float, float, float], seed: int) -> None:
    # The views differ by 22 degrees with the same roll, so the board appears displaced nearly equally.
    near = case(seed, None, realistic_then_near)
    assert verify(near.result, near.later()).passed
    verification = verify(near.result, near.later(camera=from_rotation_vector(moved, (0, 0, 0))))
    assert not verification.passed, verification.message


def test_a_tilted_board_is_not_distinguished_from_a_rotated_camera() -> None:
    verification = verify(case(2).result, case(2).later(board=rotation_in_place(20, tilt_degrees=1.0)))
    assert not verification.passed
    tilt = float(verification.message.split("tilted by ")[1].split(maxsplit=1)[0])
    assert tilt == pytest.approx(1.0, abs=0.2)  # 0.1 degrees by the corners of one view


@pytest.mark.parametrize("seed", [204, 307, 321, 343])
def test_a_good_calibration_from_few_views_passes(seed: int) -> None:
    # Solved from eight views with arm errors of 0.06 degrees. These and two more of 250 cells would be refused if the
    # noise counted as known: the squared errors in standard deviations are 18 to 24, and the limit would be 16.3.
    recorded = record(seed, 10, ROUGH_ARM, realistic_plan)
    views = recorded.observations.views
    order = np.random.default_rng(seed).permutation(10)
    held, rest = order[:2], sorted(order[2:])
    result = solve_hand_eye(replace(recorded.observations, views=tuple(views[k] for k in rest)))
    verification = verify(result, replace(recorded.observations, views=tuple(views[k] for k in held)))
    assert verification.passed, verification.message
    assert verification.board_displacement_m is None


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("along_m", [0.003, -0.003])
def test_a_shift_along_the_view_is_detected_with_an_unverified_board_size(seed: int, along_m: float) -> None:
    # From one distance, the board size and the camera position along its view are known to 2 mm only.
    orbit = case(seed, None, orbit_then_two)
    assert orbit.result.covariance[5, 5] > 0.0015**2
    assert verify(orbit.result, orbit.later()).passed
    verification = verify(orbit.result, orbit.later(camera=from_rotation_vector((0, 0, along_m), (0, 0, 0))))
    assert not verification.passed
    assert verification.board_displacement_m is None


def test_a_raised_board_is_not_distinguished_from_a_moved_camera() -> None:
    # The z axis of the board points into the table.
    verification = verify(case(2).result, case(2).later(board=from_rotation_vector((0, 0, -0.004), (0, 0, 0))))
    assert not verification.passed
    assert "unless something was put under the board" in verification.message


def test_one_view_does_not_distinguish_board_and_camera() -> None:
    later = case(3).later(board=from_rotation_vector((0.02, 0, 0), (0, 0, 0)))
    verification = verify(case(3).result, replace(later, views=later.views[:1]))
    assert not verification.passed
    assert "take views from two sides" in verification.message


def test_two_views_from_one_side_do_not_distinguish_board_and_camera() -> None:
    # The camera was moved across its view. Two views from the same pose show the same as for a moved board.
    later = case(3).later(camera=from_rotation_vector((0.02, 0, 0), (0, 0, 0)))
    views = (later.views[0], replace(later.views[0], name="again"))
    verification = verify(case(3).result, replace(later, views=views))
    assert not verification.passed
    assert verification.board_displacement_m is None
    assert "take views from two sides" in verification.message


@pytest.mark.parametrize(
    "board",
    [
        Board(kind="circles", columns=7, rows=7, pitch_m=0.02),
        Board(kind="checkerboard", columns=9, rows=7, pitch_m=0.02),
    ],
)
def test_a_board_numbered_from_its_other_end_has_not_moved(board: Board) -> None:
    recorded = record(8, SOLVED_FROM + 2, plan=plan, board=board)
    views = recorded.observations.views
    result = solve_hand_eye(replace(recorded.observations, views=views[:SOLVED_FROM]))
    for numbers in symmetric_numberings(board)[1:]:
        for k in range(SOLVED_FROM, SOLVED_FROM + 2):
            later = [*views]
            later[k] = replace(views[k], ids=numbers[views[k].ids])
            verification = verify(result, replace(recorded.observations, views=tuple(later[SOLVED_FROM:])))
            assert verification.passed
            assert verification.board_displacement_m is None
            assert verification.max_deviation_m < 3 * verification.expected_m


@pytest.mark.parametrize("nothing", ["X", "Y", "K", "joint_covariance"])
def test_a_calibration_without_a_solution_does_not_pass(nothing: str) -> None:
    result = replace(case(0).result, **{nothing: np.full(getattr(case(0).result, nothing).shape, np.nan)})
    verification = verify(result, case(0).later())
    assert not verification.passed
    assert "has no solution" in verification.message


@pytest.mark.parametrize(
    ("changes", "slug"),
    [
        ({"T_base_flange": np.full((4, 4), np.nan)}, "not-finite"),
        ({"T_base_flange": np.diag([1.0, 1.0, -1.0, 1.0])}, "not-rigid"),
        ({"ids": np.arange(6) + 100, "pixels": np.full((6, 2), 300.0)}, "corners"),
        ({"ids": np.arange(6), "pixels": np.full((6, 2), np.nan)}, "not-finite"),
        ({"name": "17"}, "repeated-names"),
    ],
)
def test_invalid_views_are_refused(changes: dict[str, Any], slug: str) -> None:
    later = case(0).later()
    with pytest.raises(HandEyeInputError) as refused:
        verify(case(0).result, replace(later, views=(replace(later.views[0], **changes), later.views[1])))
    assert refused.value.slug == slug


def test_views_without_enough_corners_do_not_pass() -> None:
    later = case(0).later()
    few = tuple(replace(view, ids=view.ids[:3], pixels=view.pixels[:3]) for view in later.views)
    verification = verify(case(0).result, replace(later, views=few))
    assert not verification.passed
    assert "was not found in any view" in verification.message


def test_views_of_another_board_camera_or_mounting_are_refused(tmp_path: Path) -> None:
    solved_from = replace(case(0).recorded.observations, camera_id="A1", views=(), created=datetime.now(UTC))
    write_result(tmp_path / "hand_eye.json", case(0).result, solved_from)
    hand_eye = load_hand_eye(tmp_path / "hand_eye.json", max_age_days=1)
    later = replace(case(0).later(), camera_id="A1")
    assert verify(hand_eye, later).passed
    for changes, message in (
        ({"board": replace(later.board, pitch_m=0.021)}, r"pitch_m 0\.02,.*pitch_m 0\.021"),
        ({"camera_id": "B2"}, "camera A1, this is camera B2"),
        ({"mounting": "eye-to-hand"}, "is eye-in-hand, these views are eye-to-hand"),
    ):
        with pytest.raises(HandEyeMismatchError, match=message):
            verify(hand_eye, replace(later, **changes))
    with pytest.raises(HandEyeMismatchError, match="is eye-in-hand, these views are eye-to-hand"):
        verify(case(0).result, replace(later, mounting="eye-to-hand"))


def test_a_verification_without_views_does_not_pass() -> None:
    verification = verify(case(0).result, replace(case(0).later(), views=()))
    assert not verification.passed
    document = verification.to_json()
    assert document.pop("passed") is False
    assert "there is no view" in document.pop("message")
    assert document.pop("views") == []
    assert set(document) == {
        "max_deviation_m",
        "expected_m",
        "max_deviation_rad",
        "expected_rad",
        "board_displacement_m",
        "board_rotation_rad",
    }
    assert set(document.values()) == {None}


def verify_from_file(folder: Path, solved: Case) -> Verification:
    """Write a calibration to a file, and verify the calibration that is loaded from it."""
    observations = solved.recorded.observations
    solved_from = replace(observations, views=observations.views[:SOLVED_FROM], created=datetime.now(UTC))
    write_result(folder / "hand_eye.json", solved.result, solved_from)
    return verify(load_hand_eye(folder / "hand_eye.json", max_age_days=1), solved.later())


def test_a_loaded_calibration_has_the_same_verification(tmp_path: Path) -> None:
    loaded = verify_from_file(tmp_path, case(4))
    straight = verify(case(4).result, case(4).later())
    assert loaded.max_deviation_m == pytest.approx(straight.max_deviation_m, abs=1e-9)
    assert loaded.expected_m == pytest.approx(straight.expected_m, rel=1e-6)
    assert loaded.message == straight.message


def test_a_file_without_its_number_of_views_counts_as_from_few(tmp_path: Path) -> None:
    straight = verify_from_file(tmp_path, case(4))
    document = json.loads((tmp_path / "hand_eye.json").read_text())
    del document["metrics"]["views_used"], document["views"]
    (tmp_path / "hand_eye.json").write_text(json.dumps(document))
    verification = verify(load_hand_eye(tmp_path / "hand_eye.json", max_age_days=1), case(4).later())
    assert (verification.passed, verification.expected_m) == (True, straight.expected_m)

    def detectable_mm(words: str) -> float:
        return float(words.split("about ")[1].split(maxsplit=1)[0])

    assert detectable_mm(verification.message) > 1.1 * detectable_mm(straight.message)


def test_the_verification_uses_the_fitted_camera_and_board() -> None:
    # The fitted camera and board have a tenth of the error of the given ones.
    wrong = case(5, Noise(focal=0.003, scale=0.002))
    verification = verify(wrong.result, wrong.later())
    assert verification.passed
    assert verification.max_deviation_m < 0.0012


def test_a_plain_file_cannot_be_verified(tmp_path: Path) -> None:
    write_hand_eye(tmp_path / "plain.json", case(0).result.X, created=datetime.now(UTC))
    with pytest.raises(HandEyeInvalidError, match="lacks the pose of the board"):
        verify(load_hand_eye(tmp_path / "plain.json", 1), case(0).later())


def test_images_of_another_size_are_refused() -> None:
    later = case(0).later()
    half = replace(later, K=later.K * [[0.5], [0.5], [1.0]])
    with pytest.raises(HandEyeMismatchError, match=r"focal length of 80\d px, these have 400 px"):
        verify(case(0).result, half)


def test_a_fixed_camera_is_verified() -> None:
    recorded = record(7, SOLVED_FROM + 2, plan=plan, mounting="eye-to-hand")
    views = recorded.observations.views
    result = solve_hand_eye(replace(recorded.observations, views=views[:SOLVED_FROM]))
    later = replace(recorded.observations, views=views[SOLVED_FROM:])
    assert verify(result, later).passed
    moved = [
        replace(v, T_base_flange=from_rotation_vector((0.004, 0, 0), (0, 0, 0)) @ v.T_base_flange) for v in later.views
    ]
    assert not verify(result, replace(later, views=tuple(moved))).passed


def verified(passed: bool, board_displacement_m: float | None = None, max_deviation_m: float = 0.004) -> Verification:
    view = VerificationView("16", max_deviation_m, 0.01, 0.0005, 0.0002)
    turned = None if board_displacement_m is None else 0.01
    return Verification(
        (view,),
        max_deviation_m,
        0.0005,
        0.01,
        0.0002,
        board_displacement_m,
        turned,
        passed,
        "the board appears elsewhere",
    )


def test_a_passed_verification_has_no_finding() -> None:
    assert verification_findings(verified(True)) == ()


@pytest.mark.parametrize("verification", [verified(False), verified(True, board_displacement_m=0.004)])
def test_a_displaced_board_is_a_blocking_finding(verification: Verification) -> None:
    (finding,) = verification_findings(verification)
    assert (finding.code, finding.blocking) == ("verification-failed", True)
    assert "4.0 mm and 0.57 degrees off, and about 0.5 mm and 0.01 degrees is expected" in finding.message


def test_a_rotated_board_is_reported_by_its_rotation() -> None:
    (finding,) = verification_findings(verified(False, max_deviation_m=0.0001))
    assert "0.1 mm and 0.57 degrees off, and about 0.5 mm and 0.01 degrees is expected" in finding.message


def test_a_verification_without_views_is_a_warning() -> None:
    nothing = Verification((), math.nan, math.nan, math.nan, math.nan, None, None, False, "there is no view")
    (finding,) = verification_findings(nothing)
    assert (finding.code, finding.blocking) == ("not-verified", False)
    assert finding.message.startswith("there is no view")
