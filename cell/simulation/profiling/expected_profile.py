"""Profiles of simulated cameras on tables for which the accuracy of recognition is stated."""

from dataclasses import replace

from cell.camera_profile.depth_profile import DepthProfile, ProfileError
from cell.camera_profile.measure import SeenTable, measure_profile
from cell.config.camera_config import OakCamera
from cell.config.camera_optics import CameraName, OakProduct, baseline_m
from cell.config.rendering_options import RenderingOptions
from cell.simulation.profiling.table_view import TableViewing, view_table
from cell.simulation.rendering.appearance import TEXTURED_TABLE_TOPS
from cell.simulation.rendering.depth_camera import CAMERAS, CameraModel

SIMULATED: dict[OakProduct, CameraName] = {
    "oak-d": "oak-d-pro",
    "oak-d-pro": "oak-d-pro",
    "oak-d-sr": "oak-d-sr",
    "oak4-d": "oak-d-pro",
}
"""Simulated camera of the kind of each product."""


def expected_profiles(model: CameraModel, seen: SeenTable) -> list[DepthProfile]:
    """Return the profiles of a camera on each textured table top, seen from the same pose.

    A camera without rendered images has one profile. A table top on which the camera sees no table has none.

    Args:
        model: Simulated camera.
        seen: Table, and the images of it.
    """
    tops = (None,) if model.stereo is None else TEXTURED_TABLE_TOPS
    profiles = []
    for table_top in tops:
        viewing = TableViewing(RenderingOptions(table_top=table_top), images=seen.images)
        try:
            images = view_table(replace(model, table_top=None), [seen.pose], viewing)
            profiles.append(measure_profile(images, focal_baseline_px_m(model)).profile)
        except ProfileError:
            continue
    return profiles


def model_of_oak(camera: OakCamera, seen: SeenTable) -> CameraModel:
    """Return the simulated camera of the kind of a real one, with the optics of its images.

    Args:
        camera: Settings of the real camera.
        seen: Images of the real camera.
    """
    model = CAMERAS[SIMULATED[camera.product]]
    assert model.stereo is not None
    width, height = seen.size
    disparities = model.stereo.disparities * (2 if camera.extended_disparity else 1)
    pair = replace(model.stereo, baseline_m=baseline_m(camera.product), disparities=disparities)
    return replace(
        model,
        focal_px=float(seen.K[0, 0]),
        width=width,
        height=height,
        near_m=min(model.near_m, camera.optics.near_m),
        depth_unit_m=seen.depth_unit_m,
        stereo=pair,
    )


def focal_baseline_px_m(model: CameraModel) -> float | None:
    """Return the product of focal length and baseline of the matched images, or None for an exact camera."""
    if model.stereo is not None:
        return model.focal_px * model.stereo.baseline_m
    return None if model.noise is None else model.noise.focal_baseline_px_m
