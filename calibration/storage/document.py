"""The JSON document of a solved calibration, for its file, the command line and HTTP.

Its members are `mounting`; `frames`, which describes the transforms; `T_flange_camera` and `T_base_board` (for a
camera that stands in the cell `T_base_camera` and `T_flange_board`); `covariance`; `joint_covariance`; `intrinsics`,
fitted and given; `board` with its given size and estimated `scale`; `metrics`; `verdict`; `findings`; `views`; and
`verification` with views that were held out. Units are metres, radians and pixels. Numbers that a refused solution
lacks are null.
"""

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.dataset.forms import transform_to_json
from calibration.geometry.transforms import NotRigidError, rigid
from calibration.observations import Mounting, Observations
from calibration.result import Finding, HandEyeResult, ViewReport

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
"""Name and description of the two transforms X and Y, by mounting."""
JSON_KEYS = {
    "message": "words",
    "blocking": "refuses",
    "loo_error_m": "left_out_m",
    "repeatability_95_m": "eight_views_m",
}
"""Keys in JSON of the fields of `calibration.result` that have another name in Python."""
COVARIANCE = {
    "order": ["rx", "ry", "rz", "tx", "ty", "tz"],
    "side": "right, in the camera's frame: X_true = X @ error, where X is the camera's transform and error has the "
    "rotation vector r and the translation t",
    "units": ["rad", "rad", "rad", "m", "m", "m"],
}
"""Convention of the covariance of X."""


def result_document(
    result: HandEyeResult, observations: Observations, verification: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Return a solved calibration as JSON values, without the corners.

    Args:
        result: The calibration.
        observations: The views that it was solved from.
        verification: Result on views that were held out, as JSON values. None: not verified.
    """
    (camera, camera_description), (board, board_description) = FRAMES[result.mounting]
    width, height = observations.image_size
    document: dict[str, Any] = {
        "mounting": result.mounting,
        "frames": {camera: camera_description, board: board_description},
        camera: _transform(result.X),
        board: _transform(result.Y),
        "covariance": {"matrix": result.covariance.tolist()} | COVARIANCE,
        "joint_covariance": result.joint_covariance.tolist(),
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
            JSON_KEYS["repeatability_95_m"]: result.repeatability_95_m,
            JSON_KEYS["loo_error_m"]: result.loo_error_m,
            "pixel_sigma_px": result.pixel_sigma_px,
            "robot_sigma_m": result.robot_sigma_m,
            "robot_sigma_rad": result.robot_sigma_rad,
            "views_given": len(result.views),
            "views_used": sum(view.used for view in result.views),
        },
        "verdict": result.verdict,
        "findings": [record_document(finding) for finding in result.findings],
        "views": [record_document(view) for view in result.views],
    }
    if verification is not None:
        document["verification"] = verification
    return _finite(document)


def record_document(record: Finding | ViewReport) -> dict[str, Any]:
    """Return a finding or a view report as JSON values."""
    return {JSON_KEYS.get(name, name): value for name, value in asdict(record).items()}


def _transform(T: NDArray[np.float64]) -> dict[str, list[float]] | None:
    """Return a transform as JSON values, or None if it is not rigid, as for a refused solution."""
    try:
        return transform_to_json(rigid(T, "the solution"))
    except NotRigidError:
        return None


def _finite(value: Any) -> Any:
    """Replace numbers that are not finite by None, since JSON has no NaN."""
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
