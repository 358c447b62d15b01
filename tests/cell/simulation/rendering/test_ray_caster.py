import numpy as np
import pytest

from cell.simulation.rendering.meshes import TABLE_HALF_M
from cell.simulation.rendering.ray_caster import RayCaster
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene

RADIUS_M = 0.004
CURVE = np.column_stack([np.linspace(-0.1, 0.1, 101), np.zeros(101), np.full(101, RADIUS_M)])
SCENE = StringScene("hand-made", RADIUS_M, (CURVE,), (Box((0.0, 0.05), (0.04, 0.04, 0.02), 0.0),))
EYE = np.array([0.0, 0.0, 0.4])


def test_the_first_surface_on_each_ray_is_found() -> None:
    targets = np.array([[0.03, 0.0, 2 * RADIUS_M], [0.1, -0.1, 0.0], [0.0, 0.05, 0.02], [2 * TABLE_HALF_M, 0.0, 0.0]])
    hits = RayCaster(SCENE).cast(EYE, (targets - EYE).astype(np.float32))
    # The string is mesh 0, the table mesh 1, the box mesh 2.
    assert hits.part.tolist() == [0, 1, 2, -1]
    assert hits.is_hit.tolist() == [True, True, True, False]
    # The facets of the string are 0.15 % of the radius off.
    assert hits.points[:3] == pytest.approx(targets[:3], abs=2e-5)


def test_normals_point_to_the_origin_of_the_ray() -> None:
    targets = np.array([[0.1, -0.1, 0.0], [0.03, 0.0, 2 * RADIUS_M]])
    above = RayCaster(SCENE).cast(EYE, (targets - EYE).astype(np.float32))
    below = RayCaster(SCENE).cast(-EYE, (targets[:1] + EYE).astype(np.float32))
    # A facet is half of 360 / 40 degrees wide, so its normal is off by at most 0.08.
    assert above.normals == pytest.approx(np.tile([0, 0, 1], (2, 1)), abs=0.08)
    assert below.normals == pytest.approx(np.array([[0, 0, -1]]), abs=1e-6)


def test_a_string_and_a_box_throw_shadows() -> None:
    # The lamp is on the side of negative y, so the string shades the table on the side of positive y.
    lamp = np.array([0.0, -0.5, 0.5])
    targets = np.array([[-0.06, RADIUS_M + 0.003, 0], [-0.06, -0.02, 0], [0.0, 0.08, 0], [-0.06, 0.0, 2 * RADIUS_M]])
    caster = RayCaster(SCENE)
    hits = caster.cast(EYE, (targets - EYE).astype(np.float32))
    assert caster.is_shaded(hits, lamp).tolist() == [True, False, True, False]
