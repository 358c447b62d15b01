"""The covariance of aligned poses against drawn robot errors, independent and smooth ones."""

from collections.abc import Callable

import numpy as np
import pytest

from calibration.geometry.pose_correlation import pose_correlation
from calibration.geometry.transforms import from_rotation_vector
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correlated_errors import pose_covariance
from recognition.registration.pose_prior import N_SHARED, PosePrior, PoseSigmas, pose_prior

CENTRE = np.array([0.05, -0.02, 0.005])
VIEWS = 8
DRAWS = 150


@pytest.fixture
def poses() -> list[np.ndarray]:
    """T_base_camera of views around the centre, 0.4 m away and directed at it."""
    look = from_rotation_vector((0.25, 0.0, 0.3), np.zeros(3)) @ from_rotation_vector((0, 0, 0), (0, -2.4, 0))
    turns = [from_rotation_vector(CENTRE, (0, 0, 2 * np.pi * k / VIEWS)) for k in range(VIEWS)]
    return [turn @ look for turn in turns]


@pytest.fixture
def prior(poses: list[np.ndarray]) -> PosePrior:
    grid = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 9), np.linspace(-0.1, 0.1, 9), [0.0]), axis=-1).reshape(-1, 3)
    normals = np.tile((0.0, 0.0, 1.0), (81, 1))
    clouds = [NormalCloud(k, CENTRE + grid, normals, np.eye(4), T) for k, T in enumerate(poses)]
    return pose_prior(clouds, CENTRE, PoseSigmas())


@pytest.fixture
def aligned(prior: PosePrior) -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """`aligned(rng, correlation)`: a drawn state, and the state and information of an alignment of its differences."""
    D = np.vstack([D for D, _ in prior.robot_errors])
    robot, shared = D[:, :-N_SHARED], D[:, -N_SHARED:]
    # The surfaces show the differences of the twists of neighbouring views, to 0.05 mm and 0.2 mrad.
    difference = np.kron(np.eye(VIEWS) - np.roll(np.eye(VIEWS), 1, axis=1), np.eye(6))
    precision = np.tile(np.repeat([0.0002, 0.00005], 3) ** -2.0, VIEWS)
    surfaces = np.zeros_like(prior.information)
    surfaces[:-N_SHARED, :-N_SHARED] = difference.T @ (precision[:, None] * difference)
    information = prior.information + surfaces
    spread = np.linalg.cholesky(np.linalg.inv(PoseSigmas().shared_information))

    def align(rng: np.random.Generator, correlation: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        errors = (np.linalg.cholesky(correlation) @ rng.standard_normal((VIEWS, 6))).ravel()
        common = spread @ rng.standard_normal(N_SHARED)
        truth = np.append(np.linalg.solve(robot, errors - shared @ common), common)
        noise = difference.T @ (np.sqrt(precision) * rng.standard_normal(6 * VIEWS))
        vector = surfaces @ truth
        vector[:-N_SHARED] += noise
        return truth, np.linalg.solve(information, vector), information

    return align


@pytest.mark.parametrize("share", [0.0, 0.45, 0.9])
def test_the_mean_pose_is_as_good_as_its_covariance(
    poses: list[np.ndarray], prior: PosePrior, aligned: Callable, share: float
) -> None:
    mean = np.tile(np.eye(6), (1, VIEWS))[3:5] / VIEWS
    correlation = (1 - share) * np.eye(VIEWS) + share * pose_correlation(np.array(poses))
    rng = np.random.default_rng(3)
    assumed, known = [], []
    for _ in range(DRAWS):
        truth, state, information = aligned(rng, correlation)
        error = mean @ (state - truth)[:-N_SHARED]
        covariance = pose_covariance(state, information, prior, poses)
        independent = np.linalg.inv(information)[:-N_SHARED, :-N_SHARED]
        known.append(error @ np.linalg.solve(mean @ covariance @ mean.T, error) / 2)
        assumed.append(error @ np.linalg.solve(mean @ independent @ mean.T, error) / 2)
    # Chi square of 300 degrees of freedom over 300: a standard deviation of 0.08.
    assert 0.7 < np.mean(known) < 1.3
    assert (np.mean(assumed) > 1.5) == (share > 0)


@pytest.mark.parametrize("share", [0.0, 0.9])
def test_larger_errors_than_given_are_in_the_covariance(
    poses: list[np.ndarray], prior: PosePrior, aligned: Callable, share: float
) -> None:
    mean = np.tile(np.eye(6), (1, VIEWS))[3:5] / VIEWS
    correlation = (1 - share) * np.eye(VIEWS) + share * pose_correlation(np.array(poses))
    rng = np.random.default_rng(4)
    sigmas = {}
    for size in (0.5, 1.0, 2.0):
        squares, variances = [], []
        for _ in range(DRAWS // 3):
            truth, state, information = aligned(rng, size**2 * correlation)
            covariance = mean @ pose_covariance(state, information, prior, poses) @ mean.T
            error = mean @ (state - truth)[:-N_SHARED]
            squares.append(error @ np.linalg.solve(covariance, error) / 2)
            variances.append(np.trace(covariance))
        # Chi square of 100 degrees of freedom over 100: a standard deviation of 0.14.
        assert np.mean(squares) < 1.4
        sigmas[size] = np.sqrt(np.median(variances))
    assert sigmas[2.0] > 1.3 * sigmas[1.0]
    # Smaller errors than given do not reduce the covariance.
    assert sigmas[0.5] > 0.9 * sigmas[1.0]


def test_without_camera_poses_the_errors_are_independent(
    poses: list[np.ndarray], prior: PosePrior, aligned: Callable
) -> None:
    _, state, information = aligned(np.random.default_rng(0), np.eye(VIEWS))
    covariance = pose_covariance(state, information, prior, [None, *poses[1:]])
    expected = np.linalg.inv(information)[:-N_SHARED, :-N_SHARED]
    np.testing.assert_allclose(covariance, expected, rtol=1e-9, atol=0)


def test_a_single_view_has_the_covariance_of_its_prior(poses: list[np.ndarray]) -> None:
    cloud = NormalCloud(0, CENTRE + np.eye(3), np.eye(3), np.eye(4), poses[0])
    prior = pose_prior([cloud], CENTRE, PoseSigmas())
    covariance = pose_covariance(np.zeros(6 + N_SHARED), prior.information, prior, poses[:1])
    expected = np.linalg.inv(prior.information)[:6, :6]
    np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-6 * expected.max())
