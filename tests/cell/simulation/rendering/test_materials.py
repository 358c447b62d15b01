import numpy as np
import pytest
from numpy.typing import NDArray

from cell.simulation.rendering.appearance import Appearance
from cell.simulation.rendering.materials import Materials
from cell.simulation.rendering.ray_caster import Hits, RayCaster
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene

RADIUS_M = 0.004
CURVE = np.column_stack([np.linspace(-0.1, 0.1, 41), np.zeros(41), np.full(41, RADIUS_M)])
SCENE = StringScene("hand-made", RADIUS_M, (CURVE, CURVE + (0, 0.04, 0)), (Box((0, 0.1), (0.06, 0.06, 0.02), 0.0),))
LOOK = Appearance("speckled", "printed", 0.5, 0.4)


@pytest.fixture(scope="module")
def caster() -> RayCaster:
    return RayCaster(SCENE)


@pytest.fixture(scope="module")
def materials() -> Materials:
    return Materials(SCENE, LOOK, seed=1)


def hits_at(caster: RayCaster, points: NDArray[np.float64]) -> Hits:
    """Return the surfaces below the points (N, 3), from an eye far above."""
    eye = np.array([0.0, 0.0, 1.0])
    return caster.cast(eye, (points - eye).astype(np.float32))


def along(y: float, z: float, step_m: float = 1e-5) -> NDArray[np.float64]:
    x = np.arange(-0.05, 0.05, step_m)
    return np.column_stack([x, np.full(len(x), y), np.full(len(x), z)])


@pytest.mark.parametrize("y", [0.0, 0.002])
def test_the_texture_of_a_string_is_continuous_along_it(caster: RayCaster, materials: Materials, y: float) -> None:
    z = RADIUS_M + np.sqrt(RADIUS_M**2 - y**2)
    values = materials.reflectance(hits_at(caster, along(y, z)))
    # A step of 0.01 mm is 1/20 of a texel. Texels that touch differ by at most a third of the mean of 0.5, and a seam
    # between rings, each 5 mm apart, would show as a step of the whole contrast.
    assert np.abs(np.diff(values)).max() < 0.02
    assert values.std() > 0.05


def test_the_texture_of_a_string_is_continuous_around_it(caster: RayCaster, materials: Materials) -> None:
    angle = np.linspace(np.deg2rad(30), np.deg2rad(150), 2000)
    points = np.column_stack([np.full(2000, 0.0123), RADIUS_M * np.cos(angle), RADIUS_M + RADIUS_M * np.sin(angle)])
    values = materials.reflectance(hits_at(caster, points))
    # A step is 0.004 mm on average, and at most twice that on slanted faces.
    assert np.abs(np.diff(values)).max() < 0.03
    assert values.std() > 0.02


def test_strings_differ_and_clutter_is_grey(caster: RayCaster, materials: Materials) -> None:
    first = materials.reflectance(hits_at(caster, along(0.0, 2 * RADIUS_M, 1e-3)))
    second = materials.reflectance(hits_at(caster, along(0.04, 2 * RADIUS_M, 1e-3)))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.5
    grid = np.stack(np.meshgrid(np.linspace(-0.02, 0.02, 60), np.linspace(0.08, 0.12, 60)), axis=-1).reshape(-1, 2)
    on_box = materials.reflectance(hits_at(caster, np.column_stack([grid, np.full(len(grid), 0.02)])))
    # The mean over 4 cm holds few of the largest spots, which are 5 mm wide.
    assert on_box.mean() == pytest.approx(0.30, rel=0.15)


def test_nothing_reflects_nothing(materials: Materials, caster: RayCaster) -> None:
    eye = np.array([0.0, 0.0, 1.0])
    assert materials.reflectance(caster.cast(eye, np.array([[0, 0, 1]], dtype=np.float32))).tolist() == [0.0]


def test_the_seed_decides_the_texture(caster: RayCaster, materials: Materials) -> None:
    hits = hits_at(caster, along(0.0, 2 * RADIUS_M, 1e-3))
    assert np.array_equal(Materials(SCENE, LOOK, seed=1).reflectance(hits), materials.reflectance(hits))
    assert not np.array_equal(Materials(SCENE, LOOK, seed=2).reflectance(hits), materials.reflectance(hits))
