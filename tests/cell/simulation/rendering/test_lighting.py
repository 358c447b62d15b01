import numpy as np
import pytest

from cell.planning.look_at import look_at
from cell.simulation.rendering.lighting import AMBIENT, DOT_LIGHT, DOT_RANGE_M, SHADE, DotProjector, Lamp, draw_lamp
from cell.simulation.rendering.ray_caster import Hits, RayCaster
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene

SCENE = StringScene("box", 0.004, (), (Box((0.1, 0.0), (0.04, 0.04, 0.03), 0.0),))


@pytest.fixture(scope="module")
def caster() -> RayCaster:
    return RayCaster(SCENE)


def table_hits(caster: RayCaster, xy: list[tuple[float, float]]) -> Hits:
    eye = np.array([0.0, 0.0, 0.5])
    targets = np.column_stack([np.array(xy), np.zeros(len(xy))])
    return caster.cast(eye, (targets - eye).astype(np.float32))


def test_the_lamp_lights_the_middle_and_falls_off(caster: RayCaster) -> None:
    lamp = Lamp(np.array([0.0, 0.4, 1.2]))
    middle, near, far = lamp.light(table_hits(caster, [(0, 0), (0, 0.3), (0, -0.3)]), caster)
    assert middle == pytest.approx(1.0, abs=1e-5)
    assert near > middle > far > AMBIENT


def test_a_shadow_keeps_the_ambient_light_and_some_reflected_light(caster: RayCaster) -> None:
    lamp = Lamp(np.array([-1.0, 0.0, 0.4]))
    behind, before = lamp.light(table_hits(caster, [(0.15, 0.0), (0.15, 0.1)]), caster)
    # Both points have about the same distance from the lamp; the light differs by 1 %.
    assert behind - AMBIENT == pytest.approx(SHADE * (before - AMBIENT), rel=0.03)


def test_lamps_are_above_the_table_and_aside() -> None:
    for seed in range(20):
        x, y, z = draw_lamp(np.random.default_rng(seed)).position
        assert 0.3 <= np.hypot(x, y) <= 0.6
        assert 1.0 <= z <= 1.4


def test_dots_are_bright_on_dark_ground_and_fall_with_the_squared_distance(caster: RayCaster) -> None:
    dots = DotProjector(1.0, np.random.default_rng(0))
    eye = np.array([0.0, 0.0, DOT_RANGE_M])
    T = look_at(np.zeros(3), 0.0, np.pi / 2, DOT_RANGE_M, 0.0)
    rays = np.stack(np.meshgrid(np.linspace(-0.15, 0.0, 400), np.linspace(-0.1, 0.1, 400)), axis=-1).reshape(-1, 2)
    directions = np.column_stack([rays, np.full(len(rays), -DOT_RANGE_M)]).astype(np.float32)
    light = dots.light(caster.cast(eye, directions), caster, T)
    # The brightest dots overlap with a neighbour. Off the axis the light falls with the cosine and the distance.
    assert 0.8 * DOT_LIGHT < light.max() < 1.6 * DOT_LIGHT
    assert np.median(light) < 0.1 * light.max()
    # From twice the distance, the same directions meet the same dots.
    T[2, 3] = 2 * DOT_RANGE_M
    eye = np.array([0.0, 0.0, 2 * DOT_RANGE_M])
    far = dots.light(caster.cast(eye, directions), caster, T)
    assert far.max() == pytest.approx(light.max() / 4, rel=0.01)


def test_the_projector_does_not_reach_behind_a_box(caster: RayCaster) -> None:
    dots = DotProjector(1.0, np.random.default_rng(0))
    T = look_at(np.zeros(3), np.pi, 0.5, 0.6, 0.0)
    xy = [(x, y) for x in (0.13,) for y in np.linspace(-0.01, 0.01, 50)]
    assert not dots.light(table_hits(caster, xy), caster, T).any()
