"""What is known of the views' poses before their surfaces are compared, as a Gaussian.

A view's true pose is `E_k T_base_flange T_flange_camera E_h`: the robot errs anew in each view (E_k), the hand-eye
calibration alike in all (E_h, in the camera's frame), and so does a stereo camera whose disparities are offset.
Besides, each view has been levelled to the table (`recognition.preprocessing.table_plane`), which measured three of its
six directions.

State of V views: V twists, each a rotation vector and a translation (3 + 3) about one centre, then the calibration's
twist in the camera's frame (6), then the disparity offset (1): 6 V + 7 numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.geometry.transforms import from_rotation_vector
from recognition.preprocessing.normals import NormalCloud

COMMON = 7
"""Numbers of the state that all views share."""
_FITTED_POINTS = 50


@dataclass(frozen=True)
class PoseSigmas:
    """One sigma of each axis of what the poses are wrong by. An error's length is the square root of 3 of it."""

    robot_m: float = 0.0003
    """Place of the flange, anew in each view (0.5 mm in length)."""
    robot_rad: float = 0.001
    """Its orientation (0.1 degrees)."""
    hand_eye_m: float = 0.0004
    """Place of the camera on the flange, the same in all views (0.7 mm)."""
    hand_eye_rad: float = 0.0015
    """Its orientation (0.15 degrees)."""
    disparity_per_m: float = 0.002
    """Error of depth over depth squared, the same in all views: a disparity offset of 0.1 pixels at a baseline of
    75 mm and a focal length of 800 pixels."""
    level_m: float = 0.00015
    """Height of the table that a view sees, where it was levelled by it."""
    level_rad: float = 0.0015
    """Tilt of the same; stereo errors that repeat with the disparity bend a plane."""

    @property
    def common_information(self) -> NDArray[np.float64]:
        """(7, 7) inverse covariance of what all views share, beforehand: the calibration's twist, the offset."""
        common = np.repeat([self.hand_eye_rad, self.hand_eye_m], 3)
        return np.diag(np.append(common, self.disparity_per_m) ** -2.0)


@dataclass(frozen=True, eq=False)
class PosePrior:
    """The Gaussian of the state."""

    information: NDArray[np.float64]
    """(6 V + 7, 6 V + 7) inverse covariance."""
    gradient: NDArray[np.float64]
    """(6 V + 7,): the most probable state x is that of `information x = -gradient`."""
    robot: tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...]
    """For each view (D, d): `D x + d` (6,) are the robot's errors in sigmas."""


def pose_prior(clouds: Sequence[NormalCloud], centre: NDArray[np.float64], sigmas: PoseSigmas) -> PosePrior:
    """The prior of corrections to the poses as they are, `T_correction` being what they were corrected by so far.

    A cloud without `T_base_camera` errs about the centre.
    """
    size = 6 * len(clouds) + COMMON
    information = np.zeros((size, size))
    information[-COMMON:, -COMMON:] = sigmas.common_information
    gradient = np.zeros(size)
    in_sigmas = np.repeat([1 / sigmas.robot_rad, 1 / sigmas.robot_m], 3)
    robot = []
    for k, cloud in enumerate(clouds):
        own = slice(6 * k, 6 * k + 6)
        T = from_rotation_vector(centre, np.zeros(3)) if cloud.T_base_camera is None else cloud.T_base_camera
        turned = np.kron(np.eye(2), T[:3, :3])
        # From a twist about the centre to one about the camera, where robot and calibration err.
        to_camera = _shifted(T[:3, 3] - centre)
        D = np.zeros((6, size))
        D[:, own] = to_camera
        D[:, -COMMON:-1] = -turned
        if cloud.T_base_camera is not None:
            D[:, -1] = to_camera @ _stretch(cloud.points, T, centre)
        D *= in_sigmas[:, None]
        d = in_sigmas * (to_camera @ twist_of(cloud.T_correction, centre))
        information += D.T @ D
        gradient += D.T @ d
        if not np.array_equal(cloud.T_correction, np.eye(4)):
            level = np.array([sigmas.level_rad, sigmas.level_rad, np.inf, np.inf, np.inf, sigmas.level_m])
            information[own, own] += np.diag(level**-2.0)
        robot.append((D, d))
    return PosePrior(information, gradient, tuple(robot))


def twist_of(T: NDArray[np.float64], centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6,) rotation vector of `T` and the way it moves the centre (3,)."""
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, :3] @ centre + T[:3, 3] - centre])


def cross_matrix(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) matrix of the cross product `v x`."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _shifted(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6, 6) matrix that takes a small twist about a point to the same motion's twist about the point `way` off."""
    A = np.eye(6)
    A[3:, :3] = -cross_matrix(way)
    return A


def _stretch(points: NDArray[np.float64], T: NDArray[np.float64], centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6,) twist that best imitates what a disparity offset of one does to the points (N, 3) seen from `T`.

    It moves a point at the depth z by z times its way from the camera.
    """
    p = points[:: max(len(points) // _FITTED_POINTS, 1)]
    way = p - T[:3, 3]
    moved = (way @ T[:3, 2])[:, None] * way
    arm = p - centre
    x, y, z = arm.T
    zero, one = np.zeros(len(p)), np.ones(len(p))
    # Rows of [-arm x, I]: how the twist moves each point along x, y and z.
    A = np.stack(
        [
            np.column_stack([zero, z, -y, one, zero, zero]),
            np.column_stack([-z, zero, x, zero, one, zero]),
            np.column_stack([y, -x, zero, zero, zero, one]),
        ],
        axis=1,
    ).reshape(-1, 6)
    return np.asarray(np.linalg.lstsq(A.T @ A, A.T @ moved.ravel(), rcond=None)[0], dtype=np.float64)
