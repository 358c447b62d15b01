"""Common mistakes with poses are named, and good views have no finding."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.assessment.diagnosis import diagnose
from calibration.geometry.transforms import from_rotation_vector, inverse
from calibration.observations import Mounting
from calibration.result import Finding
from tests.calibration.board_views import random_plan, realistic_plan, record

pytestmark = pytest.mark.slow

MOUNTINGS: tuple[Mounting, ...] = ("eye-in-hand", "eye-to-hand")
SEEDS = (1, 2)


def poses(seed: int, mounting: Mounting = "eye-in-hand", count: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Return T_base_flange and T_camera_board of good views, with board poses as exact as for 0.2 px at 0.4 m."""
    recorded = record(seed, count, plan=(random_plan, realistic_plan)[seed % 2], mounting=mounting)
    rng = np.random.default_rng(seed)
    errors = [from_rotation_vector(rng.normal(0, 1.5e-4, 3), rng.normal(0, np.radians(0.04), 3)) for _ in range(count)]
    return recorded.T_base_flange, recorded.T_camera_board @ np.array(errors)


def with_rotations(T: np.ndarray, rotations: Rotation) -> np.ndarray:
    result = T.copy()
    result[:, :3, :3] = rotations.as_matrix()
    return result


def rotations(T: np.ndarray) -> Rotation:
    return Rotation.from_matrix(T[:, :3, :3])


def code(finding: Finding | None) -> str | None:
    return None if finding is None else finding.code


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("seed", range(4))
def test_good_views_have_no_finding(seed, mounting):
    assert diagnose(*poses(seed, mounting), mounting) is None


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("seed", SEEDS)
def test_shuffled_poses_are_named(seed, mounting):
    A, B = poses(seed, mounting)
    assert code(diagnose(A[np.random.default_rng(seed).permutation(12)], B, mounting)) == "poses-shuffled"


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("shift", [1, -1, 2])
def test_poses_off_by_one_are_named(shift, mounting):
    A, B = poses(3, mounting)
    finding = diagnose(np.roll(A, shift, axis=0), B, mounting)
    assert finding is not None
    assert finding.code == "pairs-off-by-one"
    assert ("after" if shift > 0 else "before") in finding.message


def test_a_missing_first_pose_is_named_as_off_by_one():
    A, B = poses(4)
    assert code(diagnose(A[1:], B[:-1])) == "pairs-off-by-one"


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("seed", SEEDS)
def test_inverted_poses_are_named(seed, mounting):
    A, B = poses(seed, mounting)
    assert code(diagnose(np.array([inverse(T) for T in A]), B, mounting)) == "poses-inverted"
    # Inverted board poses are equivalent, so the message names both.
    finding = diagnose(A, np.array([inverse(T) for T in B]), mounting)
    assert finding is not None
    assert finding.code == "poses-inverted"
    assert "T_camera_board" in finding.message


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_the_wrong_mounting_is_named(mounting):
    A, B = poses(5, mounting)
    other = MOUNTINGS[1 - MOUNTINGS.index(mounting)]
    finding = diagnose(A, B, other)
    assert finding is not None
    assert finding.code == "poses-inverted"
    assert f"the mounting is not {mounting}" in finding.message


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("seed", SEEDS)
def test_degrees_read_as_radians_are_named(seed, mounting):
    A, B = poses(seed, mounting)
    wrong = with_rotations(A, Rotation.from_rotvec(rotations(A).as_rotvec(degrees=True)))
    assert code(diagnose(wrong, B, mounting)) == "degrees"


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("order", ["xyz", "ZYX"])
def test_rotation_vectors_read_as_euler_angles_are_named(order, mounting):
    A, B = poses(6, mounting)
    finding = diagnose(with_rotations(A, Rotation.from_euler(order, rotations(A).as_rotvec())), B, mounting)
    assert finding is not None
    assert finding.code == "euler-angles"
    assert "rotation vectors that were read as Euler angles" in finding.message


@pytest.mark.parametrize("order", ["xyz", "zyz"])
def test_euler_angles_read_as_rotation_vectors_are_named(order):
    A, B = poses(7)
    finding = diagnose(with_rotations(A, Rotation.from_rotvec(rotations(A).as_euler(order))), B)
    assert finding is not None
    assert finding.code == "euler-angles"
    assert f"Euler angles {order} that were read as rotation vectors" in finding.message


@pytest.mark.parametrize("roll", [1, -1])
def test_a_wrong_quaternion_order_is_named(roll):
    A, B = poses(8)
    wrong = with_rotations(A, Rotation.from_quat(np.roll(rotations(A).as_quat(), roll, axis=1)))
    assert code(diagnose(wrong, B)) == "quaternion-order"


@pytest.mark.parametrize(("mounting", "expected"), [("eye-in-hand", "tcp-changed"), ("eye-to-hand", "board-moved")])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_change_of_the_tool_is_named_with_its_view(seed, mounting, expected):
    # With the board on the flange, a new tool frame and a slipped board are equivalent, so the message names both.
    A, B = poses(seed, mounting)
    A[5:] = A[5:] @ from_rotation_vector([0.02, -0.01, 0.12], [0.1, 0.05, 0.5])
    finding = diagnose(A, B, mounting, tuple("abcdefghijkl"))
    assert finding is not None
    assert finding.code == expected
    assert "from view f on" in finding.message
    assert "tool" in finding.message


@pytest.mark.parametrize("offset_m", [0.003, 0.01, 0.2])
@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_a_board_that_moved_is_named_with_its_displacement(offset_m, mounting):
    A, B = poses(9, mounting)
    B[6:] = B[6:] @ from_rotation_vector([0.8 * offset_m, -0.6 * offset_m, 0.0], [0.0, 0.0, 0.0])
    finding = diagnose(A, B, mounting)
    assert finding is not None
    assert finding.code == "board-moved"
    # 3 mm over six views each with noise of 0.2 mm: known to some tenths of a millimetre.
    reported_mm = float(finding.message.split(" by ")[1].split(" mm")[0])
    assert reported_mm == pytest.approx(1e3 * offset_m, abs=0.5)


def test_a_fixed_camera_that_moved_is_named():
    A, B = poses(10, "eye-to-hand")
    B[7:] = from_rotation_vector([0.03, 0.0, 0.01], [0.0, 0.05, 0.0]) @ B[7:]
    assert code(diagnose(A, B, "eye-to-hand")) == "camera-moved"


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_a_few_bad_views_are_not_a_movement(mounting):
    A, B = poses(11, mounting)
    one, last_two, swapped = B.copy(), B.copy(), A.copy()
    one[11] = one[11] @ from_rotation_vector([0.01, 0.0, 0.0], [0.0, 0.0, 0.0])
    last_two[10:] = last_two[10:] @ from_rotation_vector([0.01, 0.0, 0.0], [0.0, 0.0, 0.0])
    swapped[[2, 7]] = swapped[[7, 2]]
    assert diagnose(A, one, mounting) is None
    assert diagnose(A, last_two, mounting) is None
    assert diagnose(swapped, B, mounting) is None


@pytest.mark.parametrize("seed", SEEDS)
def test_unrelated_poses_are_inconsistent(seed):
    B = poses(seed)[1]
    A = poses(seed + 20)[0]
    finding = diagnose(A, B)
    assert finding is not None
    assert finding.code == "inconsistent"
    assert finding.blocking
