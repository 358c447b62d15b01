"""The table in one view: planes of known height and tilt, and clutter."""

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.config.cell_config import CellSettings, MountingSettings, WorkspaceSettings
from cell.devices import View
from cell.planning.look_at import look_at
from cell.self_test.table_check import fit_table, share_in_view

SETTINGS = CellSettings(
    workspace=WorkspaceSettings(x_m=(0.3, 0.6), y_m=(-0.1, 0.1)), mounting=MountingSettings(table_z_m=-0.2)
)
MIDDLE = np.array([0.45, 0.0, -0.2])
K = np.array([[400.0, 0.0, 160.0], [0.0, 400.0, 100.0], [0.0, 0.0, 1.0]])
UNIT_M = 1e-4
MOUNTING = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))


def looking_at(target: NDArray[np.float64]) -> NDArray[np.float64]:
    return look_at(target, 2.0, 1.1, 0.6, 0.2)


def view(depth: NDArray[np.uint16], T_base_camera: NDArray[np.float64]) -> View:
    return View(0, depth, UNIT_M, K, T_base_camera @ np.linalg.inv(MOUNTING), MOUNTING)


def plane_view(
    height_m: float, tilt_rad: float = 0.0, noise_m: float = 0.0, T: NDArray[np.float64] | None = None
) -> View:
    """Return a view of a plane through (0.45, 0, `height_m`) that slopes down towards +x."""
    T = looking_at(MIDDLE) if T is None else T
    u, v = np.meshgrid(np.arange(320), np.arange(200))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T @ T[:3, :3].T
    normal = np.array([np.sin(tilt_rad), 0.0, np.cos(tilt_rad)])
    depth = (np.array([0.45, 0.0, height_m]) - T[:3, 3]) @ normal / (rays @ normal)
    depth += noise_m * np.random.default_rng(0).standard_normal(depth.shape)
    return view(np.where((depth > 0) & (depth < 6), depth / UNIT_M, 0).round().astype(np.uint16), T)


@pytest.mark.parametrize("offset_m", [0.0, 0.003, -0.03, 0.06])
@pytest.mark.parametrize("tilt_rad", [0.0, 0.02, 0.1])
def test_height_and_tilt_are_measured(offset_m: float, tilt_rad: float) -> None:
    seen = fit_table(plane_view(-0.2 + offset_m, tilt_rad, noise_m=0.001), SETTINGS)
    assert seen is not None
    # The height is measured among the points, up to 5 cm from the pivot of the plane. The noise adds 0.5 mm.
    assert seen.height_m == pytest.approx(offset_m, abs=0.0005 + 0.05 * np.tan(tilt_rad))
    # 1 mm of noise in a thousand points over 0.2 m leaves far less than 2 mrad.
    assert seen.tilt_rad == pytest.approx(tilt_rad, abs=0.002)
    assert seen.share > 0.9


def test_objects_on_the_table_do_not_change_its_height() -> None:
    flat = plane_view(-0.2, noise_m=0.001)
    depth = flat.depth.copy()
    depth[60:130, 120:200] = (depth[60:130, 120:200] * 0.93).astype(np.uint16)  # a box of about 4 cm
    depth[:, :40] = 0
    seen = fit_table(view(depth, flat.T_base_camera), SETTINGS)
    assert seen is not None
    assert seen.height_m == pytest.approx(0.0, abs=0.001)
    assert seen.share < 0.95


def test_without_points_near_the_table_there_is_no_height() -> None:
    assert fit_table(plane_view(-0.2 + 0.15), SETTINGS) is None
    flat = plane_view(-0.2)
    assert fit_table(view(np.zeros_like(flat.depth), flat.T_base_camera), SETTINGS) is None


def test_clutter_is_not_a_plane() -> None:
    flat = plane_view(-0.2)
    depth = np.random.default_rng(1).integers(1, 65535, flat.depth.shape, dtype=np.uint16)
    seen = fit_table(view(depth, flat.T_base_camera), SETTINGS)
    assert seen is None or seen.share < 0.3


@pytest.mark.parametrize(
    ("T_base_camera", "least", "most"),
    [
        # From 0.6 m, the image of 0.48 x 0.3 m shows the whole workspace of 0.3 x 0.2 m.
        (looking_at(MIDDLE), 1.0, 1.0),
        (looking_at(MIDDLE + [0.3, 0.0, 0.0]), 0.1, 0.9),
        (looking_at(MIDDLE + [1.0, 0.0, 0.0]), 0.0, 0.0),
        (looking_at(MIDDLE) @ from_rotation_vector((0, 0, 0), (np.pi, 0, 0)), 0.0, 0.0),
    ],
    ids=["middle", "aside", "elsewhere", "upwards"],
)
def test_the_visible_share_of_the_workspace(T_base_camera: NDArray[np.float64], least: float, most: float) -> None:
    assert least <= share_in_view(T_base_camera, K, (320, 200), SETTINGS) <= most
