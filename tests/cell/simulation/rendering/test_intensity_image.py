"""Intensity images of cameras whose depth is not matched in images."""

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion

from cell.planning.look_at import look_at
from cell.simulation.rendering.depth_camera import DepthCamera, camera_model
from cell.simulation.rendering.intensity_image import PictureCamera, lighting
from cell.simulation.scenes.scenes import make_scene


def test_the_intensity_image_shows_the_string_at_the_pixels_of_the_depth() -> None:
    camera = DepthCamera(camera_model("exact", (320, 200)), make_scene("overhand-knot", 1))
    T_base_camera = look_at(np.zeros(3), 0.4, 1.1, 0.4, 0.0)
    image = PictureCamera(camera, lighting(np.random.default_rng(1))).still(T_base_camera)
    _, string = camera.render(T_base_camera)
    # A lens blurs the borders, and strings reflect less than a third of the light that the table reflects.
    inside = np.asarray(binary_erosion(string >= 0), dtype=np.bool_)
    outside = np.logical_not(binary_dilation(string >= 0, iterations=3))
    assert inside.sum() > 100
    assert np.median(image[inside]) < 0.6 * np.median(image[outside])
    assert np.quantile(image[inside], 0.9) < np.quantile(image[outside], 0.1)
