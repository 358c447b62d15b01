"""Camera of a case: a tier draws its cases with the cameras of the noise model, and the benchmark replaces them."""

from dataclasses import replace

from cell.config.camera_names import CameraName
from cell.simulation.cases.case import Case
from cell.simulation.rendering.depth_camera import CAMERAS, CameraModel, camera_model

NOISE_MODEL_TIERS = ("measured", "speckle", "noise")
"""Tiers whose cases have particular errors of the noise model. They keep their cameras."""
_SHORT_BASELINES: dict[str, CameraName] = {"ideal": "ideal-sr"}
"""Camera with a short baseline beside a chosen camera. The default is `oak-d-sr`."""


def with_camera(case: Case, name: CameraName) -> Case:
    """Return the case with a chosen camera, which resolves as finely as the drawn one.

    Args:
        case: Case as its tier draws it, with the camera `ideal` or `ideal-sr`.
        name: Chosen camera. A case with `ideal-sr` gets the camera with a short baseline beside it.
    """
    if case.tier in NOISE_MODEL_TIERS:
        return case
    drawn = case.camera
    chosen = _SHORT_BASELINES.get(name, "oak-d-sr") if drawn.name == "ideal-sr" else name
    camera = camera_model(chosen, _resolution(drawn, CAMERAS[chosen]))
    preset = CAMERAS[drawn.name]
    if drawn.working_m != preset.working_m:
        camera = replace(camera, working_m=drawn.working_m)
    return replace(case, camera=camera)


def _resolution(drawn: CameraModel, chosen: CameraModel) -> tuple[int, int]:
    """Return the size of the chosen camera's image, enlarged like the drawn one, but not beyond its sensor."""
    scale = drawn.width / CAMERAS[drawn.name].width
    width = min(round(scale * chosen.width), chosen.sensor[0])
    return width, min(width * chosen.height // chosen.width, chosen.sensor[1])
