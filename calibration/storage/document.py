"""A solved calibration as JSON: for its file, for the command line and over HTTP.

`mounting`; `frames`, the transforms in words; `T_flange_camera` and `T_base_board` (of a camera that stands in the
cell: `T_base_camera` and `T_flange_board`); `covariance` of the camera's pose; `intrinsics`, as fitted and as told;
`board` as told, with its `scale` by the views; `metrics`; `verdict`, `findings`, `views`, and `verification` on views
that were held out; `joint_covariance` as in `calibration.result`, for verifications. Metres, radians, pixels.
A number that a refused solution does not have is null.
"""

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.forms import transform_document
from calibration.geometry.transforms import NotRigidError, rigid
from calibration.observations import Mounting, Observations
from calibration.result import HandEyeResult

FRAMES: dict[Mounting, tuple[tuple[str, str], tuple[str, str]]] = {
    "eye-in-hand": (
        ("T_flange_camera", "maps camera points to the flange; camera frame: x right, y down, z forward"),
        ("T_base_board", "maps board points to the robot's base; the board's z points into the print"),
    ),
    "eye-to-hand": (
        ("T_base_camera", "maps camera points to the robot's base; camera frame: x right, y down, z forward"),
        ("T_flange_board", "maps board points to the flange; the board's z points into the print"),
    ),
}
COVARIANCE = {
    "order": ["rx", "ry", "rz", "tx", "ty", "tz"],
    "side": "right, in the camera's frame: X_true = X @ error, where X is the camera's transform and error has the "
    "rotation vector r and the translation t",
    "units": ["rad", "rad", "rad", "m", "m", "m"],
}


def result_document(
    result: HandEyeResult, observations: Observations, verification: dict[str, Any] | None = None
) -> dict[str, Any]:
    """The result with what it was solved from, but for the corners themselves, as JSON's values.

    `verification`: how it did on views that were held out, as JSON's values.
    """
    (camera, camera_words), (board, board_words) = FRAMES[result.mounting]
    width, height = observations.image_size
    document: dict[str, Any] = {
        "mounting": result.mounting,
        "frames": {camera: camera_words, board: board_words},
        camera: _transform(result.X),
        board: _transform(result.Y),
        "covariance": {"matrix": result.covariance.tolist()} | COVARIANCE,
        "joint_covariance": None if result.joint_covariance is None else result.joint_covariance.tolist(),
        "intrinsics": {
            "K": result.K.tolist(),
            "K_told": observations.K.tolist(),
            "distortion": observations.distortion.tolist(),
            "width": width,
            "height": height,
        },
        "board": observations.board.to_json() | {"scale": result.board_scale, "scale_sigma": result.board_scale_sigma},
        "metrics": {
            "sigma_m": result.sigma_m,
            "sigma_rad": result.sigma_rad,
            "eight_views_m": result.eight_views_m,
            "left_out_m": result.left_out_m,
            "pixel_sigma_px": result.pixel_sigma_px,
            "robot_sigma_m": result.robot_sigma_m,
            "robot_sigma_rad": result.robot_sigma_rad,
            "views_given": len(result.views),
            "views_used": sum(view.used for view in result.views),
        },
        "verdict": result.verdict,
        "findings": [asdict(finding) for finding in result.findings],
        "views": [asdict(view) for view in result.views],
    }
    if verification is not None:
        document["verification"] = verification
    return _finite(document)


def _transform(T: NDArray[np.float64]) -> dict[str, list[float]] | None:
    try:
        return transform_document(rigid(T, "the solution"))
    except NotRigidError:
        return None  # no solution


def _finite(value: Any) -> Any:
    """JSON knows no NaN."""
    match value:
        case dict():
            return {key: _finite(item) for key, item in value.items()}
        case list() | tuple():
            return [_finite(item) for item in value]
        case np.generic() | np.ndarray():
            return _finite(value.tolist())
        case float() if not np.isfinite(value):
            return None
    return value
