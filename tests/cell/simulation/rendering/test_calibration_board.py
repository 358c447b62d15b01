"""The board on the simulated table in depth and intensity images."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, transform_points
from calibration.target.board import Board
from calibration.target.detection import detect_board
from cell.config.camera_config import CameraName, SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.planning.look_at import look_at
from cell.simulation.devices.frame_source import FrameSource
from cell.simulation.devices.world import SimulatedWorld, simulated_world
from cell.simulation.rendering.calibration_board import Print
from cell.simulation.rendering.depth_camera import camera_model

pytestmark = pytest.mark.slow


def world_with(board: Board, model: CameraName = "exact", size: tuple[int, int] = (640, 400)) -> SimulatedWorld:
    """Return a world with a board and without errors of arm and calibration."""
    world = simulated_world(CellSettings(camera=SimulatedCamera(model=model, errors=0.0)))
    return replace(world, camera=camera_model(model, size)).with_board(board)


def looking(
    world: SimulatedWorld, azimuth_rad: float, tilt_deg: float, distance_m: float, roll_rad: float
) -> NDArray[np.float64]:
    """Return a flange pose from which the camera looks at the middle of the workspace."""
    T_base_camera = look_at(
        world.T_base_scene[:3, 3], azimuth_rad, np.pi / 2 - np.deg2rad(tilt_deg), distance_m, roll_rad
    )
    return T_base_camera @ inverse(world.T_flange_camera)


def projected(world: SimulatedWorld, T_base_flange: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the true pixels (N, 2) of the points of the board."""
    assert world.board is not None
    assert world.T_base_board is not None
    T_camera_board = inverse(world.T_base_camera(T_base_flange)) @ world.T_base_board
    points = transform_points(T_camera_board, world.board.points) @ world.camera.K.T
    return points[:, :2] / points[:, 2:]


def exact_ink(
    board: Board, H_image_board: NDArray[np.float64], rows: slice, columns: slice, samples: int = 16
) -> NDArray[np.float64]:
    """Return the printed share of each pixel of a checkerboard, from 16 x 16 samples per pixel."""
    u = (np.arange(columns.start * samples, columns.stop * samples) + 0.5) / samples - 0.5
    v = (np.arange(rows.start * samples, rows.stop * samples) + 0.5) / samples - 0.5
    u, v = np.meshgrid(u, v)
    x, y, w = np.tensordot(np.linalg.inv(H_image_board), np.stack([u, v, np.ones_like(u)]), axes=1)
    # The origin is the first inner corner. The square before it is the first one and is black.
    column, row = (np.floor(axis / w / board.pitch_m).astype(int) + 1 for axis in (x, y))
    printed = (column >= 0) & (column < board.columns) & (row >= 0) & (row < board.rows)
    ink = printed & ((column + row) % 2 == 0)
    return ink.reshape(len(ink) // samples, samples, -1, samples).mean(axis=(1, 3))


@pytest.mark.parametrize(("tilt_deg", "distance_m", "roll_rad"), [(20, 0.36, 0.0), (30, 0.6, -1.3), (0.01, 0.45, 0.0)])
def test_every_pixel_is_the_mean_of_the_print_over_its_area(
    tilt_deg: float, distance_m: float, roll_rad: float
) -> None:
    board = Board("checkerboard")
    world = world_with(board, size=(320, 200))
    assert world.T_base_board is not None
    T_scene_camera = world.T_scene_camera(looking(world, 0.7, tilt_deg, distance_m, roll_rad))
    T_scene_board = inverse(world.T_base_scene) @ world.T_base_board
    on_plate = np.zeros((200, 320), dtype=bool)
    on_plate[60:160, 100:240] = True
    seen = Print(board, T_scene_board).seen(T_scene_camera, world.camera.K, on_plate)
    assert (seen.rows, seen.columns) == (slice(59, 161), slice(99, 241))
    H_image_board = world.camera.K @ (inverse(T_scene_camera) @ T_scene_board)[:3, [0, 1, 3]]
    off = seen.black - exact_ink(board, H_image_board, seen.rows, seen.columns)
    # At an edge, 0.01 is a hundredth of a pixel. Both are means over a grid of samples.
    assert np.sqrt(np.mean(off**2)) < 0.008
    assert abs(off.mean()) < 1e-3
    assert np.abs(off).max() < 0.13


@pytest.mark.parametrize("model", ["ideal", "oak-d-pro"])
def test_corners_are_detected_at_their_true_pixels(model: CameraName) -> None:
    """Five exposures are rendered and averaged, and the corners are detected as in a calibration."""
    world = world_with(Board(), model)
    source = FrameSource(world)
    found, errors = 0, []
    for k in range(6):
        T_base_flange = looking(world, 1.1 * k, 20 + 2 * k, (0.36, 0.46)[k % 2], (-1.3, -0.4, 0.4)[k % 3])
        mean = np.mean([source.render_intensity(T_base_flange) for _ in range(5)], axis=0)
        sighting = detect_board(np.rint(mean).astype(np.uint8), Board())
        found += len(sighting.ids)
        errors.append(sighting.pixels - projected(world, T_base_flange)[sighting.ids])
    off = np.vstack(errors)
    assert found >= 0.97 * 6 * 48
    # The error of the detector. The error of the rendering is much smaller (see above).
    assert np.sqrt(np.mean(off**2)) < 0.08
    assert np.abs(off.mean(axis=0)).max() < 0.02


def test_depth_and_intensity_show_the_board_at_the_same_position() -> None:
    world = world_with(Board("checkerboard"))
    assert world.T_base_board is not None
    T_base_flange = looking(world, 0.4, 25, 0.45, 0.3)
    source = FrameSource(world)
    z = source.render_depth(T_base_flange) * world.camera.depth_unit_m
    pixels = projected(world, T_base_flange)
    u, v = np.rint(pixels).astype(int).T
    rays = np.column_stack([u, v, np.ones(len(u))]) @ np.linalg.inv(world.camera.K).T
    points = transform_points(T_base_flange @ world.T_flange_camera, rays * z[v, u, None])
    # The top of the plate, to half a depth count along the ray.
    assert points[:, 2] == pytest.approx(np.full(len(points), world.T_base_board[2, 3]), abs=1e-4)
    truth = transform_points(world.T_base_board, Board("checkerboard").points)
    # Half a pixel at 0.5 m is 0.6 mm on each axis.
    assert np.linalg.norm(points - truth, axis=1).max() < 1e-3


def test_a_board_out_of_view_is_not_in_the_image() -> None:
    world = world_with(Board())
    source = FrameSource(world)
    aside = look_at(world.T_base_scene[:3, 3] + (0.5, 0.4, 0), 0.0, 1.2, 0.3, 0.0) @ inverse(world.T_flange_camera)
    up = look_at(world.T_base_scene[:3, 3] + (0, 0, 1.0), 0.0, -1.2, 0.6, 0.0) @ inverse(world.T_flange_camera)
    assert source.render_intensity(aside).max() < 180
    # The image shows only the dark room with noise.
    assert source.render_intensity(up).max() < 40
    assert source.render_intensity(looking(world, 0.0, 20, 0.4, 0.0)).max() > 180
