"""Scenes with contacts other than plain crossings, and the scene without a string."""

import numpy as np
import pytest

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.rendering.meshes import clump_mesh, scene_meshes, tube
from cell.simulation.scenes.clutter import distance_to_box
from cell.simulation.scenes.ground_truth import scene_truth, true_crossings
from cell.simulation.scenes.planar_crossings import plan_crossings
from cell.simulation.scenes.scenes import StringScene, make_scene
from cell.simulation.scenes.shapes import polyline_length, tightest_bend
from cell.simulation.scenes.strand_clearance import deepest_overlap
from recognition.geometry.polyline import arc_length

pytestmark = pytest.mark.slow

R = 0.0042


def distances(points: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """Return the distances (N,) of points (N, 3) from the polyline `curve`."""
    start, along = curve[:-1], np.diff(curve, axis=0)
    share = np.einsum("nmk,mk->nm", points[:, None] - start, along) / (along**2).sum(axis=1)
    foot = start + np.clip(share, 0, 1)[..., None] * along
    return np.linalg.norm(points[:, None] - foot, axis=2).min(axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_two_strands_lie_in_contact_and_do_not_cross(seed: int) -> None:
    scene = make_scene("side-by-side", seed, strings=2)
    a, b = scene.curves
    assert plan_crossings(scene.curves) == ()
    apart = distances(a, b)
    # The gap is 0.2 %. Chords of 1 mm in a bend of at least 15 cm are off by less than 1 um.
    assert apart.min() == pytest.approx(2 * R, rel=0.003)
    contact_m = 0.001 * (apart < 2.02 * R).sum()
    # The strands separate with a bend of 8 to 14 radii, so both ends stay within 2 % of a radius for about 5 mm more.
    assert 0.029 < contact_m < 0.095
    assert np.concatenate([a[:, 2], b[:, 2]]) == pytest.approx(R, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_a_hairpin_lies_beside_itself(seed: int) -> None:
    scene = make_scene("side-by-side", seed, strings=1)
    (curve,) = scene.curves
    assert plan_crossings(scene.curves) == ()
    middle = len(curve) // 2
    apart = distances(curve[: middle - 25], curve[middle + 25 :])
    assert apart.min() == pytest.approx(2 * R, rel=0.003)
    assert 0.029 < 0.001 * (apart < 2.02 * R).sum() < 0.095
    # The loop has at least 3.5 radii before the whole string is bent slightly.
    assert tightest_bend(curve[:, :2]) > 3.2 * R


@pytest.mark.parametrize("seed", range(4))
def test_an_end_lies_on_a_strand(seed: int) -> None:
    scene = make_scene("end-on-strand", seed, crossings=1)
    (crossing,) = true_crossings(scene)
    assert (crossing["over"][0], crossing["under"][0]) == (1, 0)
    assert crossing["over"][1] < 2.5 * R
    # The strand rises to its end, so the contact is along the normal of the slope. Contacts are enforced at
    # points 1 mm apart.
    assert distances(scene.curves[1][:60], scene.curves[0]).min() == pytest.approx(2 * R, rel=0.02)
    assert scene.curves[1][-1, 2] == pytest.approx(R, abs=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_an_end_touches_the_side_of_a_strand(seed: int) -> None:
    scene = make_scene("end-on-strand", seed, crossings=0)
    assert true_crossings(scene) == []
    vertices, _ = tube(scene.curves[1], R)
    end = np.vstack([vertices[:40], vertices[-2:-1]]).astype(np.float64)
    # The corners of the mesh are 0.15 % of the radius outside.
    gap_m = distances(end, scene.curves[0]).min() - R
    assert -1e-5 < gap_m < 0.05 * R


@pytest.mark.parametrize("seed", range(4))
def test_three_strands_cross_at_one_position(seed: int) -> None:
    scene = make_scene("stacked", seed)
    crossings = true_crossings(scene)
    assert sorted(tuple(sorted((x["over"][0], x["under"][0]))) for x in crossings) == [(0, 1), (0, 2), (1, 2)]
    places = np.array([x["point"][:2] for x in crossings])
    assert np.linalg.norm(places - places.mean(axis=0), axis=1).max() < 3 * R
    # The crossings are about a radius apart, so the first strand is not exactly below the crossing of the others.
    assert sorted(curve[:, 2].max() / R for curve in scene.curves) == pytest.approx([1, 3, 5], abs=0.3)
    assert deepest_overlap(scene.curves, scene.radii_m) < 0.02


@pytest.mark.parametrize("crossings", [0, 1])
@pytest.mark.parametrize("seed", range(3))
def test_rings_are_closed(seed: int, crossings: int) -> None:
    scene = make_scene("ring", seed, crossings=crossings)
    (curve,) = scene.curves
    assert scene.closed == (True,)
    assert np.array_equal(curve[0], curve[-1])
    assert len(true_crossings(scene)) == crossings
    # The ring closes without a kink, so the steps before and after have nearly the same direction.
    before, after = curve[-1] - curve[-2], curve[1] - curve[0]
    assert before @ after / (np.linalg.norm(before) * np.linalg.norm(after)) > np.cos(0.12)
    assert polyline_length(curve) == pytest.approx(0.4, abs=2e-4)
    truth = scene_truth(scene, [], np.eye(4))
    assert truth["closed"] == [True]
    assert truth["curves"][0][0] == truth["curves"][0][-1]


def test_the_mesh_of_a_ring_has_no_opening() -> None:
    scene = make_scene("ring", 0, crossings=0)
    vertices, triangles = tube(scene.curves[0], R)
    # The first and the last ring of corners are the same, so every edge belongs to two triangles.
    count = len(vertices) - 40
    assert vertices[count:] == pytest.approx(vertices[:40], abs=1e-9)
    joined = np.where(triangles >= count, triangles - count, triangles)
    edges = np.sort(np.concatenate([joined[:, [0, 1]], joined[:, [1, 2]], joined[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


@pytest.mark.parametrize("seed", range(4))
def test_thick_and_thin_strings_cross_and_touch(seed: int) -> None:
    scene = make_scene("mixed-radii", seed)
    assert max(scene.radii_m) == R
    assert 0.55 * R <= min(scene.radii_m) <= 0.75 * R
    assert scene.radius_m == scene.radii_m[0]
    crossings = true_crossings(scene)
    assert any(x["over"][0] != x["under"][0] for x in crossings)
    for x in crossings:
        z = [
            np.interp(x[o][1], arc_length(scene.curves[x[o][0]]), scene.curves[x[o][0]][:, 2])
            for o in ("over", "under")
        ]
        assert z[0] - z[1] == pytest.approx(sum(scene.radii_m[x[o][0]] for o in ("over", "under")), rel=0.02)
    for curve, radius_m in zip(scene.curves, scene.radii_m, strict=True):
        assert curve[:, 2].min() == pytest.approx(radius_m, rel=1e-6)
    assert scene_truth(scene, [], np.eye(4))["radii"] == list(scene.radii_m)


def test_each_string_is_rendered_with_its_radius() -> None:
    thick, thin = 0.004, 0.0025
    x = np.arange(-0.1, 0.1, 0.001)
    curves = tuple(
        np.column_stack([x, np.full_like(x, y), np.full_like(x, r)]) for y, r in ((0.02, thick), (-0.02, thin))
    )
    scene = StringScene("two", thick, curves, radii_m=(thick, thin))
    # With views from all sides, the highest measured point of a string is its top. Depths have a unit of 0.1 mm.
    points = []
    for view in simulate(scene, camera_model("exact", (320, 200)), 0, views=4).views:
        v, u = np.nonzero(view.depth)
        rays = np.column_stack([u, v, np.ones(len(u))]) @ np.linalg.inv(view.K).T
        camera = rays * view.depth[v, u, None] * view.depth_unit_m
        points.append(camera @ view.T_base_camera[:3, :3].T + view.T_base_camera[:3, 3])
    cloud = np.vstack(points)
    tops = [np.quantile(cloud[np.abs(cloud[:, 1] - y) < 0.002, 2], 0.9) for y in (0.02, -0.02)]
    # The reported poses have errors of about a millimetre, equal for both strings.
    assert tops[0] - tops[1] == pytest.approx(2 * (thick - thin), abs=0.0005)


def test_a_long_string_is_a_flat_coil_of_few_bends() -> None:
    scene = make_scene("long", 0, length_m=10.0)
    (curve,) = scene.curves
    assert polyline_length(curve) == pytest.approx(10.0, abs=5e-3)
    assert plan_crossings(scene.curves) == ()
    assert np.linalg.norm(curve[:, :2], axis=1).max() < 0.32
    assert tightest_bend(curve[:, :2]) > 6 * R


def test_the_empty_scene_has_clutter_only() -> None:
    scene = make_scene("empty", 0, clutter=2)
    assert scene.curves == ()
    assert (len(scene.boxes), len(scene.clumps)) == (3, 1)
    edge = scene.boxes[0]
    assert edge.size_m[0] >= 0.2
    assert 0.003 <= edge.size_m[2] <= 0.015
    (clump,) = scene.clumps
    vertices, _ = clump_mesh(clump)
    assert 0.3 * clump.height_m < vertices[:, 2].max() <= clump.height_m
    for box in scene.boxes[:1]:
        assert distance_to_box(np.array([clump.centre_m]), box)[0] > clump.radius_m
    scan = simulate(scene, camera_model("ideal", (64, 40)), 0, views=2)
    assert scan.truth["curves"] == scan.truth["crossings"] == []
    assert len(scene_meshes(scene)) == 1 + 3 + 1
