"""Bad inputs of the public solver. Each mistake is refused by its name, in many random cells."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.errors import HandEyeInputError
from calibration.geometry.transforms import from_rotation_vector, inverse
from calibration.hand_eye import solve_hand_eye
from calibration.observations import Mounting, Observations
from calibration.result import HandEyeResult
from tests.calibration.board_views import (
    Noise,
    Plan,
    error_of,
    orbit_plan,
    random_plan,
    realistic_plan,
    record,
    with_poses,
)

pytestmark = pytest.mark.slow

Poses = np.ndarray
Spoil = Callable[[Poses, np.random.Generator], Poses]
MOUNTINGS: tuple[Mounting, ...] = ("eye-in-hand", "eye-to-hand")
VIEWS = 12


def seeds(quick: int, all_of_them: int = 30) -> list:
    """Return the first seeds, and all others as soak tests."""
    return [pytest.param(seed, marks=[] if seed < quick else [pytest.mark.soak]) for seed in range(all_of_them)]


def outcome(observations: Observations) -> tuple[str | None, HandEyeResult | None]:
    """Return the first blocking code (None: there is none), and the result if there is one."""
    try:
        result = solve_hand_eye(observations)
    except HandEyeInputError as error:
        return error.slug, None
    return (result.findings[0].code if result.findings else None), result


def refusal(observations: Observations) -> str | None:
    code, result = outcome(observations)
    return code if result is None or result.verdict == "refuse" else None


def recorded(seed: int, mounting: Mounting = "eye-in-hand", plan: Plan | None = None, noise: Noise | None = None):
    return record(seed, VIEWS, noise, plan or (random_plan, realistic_plan)[seed % 2], mounting)


def turned(T: Poses, rotations: Rotation) -> Poses:
    result = T.copy()
    result[:, :3, :3] = rotations.as_matrix()
    return result


def rotations(T: Poses) -> Rotation:
    return Rotation.from_matrix(T[:, :3, :3])


def without_turning(T: Poses, rng: np.random.Generator) -> Poses:
    return turned(T, Rotation.from_matrix(np.repeat(T[:1, :3, :3], len(T), axis=0)))


def about_one_axis(T: Poses, rng: np.random.Generator) -> Poses:
    turns = np.outer(rng.uniform(-2, 2, len(T)), [0.0, 0.0, 1.0])
    return turned(T, Rotation.from_rotvec(turns) * Rotation.from_matrix(T[0, :3, :3]))


def mirrored(T: Poses, rng: np.random.Generator) -> Poses:
    return T @ np.diag([1.0, -1.0, 1.0, 1.0])


def with_nan(T: Poses, rng: np.random.Generator) -> Poses:
    result = T.copy()
    result[rng.integers(len(T)), rng.integers(3), rng.integers(4)] = np.nan
    return result


def in_millimetres(T: Poses, rng: np.random.Generator) -> Poses:
    result = T.copy()
    result[:, :3, 3] *= 1000.0
    return result


def shuffled(T: Poses, rng: np.random.Generator) -> Poses:
    return T[rng.permutation(len(T))]


def off_by_one(T: Poses, rng: np.random.Generator) -> Poses:
    return np.roll(T, rng.choice([-1, 1]), axis=0)


def inverted(T: Poses, rng: np.random.Generator) -> Poses:
    return np.array([inverse(pose) for pose in T])


def in_degrees(T: Poses, rng: np.random.Generator) -> Poses:
    return turned(T, Rotation.from_rotvec(rotations(T).as_rotvec(degrees=True)))


def as_euler_angles(T: Poses, rng: np.random.Generator) -> Poses:
    return turned(T, Rotation.from_euler("xyz", rotations(T).as_rotvec()))


def with_another_tool(T: Poses, rng: np.random.Generator) -> Poses:
    result = T.copy()
    first = rng.integers(4, len(T) - 3)
    result[first:] = T[first:] @ from_rotation_vector(rng.uniform(-0.1, 0.1, 3) + [0, 0, 0.1], rng.normal(0, 0.1, 3))
    return result


def camera_moved(T: Poses, rng: np.random.Generator) -> Poses:
    """Move a fixed camera: the later images belong to poses that differ in the base frame."""
    result = T.copy()
    result[VIEWS // 2 :] = from_rotation_vector([0.03, -0.01, 0.0], [0.0, 0.0, 0.02]) @ T[VIEWS // 2 :]
    return result


def board_moved(offset_m: float) -> Spoil:
    """Move the board on the table: the later images belong to poses that differ by its displacement."""

    def spoil(T: Poses, rng: np.random.Generator) -> Poses:
        azimuth = rng.uniform(-np.pi, np.pi)
        moved = from_rotation_vector([offset_m * np.cos(azimuth), offset_m * np.sin(azimuth), 0.0], [0.0, 0.0, 0.0])
        result = T.copy()
        result[VIEWS // 2 :] = moved @ T[VIEWS // 2 :]
        return result

    return spoil


@dataclass(frozen=True)
class Mistake:
    spoil: Spoil
    code: str
    mountings: tuple[Mounting, ...] = MOUNTINGS


MISTAKES = [
    Mistake(without_turning, "pure-translation"),
    Mistake(about_one_axis, "parallel-axes"),
    Mistake(mirrored, "not-rigid"),
    Mistake(with_nan, "not-finite"),
    Mistake(in_millimetres, "millimetres"),
    Mistake(shuffled, "poses-shuffled"),
    Mistake(off_by_one, "pairs-off-by-one"),
    Mistake(inverted, "poses-inverted"),
    Mistake(in_degrees, "degrees"),
    Mistake(as_euler_angles, "euler-angles"),
    Mistake(with_another_tool, "tcp-changed", ("eye-in-hand",)),
    # A board that slipped on the flange is equivalent, so the message names both.
    Mistake(with_another_tool, "board-moved", ("eye-to-hand",)),
    Mistake(camera_moved, "camera-moved", ("eye-to-hand",)),
    Mistake(board_moved(0.003), "board-moved", ("eye-in-hand",)),
    Mistake(board_moved(0.010), "board-moved", ("eye-in-hand",)),
]
CASES = [(mistake, mounting) for mistake in MISTAKES for mounting in mistake.mountings]


@pytest.mark.parametrize("seed", seeds(quick=1))
@pytest.mark.parametrize(
    ("mistake", "mounting"), CASES, ids=[f"{mistake.code}-{mounting}" for mistake, mounting in CASES]
)
def test_a_mistake_with_poses_is_refused_by_name(mistake, mounting, seed):
    good = recorded(seed, mounting)
    poses = mistake.spoil(good.T_base_flange, np.random.default_rng(seed))
    assert refusal(with_poses(good.observations, poses)) == mistake.code


def test_five_views_are_refused():
    observations = recorded(1).observations
    assert refusal(replace(observations, views=observations.views[:5])) == "too-few-views"


def test_mirrored_images_are_refused():
    # A marker detector refuses the image. For other boards and detectors, the poses reveal it.
    observations = recorded(2).observations
    width = observations.image_size[0]
    views = tuple(
        replace(view, pixels=np.column_stack([width - 1 - view.pixels[:, 0], view.pixels[:, 1]]))
        for view in observations.views
    )
    assert refusal(replace(observations, views=views)) == "board-mirrored"


@pytest.mark.parametrize("seed", seeds(quick=6))
def test_a_board_displacement_of_one_millimetre_has_little_effect(seed):
    good = record(seed, 15, plan=realistic_plan)
    poses = board_moved(0.001)(good.T_base_flange, np.random.default_rng(seed))
    code, result = outcome(with_poses(good.observations, poses))
    assert result is not None
    assert result.verdict != "refuse", code
    assert error_of(result.X, good.X)[1] <= 1.1


@pytest.mark.parametrize("seed", seeds(quick=10, all_of_them=40))
@pytest.mark.parametrize("share", [0.01, -0.01])
def test_a_board_of_another_size_is_refused(share, seed):
    good = record(seed, 15, Noise(scale=share), realistic_plan)
    assert refusal(good.observations) == "board-scale"


@pytest.mark.parametrize("seed", seeds(quick=2))
@pytest.mark.parametrize(
    ("change", "code"),
    [((0, 0, 30, 0), "optical-axis"), ((0, 0, 0, -30), "optical-axis"), ((0.008, -0.008, 0, 0), "focal-length")],
)
def test_the_matrix_of_another_camera_is_refused(change, code, seed):
    observations = recorded(seed).observations
    K = observations.K.copy()
    K[[0, 1], [0, 1]] *= 1 + np.array(change[:2])
    K[:2, 2] += change[2:]
    result = outcome(replace(observations, K=K))[1]
    assert result is not None
    assert code in [finding.code for finding in result.findings if finding.blocking]


@pytest.mark.parametrize("seed", seeds(quick=2))
@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("k1", [-0.1, 0.1])
def test_undeclared_lens_distortion_is_refused(k1, mounting, seed):
    straight = recorded(seed, mounting).observations
    views = []
    for view in straight.views:
        rays = (view.pixels - straight.K[:2, 2]) / straight.K[[0, 1], [0, 1]]
        rays = rays * (1 + k1 * (rays**2).sum(axis=1, keepdims=True))
        pixels = rays * straight.K[[0, 1], [0, 1]] + straight.K[:2, 2]
        inside = (pixels >= 0).all(axis=1) & (pixels < straight.image_size).all(axis=1)
        views.append(replace(view, ids=view.ids[inside], pixels=pixels[inside]))
    result = outcome(replace(straight, views=tuple(views)))[1]
    assert result is not None
    assert "lens-distortion" in [finding.code for finding in result.findings if finding.blocking]


@pytest.mark.parametrize("seed", seeds(quick=3))
@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("share", [0.0, 0.005])
def test_an_orbit_at_one_distance_has_a_warning_and_a_larger_covariance(share, mounting, seed):
    good = record(seed, 15, Noise(scale=share), orbit_plan, mounting)
    _, result = outcome(good.observations)
    assert result is not None
    assert "board-scale-unverified" in [finding.code for finding in result.findings]
    # 0.5 % of 0.4 m is 2 mm, which an orbit does not determine: within three of the reported sigmas.
    assert error_of(result.X, good.X)[1] <= 3 * 1e3 * result.sigma_m


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("seed", seeds(quick=2))
def test_good_views_are_accepted(seed, mounting):
    good = recorded(seed, mounting, realistic_plan)
    code, result = outcome(good.observations)
    assert code is None
    assert result is not None
    assert result.verdict == "accept"
    # The limits are those of the tests of the solver: 0.8 mm for 12 views.
    assert error_of(result.X, good.X)[1] <= 0.8
