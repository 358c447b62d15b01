from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, inverse, transform_points
from cell.planning.look_at import look_at, two_rings
from recognition.depth_correction.depth_warp import CorrectedView
from recognition.errors import TableElsewhereError
from recognition.preprocessing.table_measurement import ViewPlane
from recognition.registration.measured_table import (
    MAX_SIGMA,
    MeasuredTable,
    MovedView,
    is_near,
    locate_table,
    refuse_doubtful_table,
)
from recognition.registration.pose_prior import PoseSigmas

POSES = [look_at(np.zeros(3), b.azimuth_rad, b.elevation_rad, 0.45, b.roll_rad) for b in two_rings(8)]
SIGMAS = PoseSigmas()


def as_seen(T_base_table: NDArray[np.float64], T_true: NDArray[np.float64], T_given: NDArray[np.float64]) -> ViewPlane:
    """Return the plane that a view shows at its given pose, if its true pose is another one."""
    T = T_given @ inverse(T_true) @ T_base_table
    normal = T[:3, 2]
    return ViewPlane(T_given, T[:3, 3], -normal[:2] / normal[2])


def noisy_planes(T_base_table: NDArray[np.float64], seed: int, scale: float = 1.0) -> list[ViewPlane]:
    """Return the planes of eight views with the errors of `PoseSigmas`."""
    rng = np.random.default_rng(seed)

    def error(rad: float, m: float) -> NDArray[np.float64]:
        return from_rotation_vector(scale * m * rng.standard_normal(3), scale * rad * rng.standard_normal(3))

    E_hand_eye = error(SIGMAS.hand_eye_rad, SIGMAS.hand_eye_m)
    planes = []
    for T in POSES:
        E_robot = error(SIGMAS.robot_rad, SIGMAS.robot_m)
        T_given = T @ E_hand_eye
        T_given[:3, :3] = E_robot[:3, :3] @ T_given[:3, :3]
        T_given[:3, 3] += E_robot[:3, 3]
        plane = as_seen(T_base_table, T, T_given)
        slope = plane.slope + scale * SIGMAS.table_rad * rng.standard_normal(2)
        centre = plane.centre + (0, 0, scale * SIGMAS.table_m * rng.standard_normal())
        planes.append(replace(plane, slope=slope, centre=centre))
    return planes


def table_at(height_m: float, tilt_deg: float, direction_rad: float = 0.5) -> NDArray[np.float64]:
    axis = np.array([np.cos(direction_rad), np.sin(direction_rad), 0.0])
    return from_rotation_vector((0, 0, height_m), np.deg2rad(tilt_deg) * axis)


def find_moved_table(planes: Sequence[ViewPlane | None], table_z_m: float) -> MeasuredTable | None:
    """Return where the views show the table, if it is elsewhere than given."""
    table = locate_table([plane for plane in planes if plane is not None], table_z_m)
    return table if table is not None and table.is_elsewhere else None


def errors_in_sigma(T_base_table: NDArray[np.float64], seeds: Sequence[int], scale: float = 1.0) -> list[float]:
    norms = []
    for seed in seeds:
        table = locate_table(noisy_planes(T_base_table, seed, scale), 0.0)
        assert table is not None
        normal = T_base_table[:3, 2]
        height = T_base_table[2, 3] - normal[:2] / normal[2] @ (table.centre[:2] - T_base_table[:2, 3])
        error = table.offset - (-normal[1], normal[0], height)
        norms.append(float(np.sqrt(error @ np.linalg.solve(table.covariance, error))))
    return norms


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_the_covariance_of_the_table_has_the_size_of_its_errors(scale: float) -> None:
    norms = np.array(errors_in_sigma(table_at(-0.006, 1.0), range(300), scale))
    assert norms.max() < MAX_SIGMA + (scale - 1)
    # three standard normal errors have the root mean square sqrt(3)
    assert 1.3 < np.sqrt(np.mean(norms**2)) < 2.1


def test_errors_of_the_poses_are_not_taken_for_another_table() -> None:
    moved = [find_moved_table(noisy_planes(np.eye(4), seed), 0.0) for seed in range(300)]
    assert moved == 300 * [None]


@pytest.mark.parametrize(("height_m", "tilt_deg"), [(0.004, 0.0), (-0.004, 0.0), (0.0, 0.3), (-0.006, 1.0)])
def test_another_table_is_found_with_its_height_and_tilt(height_m: float, tilt_deg: float) -> None:
    for seed in range(20):
        table = find_moved_table(noisy_planes(table_at(height_m, tilt_deg), seed), 0.0)
        assert table is not None
        assert table.height_m == pytest.approx(height_m, abs=2.5e-3)
        assert np.degrees(table.tilt_rad) == pytest.approx(tilt_deg, abs=0.16)


def test_a_large_rotation_of_the_calibration_is_not_taken_for_another_table() -> None:
    E_hand_eye = from_rotation_vector((0, 0, 0), np.deg2rad([0.6, -0.5, 0.4]))
    planes = [as_seen(np.eye(4), T, T @ E_hand_eye) for T in POSES]
    assert max(np.degrees(np.hypot(*plane.slope)) for plane in planes) > 0.5
    assert find_moved_table(planes, 0.0) is None
    # The same tilt in all views is a tilt of the table.
    assert find_moved_table([as_seen(table_at(0.0, 0.5), T, T) for T in POSES], 0.0) is not None


def test_the_motion_of_the_table_moves_the_given_plane_to_the_measured_one() -> None:
    T = table_at(-0.006, 1.5)
    table = locate_table([as_seen(T, pose, pose) for pose in POSES], 0.0)
    assert table is not None
    moved = transform_points(table.T_base_table, np.array([[0.2, -0.1, 0.0], [-0.2, 0.2, 0.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(transform_points(inverse(T), moved)[:, 2], 0.0, atol=2e-5)
    # far from the measured points, the tilt adds to the error of the height
    centres = np.array([(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)])
    near, far = (table.pose_covariance(table.covariance, centre) for centre in centres)
    assert near[5, 5] == pytest.approx(table.covariance[2, 2], rel=1e-6)
    assert far[5, 5] == pytest.approx(near[5, 5] + 0.25 * table.covariance[1, 1], rel=0.05)


def test_a_view_with_another_plane_is_left_out() -> None:
    planes = [as_seen(table_at(-0.005, 0.0), T, T) for T in POSES]
    planes[3] = replace(planes[3], centre=planes[3].centre + (0, 0, 0.02))
    table = find_moved_table(planes, 0.0)
    assert table is not None
    assert table.height_m == pytest.approx(-0.005, abs=1e-4)


def test_one_view_locates_the_table_with_the_whole_error_of_its_pose() -> None:
    planes = noisy_planes(table_at(-0.006, 1.0), seed=3)
    one, eight = locate_table(planes[:1], 0.0), locate_table(planes, 0.0)
    assert one is not None
    assert eight is not None
    assert np.all(np.diag(one.covariance) > np.diag(eight.covariance))
    assert one.height_m == pytest.approx(-0.006, abs=0.003)
    assert find_moved_table([planes[0], None, None], 0.0) is not None
    assert locate_table([], 0.0) is None
    assert find_moved_table([], 0.0) is None
    assert find_moved_table([None, None], 0.0) is None


def test_errors_of_one_pose_are_not_taken_for_another_table() -> None:
    offsets = []
    for seed in range(300):
        plane = noisy_planes(np.eye(4), seed)[0]
        table = locate_table([plane], 0.0)
        assert table is not None
        assert find_moved_table([plane], 0.0) is None
        offsets.append(table.distance_sigma)
    # three standard normal errors have the root mean square sqrt(3)
    assert 1.3 < np.sqrt(np.mean(np.square(offsets))) < 2.1


@pytest.mark.parametrize(
    ("height_m", "tilt_deg", "message"),
    [(-0.03, 0.0, "the table 30.0 mm lower than given"), (0.0, 4.5, "tilted by 4.50 degrees, more than")],
)
def test_a_table_far_from_the_given_one_is_refused_with_the_measured_values(
    height_m: float, tilt_deg: float, message: str
) -> None:
    planes = [as_seen(table_at(height_m, tilt_deg), T, T) for T in POSES]
    table = find_moved_table(planes, 0.0)
    assert table is not None
    with pytest.raises(TableElsewhereError, match=message):
        refuse_doubtful_table(table, planes)


def test_two_planes_that_may_be_the_table_are_refused() -> None:
    planes = [as_seen(table_at(0.006, 0.0), T, T) for T in POSES]
    table = find_moved_table(planes, 0.0)
    assert table is not None
    refuse_doubtful_table(table, planes)
    with pytest.raises(TableElsewhereError, match=r"6\.0 mm higher than given .* it is not known which is the table"):
        refuse_doubtful_table(table, [replace(plane, has_rival=True) for plane in planes])


def test_a_moved_view_keeps_its_images() -> None:
    depth = np.ones((4, 6), dtype=np.uint16)
    intensity = np.ones((4, 6), dtype=np.uint8)
    view = MovedView(CorrectedView(3, depth, 1e-4, np.eye(3), np.eye(4), intensity), table_at(0.1, 2.0))
    assert view.depth is depth
    assert view.intensity is intensity


def test_planes_are_compared_where_the_views_show_the_table() -> None:
    planes = [as_seen(np.eye(4), T, T) for T in POSES]
    assert is_near(table_at(0.0005, 0.1), np.eye(4), planes)
    assert not is_near(table_at(0.002, 0.0), np.eye(4), planes)
    assert not is_near(table_at(0.0, 0.5), np.eye(4), planes)
