"""Diagnosis of inconsistent views: test which common mistake with poses explains the views.

The codes of the findings are

    board-mirrored     the images are mirrored, or the corners are numbered in mirrored order
    poses-inverted     the flange poses or the board poses are inverted
    pairs-off-by-one   each image belongs to the pose of an earlier or a later view
    degrees            rotation vectors in degrees were read as radians
    euler-angles       Euler angles and rotation vectors were mixed up
    quaternion-order   the real part of quaternions was read at the wrong end
    board-moved        the board was moved after some view
    tcp-changed        the reported flange frame, or the camera on the flange, changed after some view
    camera-moved       the camera in the cell was moved after some view (eye-to-hand)
    poses-shuffled     the poses belong to these images, in another order
    inconsistent       no mistake in this list explains the views
"""

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.change_point import (
    MAX_CHI2,
    MIN_VIEWS_PER_SIDE,
    Fit,
    Moved,
    PoseNoise,
    fit_changes,
    fit_without_change,
)
from calibration.assessment.rotation_conventions import reinterpret_rotations
from calibration.errors import HandEyeInputError
from calibration.geometry.se3 import invert_poses, rotation_angles
from calibration.observations import Mounting
from calibration.result import Finding
from calibration.solver.initialisation import InitialGuess, equation_poses, estimate_initial_guess

MAX_FIT_DEVIATION_M = 0.01
"""Maximum distance of a fitting view, metres. Noise causes smaller deviations. Each mistake in the list causes larger
deviations in most views."""
MAX_FIT_DEVIATION_RAD = np.radians(1.0)
"""Maximum rotation of a fitting view, radians, for the same reason."""
MIN_FITTING_SHARE = 0.8
"""Minimum fraction of fitting views for an explanation."""
NEAR_M = 0.05
"""Maximum distance of a view near the initial guess, metres. Even the coarsest camera has smaller errors."""
NEAR_RAD = np.radians(6.0)
"""Maximum rotation of a view near the initial guess, radians."""
MIN_NEAR_SHARE = 0.5
"""Minimum fraction of the views that must be near the initial guess to start the solver."""
MIN_VIEWS = 8
"""Minimum number of views for a diagnosis. Fewer views fit any explanation."""
SHIFTS = (1, -1, 2, -2)
"""Offsets between images and poses that are tested, in views."""
MIN_SHIFTED_VIEWS = MIN_VIEWS - 2
"""Minimum number of shifted views. The largest shift leaves two views without a partner."""
SHUFFLED_RAD = np.radians(0.5)
"""Limit for poses in the wrong order, radians. It is the maximum median difference between the sorted rotation angles
of the flange and the sorted rotation angles of the camera."""
MIN_CHI2_GAIN = 60.0
"""Minimum reduction of chi-square for a change of X or Y. Without a change, six more unknowns and the choice of the
view reduce chi-square by about 20."""
MIN_MOVE_M = 1.5e-3
"""Minimum translation of X or Y that is reported, metres. Noise may cause smaller changes."""
MIN_MOVE_RAD = np.radians(0.2)
"""Minimum rotation of X or Y that is reported, radians."""
MOVES: dict[tuple[Moved, Mounting], tuple[str, str]] = {
    ("Y", "eye-in-hand"): ("board-moved", "the board was moved: fasten it"),
    ("X", "eye-in-hand"): (
        "tcp-changed",
        "the camera moved on the flange, or the reported flange frame changed: give all poses of the bare flange, "
        "not of a tool that was changed, and fasten the camera",
    ),
    ("Y", "eye-to-hand"): (
        "board-moved",
        "the board moved on the flange, or the reported flange frame changed: fasten the board, and give all poses "
        "of the bare flange, not of a tool that was changed",
    ),
    ("X", "eye-to-hand"): ("camera-moved", "the camera in the cell was moved: fasten it"),
}
"""Code and description of a change of X or Y."""


def diagnose(
    T_base_flange: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
    mounting: Mounting = "eye-in-hand",
    names: tuple[str, ...] | None = None,
) -> Finding | None:
    """Find the mistake that makes the views inconsistent.

    A few outliers among consistent views are not reported.

    Args:
        T_base_flange: (N, 4, 4) flange poses, finite and rigid, metres.
        T_camera_board: (N, 4, 4) board poses in the camera frame, metres.
        mounting: Whether the camera is on the flange or in the cell.
        names: Names of the N views for the message. None: the indices of the views.

    Returns:
        The finding, or None if the views are consistent.
    """
    A = equation_poses(T_base_flange, mounting)
    B = T_camera_board
    names = names or tuple(str(index) for index in range(len(A)))
    together = _fit_together(A, B)
    if len(A) < MIN_VIEWS:
        return None if together else _inconsistent()
    if not together:
        mistake = _inverted(A, B, mounting) or _shifted(A, B) or _misread(T_base_flange, B, mounting)
        if mistake is not None:
            return mistake
    moved = _moved(A, B, mounting, names)
    if moved is not None or together:
        return moved
    return _shuffled(A, B) or _inconsistent()


def check_consistent_start(
    start: InitialGuess,
    T_base_flange: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
    mounting: Mounting,
    names: tuple[str, ...],
) -> None:
    """Check that enough views are near the initial guess to start the solver.

    Args:
        start: Initial guess from the N views.
        T_base_flange: (N, 4, 4) flange poses, metres.
        T_camera_board: (N, 4, 4) board poses in the camera frame, metres.
        mounting: Whether the camera is on the flange or in the cell.
        names: Names of the N views for the message.

    Raises:
        HandEyeInputError: Too few views are near the initial guess. `diagnose` gives the slug and the message.
    """
    if _share_within(start, NEAR_M, NEAR_RAD) < MIN_NEAR_SHARE:
        finding = diagnose(T_base_flange, T_camera_board, mounting, names) or _inconsistent()
        raise HandEyeInputError(finding.code, finding.message)


def check_not_mirrored(T_camera_board: NDArray[np.float64]) -> None:
    """Check that most views see the front of the board.

    Args:
        T_camera_board: (N, 4, 4) board poses in the camera frame, metres.

    Raises:
        HandEyeInputError: Most views see the board from behind, as in mirrored images (`board-mirrored`).
    """
    # The z axis of the board points into the board, away from a camera in front of the board.
    behind = int((np.einsum("ni,ni->n", T_camera_board[:, :3, 2], T_camera_board[:, :3, 3]) < 0).sum())
    if behind > len(T_camera_board) / 2:
        raise HandEyeInputError(
            "board-mirrored",
            f"{behind} of {len(T_camera_board)} views see the board from behind: switch off the flip or mirror setting "
            "of the camera, or number the corners row by row from the top left of the print",
        )


def _share_within(start: InitialGuess, deviation_m: float, deviation_rad: float) -> float:
    return float(np.mean((start.deviation_m < deviation_m) & (start.deviation_rad < deviation_rad)))


def _fit_together(A: NDArray[np.float64], B: NDArray[np.float64]) -> bool:
    return _share_within(estimate_initial_guess(A, B), MAX_FIT_DEVIATION_M, MAX_FIT_DEVIATION_RAD) >= MIN_FITTING_SHARE


def _inverted(A: NDArray[np.float64], B: NDArray[np.float64], mounting: Mounting) -> Finding | None:
    if not _fit_together(invert_poses(A), B):
        return None
    other = "eye-to-hand" if mounting == "eye-in-hand" else "eye-in-hand"
    return _mistake(
        "poses-inverted",
        f"the views fit one another if the flange poses are inverted: check first that the mounting is not {other}; "
        "if the mounting is right, give T_base_flange, which maps flange points to the base "
        "(and T_camera_board, which maps board points to the camera)",
    )


def _shifted(A: NDArray[np.float64], B: NDArray[np.float64]) -> Finding | None:
    for shift in SHIFTS:
        if shift > 0:
            poses = A[shift:]
            images = B[:-shift]
        else:
            poses = A[:shift]
            images = B[-shift:]
        if len(poses) >= MIN_SHIFTED_VIEWS and _fit_together(poses, images):
            step = "right" if abs(shift) == 1 else f"{abs(shift)} views"
            side = "after" if shift > 0 else "before"
            return _mistake(
                "pairs-off-by-one",
                f"each image fits the pose {step} {side} its own: pair each image with the pose that was read while "
                "the arm stood still for it, and look for an image or a pose that is missing at one end",
            )
    return None


def _misread(T_base_flange: NDArray[np.float64], B: NDArray[np.float64], mounting: Mounting) -> Finding | None:
    # Between two views, the flange rotates by the same angle as the camera (eye-in-hand) or the board (eye-to-hand).
    rotating = invert_poses(B) if mounting == "eye-in-hand" else B
    for guess, meant in reinterpret_rotations(T_base_flange[:, :3, :3], rotating[:, :3, :3], MAX_FIT_DEVIATION_RAD):
        corrected = T_base_flange.copy()
        corrected[:, :3, :3] = meant
        if _fit_together(equation_poses(corrected, mounting), B):
            return _mistake(
                guess.code,
                f"the rotations of the flange poses are {guess.description}: give them in their true convention (a "
                "rotation vector in radians, or a quaternion x, y, z, w)",
            )
    return None


def _moved(
    A: NDArray[np.float64], B: NDArray[np.float64], mounting: Mounting, names: tuple[str, ...]
) -> Finding | None:
    fits = fit_changes(A, B)
    # Compare all fits with the same noise: the smallest noise of any fit.
    noise = min((fit.noise() for fit in fits), key=lambda noise: noise.rad * noise.m)
    best = min(fits, key=lambda fit: float(fit.squares(noise).sum()))
    if not _is_significant(best, fit_without_change(A, B), noise):
        return None
    assert best.shift is not None
    assert best.moved is not None
    distance_mm = 1e3 * np.linalg.norm(best.shift[3:])
    degrees = np.degrees(np.linalg.norm(best.shift[:3]))
    code, what = MOVES[best.moved, mounting]
    return _mistake(
        code,
        f"from view {names[best.first]} on, by {distance_mm:.1f} mm and {degrees:.2f} degrees, {what}, and start again",
    )


def _is_significant(best: Fit, unchanged: Fit, noise: PoseNoise) -> bool:
    """Return whether a change of X or Y explains the views better than noise or two outliers."""
    assert best.shift is not None
    fitting = best.squares(noise) < MAX_CHI2
    enough = (
        fitting.mean() >= MIN_FITTING_SHARE
        and fitting[: best.first].sum() >= MIN_VIEWS_PER_SIDE
        and fitting[best.first :].sum() >= MIN_VIEWS_PER_SIDE
        and noise.rad < MAX_FIT_DEVIATION_RAD / 2
        and noise.m < MAX_FIT_DEVIATION_M / 2
    )
    far = np.linalg.norm(best.shift[3:]) > MIN_MOVE_M or np.linalg.norm(best.shift[:3]) > MIN_MOVE_RAD
    gain = float(unchanged.squares(noise).sum() - best.squares(noise).sum())
    return bool(enough and far and gain > MIN_CHI2_GAIN)


def _shuffled(A: NDArray[np.float64], B: NDArray[np.float64]) -> Finding | None:
    first, second = np.triu_indices(len(A), k=1)
    arm = rotation_angles(A[first, :3, :3].swapaxes(1, 2) @ A[second, :3, :3])
    camera = rotation_angles(B[first, :3, :3] @ B[second, :3, :3].swapaxes(1, 2))
    difference_in_order = np.median(np.abs(arm - camera))
    difference_sorted = np.median(np.abs(np.sort(arm) - np.sort(camera)))
    if difference_sorted > SHUFFLED_RAD or difference_in_order < 2 * SHUFFLED_RAD:
        return None
    return _mistake(
        "poses-shuffled",
        "the poses belong to these images, but in another order: pair each image with the pose that was read while the "
        "arm stood still for it, and do not rely on the order in which files are listed",
    )


def _inconsistent() -> Finding:
    return _mistake(
        "inconsistent",
        "the views do not fit one another, and no single mistake explains it: read each pose with its image while the "
        "arm is at rest, check that T_base_flange is in metres and that its rotation has the right convention, and "
        "that board and camera are firm",
    )


def _mistake(code: str, message: str) -> Finding:
    return Finding(code, message, blocking=True)
