"""Scenes with low objects beside or under a string."""

import numpy as np
import pytest

from cell.simulation.cases import make_case
from cell.simulation.rendering.depth_camera import DepthCamera, camera_model
from cell.simulation.scenes.clutter import Box, distance_to_box
from cell.simulation.scenes.ground_truth import true_crossings
from cell.simulation.scenes.low_obstacles import FREE_M, KINDS, LOW_M, POST_M, free_distance_m, support_heights
from cell.simulation.scenes.scenes import StringScene, make_scene
from cell.simulation.scenes.shapes import polyline_length
from cell.simulation.scenes.strand_clearance import deepest_overlap
from recognition.geometry.polyline import resample

SEEDS = range(6)
FREE_TOLERANCE_M = 1e-6
"""An object is moved until its free distance differs by less than this from the drawn one."""


def scenes(kind: str) -> list[StringScene]:
    return [make_scene(kind, seed, (0.003, 0.0042, 0.005)[seed % 3]) for seed in SEEDS]


def gap_m(scene: StringScene, box: Box) -> float:
    """Return the smallest distance in space of the string's surface from a box."""
    points = resample(scene.curves[0], 0.00025)
    above = np.maximum(points[:, 2] - box.size_m[2], 0.0)
    return float(np.hypot(distance_to_box(points[:, :2], box), above).min()) - scene.radius_m


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "plate"])
def test_objects_are_free_of_the_string(kind: str) -> None:
    free = [free_distance_m(scene.curves, scene.radius_m, box) for scene in scenes(kind) for box in scene.boxes]
    assert min(free) >= FREE_M[0] - FREE_TOLERANCE_M
    assert max(free) <= FREE_M[1] + FREE_TOLERANCE_M
    assert max(free) - min(free) > 0.003


@pytest.mark.parametrize(
    ("kind", "heights_m", "counts"),
    [
        ("bar", LOW_M, {1, 2, 3}),
        ("plate", LOW_M, {1}),
        ("post", POST_M, set(range(1, 9))),
        ("slot", LOW_M, {2, 4}),
        ("wall", (0.02, 0.06), {1, 2}),
    ],
)
def test_objects_have_the_sizes_of_their_kind(kind: str, heights_m: tuple[float, float], counts: set[int]) -> None:
    for scene in scenes(kind):
        assert len(scene.boxes) in counts
        assert all(heights_m[0] <= box.size_m[2] <= heights_m[1] for box in scene.boxes)
        if kind == "post":
            assert all(0.004 <= width <= 0.010 for box in scene.boxes for width in box.size_m[:2])
        if kind == "wall":
            assert all(box.size_m[1] <= 0.006 for box in scene.boxes)


@pytest.mark.parametrize("kind", KINDS)
def test_the_string_is_as_requested(kind: str) -> None:
    for scene in scenes(kind):
        (curve,) = scene.curves
        assert polyline_length(curve) == pytest.approx(0.4, abs=2e-4)
        assert len(true_crossings(scene)) <= 1
        assert deepest_overlap(scene.curves, scene.radii_m) < 0.02
        assert curve[:, 2].min() >= scene.radius_m * (1 - 1e-9)
    assert len(true_crossings(make_scene(kind, 1, crossings=1))) == 1


def test_a_slot_has_a_bar_on_each_side() -> None:
    for scene in scenes("slot"):
        points = resample(scene.curves[0][:, :2], 0.001)
        for first, second in zip(scene.boxes[::2], scene.boxes[1::2], strict=True):
            # The line between the middles of the bars crosses the string, and the bars are parallel.
            between = np.linspace(first.centre_m, second.centre_m, 200)
            assert np.linalg.norm(points[:, None] - between[None], axis=2).min() < 0.0008
            assert first.yaw_rad == second.yaw_rad


def test_the_string_lies_on_the_plate() -> None:
    partly = 0
    for scene in scenes("plate"):
        (plate,) = scene.boxes
        curve = scene.curves[0]
        over = distance_to_box(curve[:, :2], plate) == 0
        assert gap_m(scene, plate) == pytest.approx(0.0, abs=1e-5), "it touches the plate and does not cut it"
        assert over.mean() > 0.05
        assert curve[over, 2].min() >= scene.radius_m + plate.size_m[2] - 1e-9
        # Ramps are no steeper than 0.7, which is 35 degrees.
        slope = np.diff(curve[:, 2]) / np.linalg.norm(np.diff(curve[:, :2], axis=0), axis=1)
        assert np.abs(slope).max() < 0.75
        if not over.all():
            partly += 1
            assert curve[~over, 2].min() < scene.radius_m + plate.size_m[2] / 2
    assert 0 < partly < len(SEEDS)


def test_a_string_beside_a_plate_leans_on_its_edge() -> None:
    plate = Box((0.0, 0.0), (0.02, 0.02, 0.005), 0.0)
    x = np.array([0.0, 0.009, 0.0125, 0.0147, 0.02])
    heights = support_heights(np.column_stack([x, np.zeros(5)]), 0.004, [plate])
    # Half a millimetre nearer to the plate, because the points are 1 mm apart.
    assert heights == pytest.approx([0.009, 0.009, 0.005 + np.sqrt(0.004**2 - 0.002**2), 0.004, 0.004])


def test_plates_and_bars_are_seen_at_their_height() -> None:
    for kind in ("plate", "bar"):
        scene = make_scene(kind, 2)
        camera = camera_model("exact", (320, 200))
        T = np.diag([1.0, -1.0, -1.0, 1.0])
        T[2, 3] = 0.5
        surfaces = DepthCamera(camera, scene).surfaces(T)
        for k, box in enumerate(scene.boxes):
            top = surfaces.points[surfaces.part == len(scene.curves) + 1 + k]
            assert len(top) > 5
            assert top[:, 2].max() == pytest.approx(box.size_m[2], abs=1e-6)
            assert distance_to_box(top[:, :2].astype(np.float64), box).max() < 1e-6


def test_the_tier_has_the_kinds_in_turn() -> None:
    cases = [make_case("fixtures", seed, "ideal") for seed in range(6)]
    names = [case.scene.name.split("-")[0] for case in cases]
    assert names == ["bar", "plate", "post", "slot", "wall", "bar"]
    assert {case.scene.radius_m for case in cases} <= {0.003, 0.0042, 0.005}
    assert {case.camera.name for case in cases} == {"ideal"}
