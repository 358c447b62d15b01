"""Format a hand-eye calibration as text, in millimetres and degrees."""

import math
import textwrap
from collections.abc import Sequence

import numpy as np

from calibration.result import HandEyeResult, ViewReport
from calibration.verification.verification import Verification

NAME_WIDTH = 16
LINE_WIDTH = 120
VERDICTS = {
    "accept": "accept: it may be used",
    "warn": "warn: it may be used; read the warnings",
    "refuse": "refuse: it must not be used",
}
HEADS = ("corners", "rms px", "robot mm", "robot deg", "loo mm", "distance m")


def format_result(result: HandEyeResult, unusable: Sequence[tuple[str, str]] = ()) -> str:
    """Format a calibration result.

    Args:
        result: The calibration result.
        unusable: (name, reason) of each view that could not enter the solution.
    """
    camera = "T_flange_camera" if result.mounting == "eye-in-hand" else "T_base_camera"
    x, y, z = (_mm(value, 2) for value in result.X[:3, 3])
    rotation = ", ".join(_number(value, 2) for value in _rotation_vector_degrees(result))
    used = sum(view.used for view in result.views)
    lines = [
        _line("Verdict", VERDICTS[result.verdict]),
        *(_line("Refused" if f.blocking else "Warning", f"{f.message} ({f.code})") for f in result.findings),
        _line("Camera", f"{camera}: {x}, {y}, {z} mm, rotation vector {rotation} degrees"),
        _line("Uncertainty", f"{_mm(result.sigma_m)} mm and {_degrees(result.sigma_rad)} degrees (1 sigma, all axes)"),
        _line(
            "Repeatability",
            f"eight views of a scan differ by up to {_mm(result.repeatability_95_m)} mm (95 %, the worst two)",
        ),
        _line(
            "Leave-one-out",
            f"a view differs by {_mm(result.loo_error_m)} mm from what the others predict (rms)",
        ),
        _line(
            "Noise",
            f"corners {_number(result.pixel_sigma_px, 3)} px, robot {_mm(result.robot_sigma_m, 2)} mm and "
            f"{_degrees(result.robot_sigma_rad)} degrees along each axis",
        ),
        _line("Board", f"{_number(result.board_scale, 4)} +- {_number(result.board_scale_sigma, 4)} of the given size"),
        _line("Views", f"{used} used of {len(result.views) + len(unusable)}"),
        *_table(result.views),
        *(_line("Excluded", f"{view.name}: {view.reason}") for view in result.views if not view.used),
        *(_line("Unusable", f"{name}: {reason}") for name, reason in unusable),
    ]
    return "\n".join(lines)


def format_verification(verification: Verification) -> str:
    """Format the verification of a calibration by held-out views."""
    return "\n".join(
        [
            _line("Verified" if verification.passed else "Not verified", verification.message),
            *(
                f"  {view.name}: the board appears {_mm(view.deviation_m)} mm and {_degrees(view.deviation_rad)} "
                f"degrees off, {_mm(view.expected_m)} mm and {_degrees(view.expected_rad)} degrees are expected"
                for view in verification.views
            ),
        ]
    )


def _table(views: Sequence[ViewReport]) -> list[str]:
    width = max([len("view"), *(len(view.name) for view in views)])
    lines = [f"  {'view':{width}}  " + "  ".join(HEADS)]
    for view in views:
        cells = (
            str(view.corners),
            _number(view.rms_px, 2),
            _mm(view.robot_error_m, 2),
            _degrees(view.robot_error_rad),
            _mm(view.loo_error_m, 2),
            _number(view.distance_m, 3),
        )
        row = "  ".join(f"{cell:>{len(head)}}" for cell, head in zip(cells, HEADS, strict=True))
        lines.append(f"  {view.name:{width}}  {row}" + ("" if view.used else "  excluded"))
    return lines


def _line(name: str, text: str) -> str:
    """Return one wrapped entry, with its name in the first column."""
    margin = " " * NAME_WIDTH
    return textwrap.fill(text, LINE_WIDTH, initial_indent=f"{name:{NAME_WIDTH}}", subsequent_indent=margin)


def _rotation_vector_degrees(result: HandEyeResult) -> list[float]:
    from scipy.spatial.transform import Rotation

    if not np.isfinite(result.X).all():
        return [math.nan] * 3
    return np.degrees(Rotation.from_matrix(result.X[:3, :3]).as_rotvec()).tolist()


def _mm(metres: float | None, digits: int = 2) -> str:
    return _number(None if metres is None else metres * 1000, digits)


def _degrees(radians: float | None) -> str:
    return _number(None if radians is None else math.degrees(radians), 3)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.{digits}f}"
