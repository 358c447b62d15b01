"""Bundle adjustment: derivatives, noise levels, convergence, and leave-one-out predictions."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from calibration.observations import Mounting
from calibration.pose_estimation.board_pose import estimate_board_poses
from calibration.pose_estimation.projection import N_CORRECTIONS, reprojection_residuals, stack_corners
from calibration.solver.adjustment import Adjustment
from calibration.solver.bundle_adjustment import adjust
from calibration.solver.cross_validation import cross_validate
from calibration.solver.noise import NoiseLevel, NoisePriors
from calibration.solver.problem import (
    N_SHARED,
    LinearisedCorners,
    NormalEquations,
    Problem,
    Unknowns,
    build_normal_equations,
    linearise_corners,
)
from tests.calibration.board_views import Noise, Recorded, error_of, record

MOUNTINGS: list[Mounting] = ["eye-in-hand", "eye-to-hand"]


def problem_of(recorded: Recorded, priors: NoisePriors | None = None) -> Problem:
    observations = recorded.observations
    return Problem(stack_corners(observations), recorded.T_base_flange, observations.mounting, priors or NoisePriors())


def adjusted_of(recorded: Recorded, problem: Problem, used: np.ndarray | None = None) -> Adjustment:
    count = len(recorded.T_camera_board)
    start = Unknowns(recorded.X, recorded.Y, np.zeros((count, 6)), np.zeros(N_CORRECTIONS))
    used = np.ones(count, dtype=bool) if used is None else used
    return adjust(problem, start, used, problem.corners.seen, problem.priors.noise)


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_derivatives_equal_finite_differences(mounting: Mounting) -> None:
    recorded = record(0, 4, mounting=mounting)
    problem = replace(problem_of(recorded), has_smooth_errors=True)
    rng = np.random.default_rng(0)
    # The values are not zero, so every term has an effect.
    errors = np.concatenate([rng.normal(0, 0.003, (4, 3)), rng.normal(0, 0.001, (4, 3))], axis=1)
    n_smooth = problem.smooth_modes.shape[2]
    corrections, weights = rng.normal(0, 0.003, N_CORRECTIONS), rng.normal(0, 0.001, n_smooth)
    unknowns = Unknowns(recorded.X, recorded.Y, errors, corrections, weights)

    def residuals(errors_step: np.ndarray, shared: np.ndarray) -> np.ndarray:
        moved = unknowns.add_step(shared, np.tile(errors_step, (4, 1)))
        return reprojection_residuals(moved.T_camera_board(problem), moved.corrections, problem.corners)[0].reshape(
            4, -1
        )

    step = 1e-6
    columns = []
    for k in range(6 + N_SHARED + n_smooth):
        v = step * np.eye(6 + N_SHARED + n_smooth)[k]
        # Residuals are observed minus predicted, so the derivative of the prediction has the opposite sign.
        columns.append((residuals(-v[:6], -v[6:]) - residuals(v[:6], v[6:])) / (2 * step))
    J = np.stack(columns, axis=2)
    corners = linearise_corners(problem, unknowns, problem.corners.seen)
    expected = J.swapaxes(1, 2) @ J
    scale = np.sqrt(np.einsum("nii->ni", expected))
    scale = scale[:, :, None] * scale[:, None]
    # Central differences of 1e-6, and a series of the derivative of the rotation to the second power of 1e-5.
    np.testing.assert_allclose(corners.H / scale, expected / scale, atol=1e-6)
    pull = (J.swapaxes(1, 2) @ residuals(np.zeros(6), np.zeros(N_SHARED + n_smooth))[..., None])[..., 0]
    np.testing.assert_allclose(corners.g, pull, rtol=1e-5, atol=1e-4 * np.abs(pull).max())


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_noise_levels_are_estimated(mounting: Mounting) -> None:
    noise = Noise(pixel_px=0.35, robot_m=3e-4, robot_rad=float(np.radians(0.05)))
    found = []
    for seed in range(8):
        recorded = record(seed, 20, noise, mounting=mounting)
        level = adjusted_of(recorded, problem_of(recorded)).noise
        found.append([level.pixel_px, level.robot_m, level.robot_rad])
    # 20 views have 2800 coordinates and about 40 robot errors of each kind. The mean square of eight estimates
    # scatters by 4 %.
    pixel_px, robot_m, robot_rad = np.sqrt(np.mean(np.square(found), axis=0))
    assert pixel_px == pytest.approx(0.35, rel=0.02)
    assert robot_m == pytest.approx(3e-4, rel=0.15)
    assert robot_rad == pytest.approx(np.radians(0.05), rel=0.15)


def test_fixed_noise_levels_are_not_changed() -> None:
    recorded = record(1, 12)
    priors = NoisePriors(pixel_px=0.5, robot_m=1e-9, robot_rad=1e-9, estimate_noise=False)
    adjusted = adjusted_of(recorded, problem_of(recorded, priors))
    assert adjusted.noise == priors.noise
    # The robot has no error, so all residuals are noise of the pixels.
    assert np.abs(adjusted.unknowns.robot_errors).max() < 1e-9
    assert adjusted.normal_equations.squares_px2.sum() / (2 * problem_of(recorded).corners.seen.sum()) > 0.2**2


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_leave_one_out_in_one_step_equals_a_new_adjustment(mounting: Mounting) -> None:
    recorded = record(2, 12, mounting=mounting)
    # The noise is fixed, as in the single step.
    problem = problem_of(recorded, NoisePriors(estimate_noise=False))
    board_poses = estimate_board_poses(problem.corners)
    quick = cross_validate(problem, board_poses, adjusted_of(recorded, problem))
    for k in (0, 5, 11):
        used = np.arange(12) != k
        slow = cross_validate(problem, board_poses, adjusted_of(recorded, problem, used))
        # Terms of second order in corrections of about 1e-4.
        np.testing.assert_allclose(quick.robot_errors[k], slow.robot_errors[k], atol=2e-6)
        assert quick.loo_error_m[k] == pytest.approx(slow.loo_error_m[k], abs=2e-6)
        assert quick.squares[k] == pytest.approx(slow.squares[k], rel=0.02)


def test_leave_one_out_errors_have_the_expected_chi_square() -> None:
    squares = []
    for seed in range(10):
        recorded = record(seed, 16)
        problem = problem_of(recorded)
        squares.append(
            cross_validate(problem, estimate_board_poses(problem.corners), adjusted_of(recorded, problem)).squares
        )
    # 160 values with a variance of 12, and more because the noise is estimated too: 0.3 is one standard deviation.
    assert np.mean(squares) == pytest.approx(6.0, abs=1.2)


def test_bad_corners_in_a_good_view_are_excluded() -> None:
    from calibration.hand_eye import solve_hand_eye

    recorded = record(3, 15)
    views = []
    for view in recorded.observations.views:
        pixels = view.pixels.copy()
        pixels[7] += (3.0, 2.0)
        views.append(replace(view, pixels=pixels))
    clean = solve_hand_eye(recorded.observations)
    result = solve_hand_eye(replace(recorded.observations, views=tuple(views)))
    assert all(view.used for view in result.views)
    assert result.pixel_sigma_px == pytest.approx(clean.pixel_sigma_px, rel=0.03)
    # One corner of 70 has little effect on a solution with uncertainties of 0.03 degrees and 0.25 mm.
    degrees, millimetres = error_of(result.X, clean.X)
    assert degrees < 0.02
    assert millimetres < 0.1


def test_a_step_to_an_undefined_cost_is_not_taken() -> None:
    recorded = record(0, 8)
    problem = problem_of(recorded)
    pixels = problem.corners.pixels.copy()
    pixels[3, np.flatnonzero(problem.corners.seen[3])[0]] = np.nan
    adjusted = adjusted_of(recorded, replace(problem, corners=replace(problem.corners, pixels=pixels)))
    np.testing.assert_array_equal(adjusted.unknowns.X, recorded.X)


def test_convergence_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = record(3, 12, Noise())
    problem = problem_of(recorded)
    assert adjusted_of(recorded, problem).converged
    monkeypatch.setattr("calibration.solver.bundle_adjustment.MAX_STEPS", 1)
    assert not adjusted_of(recorded, problem).converged


def test_an_adjustment_without_a_decreasing_step_has_not_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = record(3, 12, Noise())
    problem = problem_of(recorded)

    costs = itertools.count(1.0)

    def worse(problem: Problem, corners: LinearisedCorners, used: np.ndarray, noise: NoiseLevel) -> NormalEquations:
        return replace(build_normal_equations(problem, corners, used, noise), cost=next(costs))

    monkeypatch.setattr("calibration.solver.bundle_adjustment.build_normal_equations", worse)
    assert not adjusted_of(recorded, problem).converged
