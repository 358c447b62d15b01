"""Why views do not fit one another: the mistakes that people make with poses, each tried on the views.

A finding's code is one of

    board-mirrored     the pictures are mirrored, or the corners are numbered so
    poses-inverted     the flange poses, or the board's, are the other way round
    pairs-off-by-one   each picture goes with the pose before or after it
    degrees            rotation vectors in degrees were read as radians
    euler-angles       Euler angles and rotation vectors were mixed up
    quaternion-order   a quaternion's real part was taken from the wrong end
    board-moved        the board stood elsewhere from some view on
    tcp-changed        the camera sat elsewhere on what the arm calls its flange from some view on
    camera-moved       the same of a camera that stands in the cell
    poses-shuffled     the poses are those of these pictures, in another order
    inconsistent       none of these
"""

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.change_point import LARGEST_SQUARE, SHORTEST, Fit, fit_changes, fit_without_change
from calibration.assessment.rotation_conventions import reinterpret_rotations
from calibration.errors import HandEyeInputError
from calibration.geometry.se3 import invert_poses, rotation_angles
from calibration.observations import Mounting
from calibration.result import Finding
from calibration.solver.initialisation import InitialGuess, estimate_initial_guess

FITS_M, FITS_RAD = 0.01, np.radians(1.0)
"""A view that is off by less goes with the others, all but for noise: each mistake here throws most views farther."""
MOST = 0.8
"""Share of the views that must fit an explanation for it to be one."""
NEAR_M, NEAR_RAD, FEWEST_NEAR = 0.05, np.radians(6.0), 0.5
"""A solution is tried where so many of the views are within that of the best rough one: the coarsest camera's are."""
FEWEST = 8
"""Views with which explanations are tried; fewer fit anything."""
SHIFTS = (1, -1, 2, -2)
"""Pictures by which poses may be late or early."""
SHUFFLED_RAD = np.radians(0.5)
"""Turns between views, in order of size, agree so well (median) where only the order is wrong."""
LEAST_GAIN = 60.0
"""By which the squared residuals, in standard deviations, must fall for a move to be believed: six more unknowns and
the choice of the view take away some 20 by chance."""
LEAST_MOVE_M, LEAST_MOVE_RAD = 1.5e-3, np.radians(0.2)
"""Smaller moves pass: they are told by nothing but the noise."""


def diagnose(
    T_base_flange: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
    mounting: Mounting = "eye-in-hand",
    names: tuple[str, ...] | None = None,
) -> Finding | None:
    """Why the poses (N, 4, 4) of N views, called `names`, do not fit one another; None where they do.

    The poses are as given, finite and rigid. A few wrong views among good ones are no mistake of the kinds looked for.
    """
    A = T_base_flange if mounting == "eye-in-hand" else invert_poses(T_base_flange)
    B = T_camera_board
    if len(A) < FEWEST:
        return None if _fit_together(A, B) else _inconsistent()
    names = names or tuple(str(index) for index in range(len(A)))
    together = _fit_together(A, B)
    if not together:
        mistake = _inverted(A, B, mounting) or _shifted(A, B) or _misread(T_base_flange, B, mounting)
        if mistake is not None:
            return mistake
    moved = _moved(A, B, mounting, names)
    if moved is not None or together:
        return moved
    return _shuffled(A, B) or _inconsistent()


def check_together(
    start: InitialGuess,
    T_base_flange: NDArray[np.float64],
    T_camera_board: NDArray[np.float64],
    mounting: Mounting = "eye-in-hand",
    names: tuple[str, ...] | None = None,
) -> None:
    """Refuses poses (N, 4, 4) of which, by their best rough solution, most do not fit one another at all: nothing can
    be adjusted to them.

    Raises:
        HandEyeInputError: with the slug and the words of what `diagnose` finds.
    """
    if _share_within(start, NEAR_M, NEAR_RAD) < FEWEST_NEAR:
        finding = diagnose(T_base_flange, T_camera_board, mounting, names) or _inconsistent()
        raise HandEyeInputError(finding.code, finding.words)


def check_not_mirrored(T_camera_board: NDArray[np.float64]) -> None:
    """Refuses board poses (N, 4, 4) of which most see the board from behind, as only a mirror does.

    Raises:
        HandEyeInputError: "board-mirrored".
    """
    # The board's z points away from who looks at its front.
    behind = int((np.einsum("ni,ni->n", T_camera_board[:, :3, 2], T_camera_board[:, :3, 3]) < 0).sum())
    if behind > len(T_camera_board) / 2:
        raise HandEyeInputError(
            "board-mirrored",
            f"in {behind} of {len(T_camera_board)} views the board is seen from behind: switch off the camera's flip "
            "or mirror, or number the corners row by row from the top left of the print",
        )


def _share_within(start: InitialGuess, off_m: float, off_rad: float) -> float:
    return float(np.mean((start.off_m < off_m) & (start.off_rad < off_rad)))


def _fit_together(A: NDArray[np.float64], B: NDArray[np.float64]) -> bool:
    return _share_within(estimate_initial_guess(A, B), FITS_M, FITS_RAD) >= MOST


def _inverted(A: NDArray[np.float64], B: NDArray[np.float64], mounting: Mounting) -> Finding | None:
    if not _fit_together(invert_poses(A), B):
        return None
    other = "eye-to-hand" if mounting == "eye-in-hand" else "eye-in-hand"
    return _mistake(
        "poses-inverted",
        f"the views fit one another when the flange poses are inverted: check first that the mounting is not {other}; "
        "if it is as told, give T_base_flange, which maps flange points to the base (where board poses are given, "
        "T_camera_board)",
    )


def _shifted(A: NDArray[np.float64], B: NDArray[np.float64]) -> Finding | None:
    for shift in SHIFTS:
        poses, pictures = (A[shift:], B[:-shift]) if shift > 0 else (A[:shift], B[-shift:])
        if len(poses) >= FEWEST - 2 and _fit_together(poses, pictures):
            count, which = abs(shift), "after" if shift > 0 else "before"
            step = "right" if count == 1 else f"{count} places"
            return _mistake(
                "pairs-off-by-one",
                f"each picture fits the pose {step} {which} its own: pair every picture with the pose that was read "
                "while the arm stood for it, and look for a picture or a pose that is missing at one end",
            )
    return None


def _misread(T_base_flange: NDArray[np.float64], B: NDArray[np.float64], mounting: Mounting) -> Finding | None:
    # The flange turns between views as the camera does, seen from the board; or as the board on it, seen by the camera.
    turning = invert_poses(B) if mounting == "eye-in-hand" else B
    for guess, meant in reinterpret_rotations(T_base_flange[:, :3, :3], turning[:, :3, :3], FITS_RAD):
        corrected = T_base_flange.copy()
        corrected[:, :3, :3] = meant
        if _fit_together(corrected if mounting == "eye-in-hand" else invert_poses(corrected), B):
            return _mistake(
                guess.code,
                f"the directions of the flange poses are {guess.words}: give them as what they are (a rotation vector "
                "in radians, or a quaternion x, y, z, w)",
            )
    return None


def _moved(
    A: NDArray[np.float64], B: NDArray[np.float64], mounting: Mounting, names: tuple[str, ...]
) -> Finding | None:
    fits = fit_changes(A, B)
    # One measure for all: the noise that the best of them leaves.
    noise = min((fit.noise() for fit in fits), key=lambda sigmas: sigmas[0] * sigmas[1])
    best = min(fits, key=lambda fit: float(fit.squares(noise).sum()))
    if not _believable(best, fit_without_change(A, B), noise):
        return None
    assert best.shift is not None
    turned, off = np.degrees(np.linalg.norm(best.shift[:3])), 1e3 * np.linalg.norm(best.shift[3:])
    code, what = {
        ("Y", "eye-in-hand"): ("board-moved", "the board stands elsewhere: fasten it"),
        ("X", "eye-in-hand"): (
            "tcp-changed",
            "the camera sits elsewhere on the flange: give every pose of the bare flange, not of a tool that was "
            "changed meanwhile, and fasten the camera",
        ),
        ("Y", "eye-to-hand"): (
            "board-moved",
            "the board sits elsewhere on the flange: fasten it, and give every pose of the bare flange, not of a tool "
            "that was changed meanwhile",
        ),
        ("X", "eye-to-hand"): ("camera-moved", "the camera stands elsewhere in the cell: fasten it"),
    }[best.moved or "Y", mounting]
    return _mistake(
        code, f"from view {names[best.first]} on, by {off:.1f} mm and {turned:.2f} degrees, {what}, and begin anew"
    )


def _believable(best: Fit, steady: Fit, noise: tuple[float, float]) -> bool:
    """Whether it is a move, and not two bad views or chance."""
    assert best.shift is not None
    fitting = best.squares(noise) < LARGEST_SQUARE
    enough = (
        fitting.mean() >= MOST
        and fitting[: best.first].sum() >= SHORTEST
        and fitting[best.first :].sum() >= SHORTEST
        and noise[0] < FITS_RAD / 2
        and noise[1] < FITS_M / 2
    )
    far = np.linalg.norm(best.shift[3:]) > LEAST_MOVE_M or np.linalg.norm(best.shift[:3]) > LEAST_MOVE_RAD
    gain = float(steady.squares(noise).sum() - best.squares(noise).sum())
    return bool(enough and far and gain > LEAST_GAIN)


def _shuffled(A: NDArray[np.float64], B: NDArray[np.float64]) -> Finding | None:
    first, second = np.triu_indices(len(A), k=1)
    arm = rotation_angles(A[first, :3, :3].swapaxes(1, 2) @ A[second, :3, :3])
    camera = rotation_angles(B[first, :3, :3] @ B[second, :3, :3].swapaxes(1, 2))
    alike, in_order = np.median(np.abs(np.sort(arm) - np.sort(camera))), np.median(np.abs(arm - camera))
    if alike > SHUFFLED_RAD or in_order < 2 * SHUFFLED_RAD:
        return None
    return _mistake(
        "poses-shuffled",
        "the poses go with these pictures, but in another order: pair every picture with the pose that was read while "
        "the arm stood for it, and do not rely on the order in which files are listed",
    )


def _inconsistent() -> Finding:
    return _mistake(
        "inconsistent",
        "the views do not fit one another, and no single mistake explains it: read each pose with its picture while "
        "the arm is at rest, check that T_base_flange is in metres and that its rotation was not read by another rule, "
        "and that board and camera sit firmly",
    )


def _mistake(code: str, words: str) -> Finding:
    return Finding(code, words, refuses=True)
