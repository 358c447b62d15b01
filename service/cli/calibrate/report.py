"""A hand-eye calibration for people: in words, millimetres and degrees."""

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
    "warn": "warn: it may be used; read what was found",
    "refuse": "refuse: it must not be used",
}
HEADS = ("corners", "rms px", "robot mm", "robot deg", "left out mm", "distance m")


def result_words(result: HandEyeResult, unseen: Sequence[tuple[str, str]] = ()) -> str:
    """The result, line by line; `unseen` are views that did not come to be solved from, name and reason."""
    camera = "T_flange_camera" if result.mounting == "eye-in-hand" else "T_base_camera"
    x, y, z = (_mm(value, 2) for value in result.X[:3, 3])
    turn = ", ".join(_number(value, 2) for value in _turn_degrees(result))
    used = sum(view.used for view in result.views)
    lines = [
        _line("Verdict", VERDICTS[result.verdict]),
        *(_line("Refused" if f.blocking else "Warning", f"{f.message} ({f.code})") for f in result.findings),
        _line("Camera", f"{camera}: {x}, {y}, {z} mm, turned by the vector {turn} degrees"),
        _line("Sure to", f"{_mm(result.sigma_m)} mm and {_degrees(result.sigma_rad)} degrees (1 sigma, all axes)"),
        _line(
            "Eight views",
            f"of a scan will differ by up to {_mm(result.repeatability_95_m)} mm (95 %, the worst two)",
        ),
        _line("Leave one out", f"the board appears {_mm(result.loo_error_m)} mm off in views not solved from (rms)"),
        _line(
            "Noise",
            f"corners {_number(result.pixel_sigma_px, 3)} px, robot {_mm(result.robot_sigma_m, 2)} mm and "
            f"{_degrees(result.robot_sigma_rad)} degrees along each axis",
        ),
        _line("Board", f"{_number(result.board_scale, 4)} +- {_number(result.board_scale_sigma, 4)} of the told size"),
        _line("Views", f"{used} used of {len(result.views) + len(unseen)}"),
        *_table(result.views),
        *(_line("Left out", f"{view.name}: {view.reason}") for view in result.views if not view.used),
        *(_line("Not seen", f"{name}: {reason}") for name, reason in unseen),
    ]
    return "\n".join(lines)


def verification_words(verification: Verification) -> str:
    """How it did on views that it was not solved from."""
    return "\n".join(
        [
            _line("Verified" if verification.passed else "Not verified", verification.message),
            *(
                f"  {view.name}: the board appears {_mm(view.off_m)} mm and {_degrees(view.off_rad)} degrees off, "
                f"{_mm(view.expected_m)} mm and {_degrees(view.expected_rad)} degrees are expected"
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
        lines.append(f"  {view.name:{width}}  {row}" + ("" if view.used else "  left out"))
    return lines


def _line(name: str, words: str) -> str:
    """Wrapped, so that what belongs together stands together."""
    margin = " " * NAME_WIDTH
    return textwrap.fill(words, LINE_WIDTH, initial_indent=f"{name:{NAME_WIDTH}}", subsequent_indent=margin)


def _turn_degrees(result: HandEyeResult) -> list[float]:
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
