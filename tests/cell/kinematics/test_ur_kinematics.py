import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from calibration.geometry.transforms import rigid
from cell.config.arm_models import ArmModelName
from cell.kinematics.ur_kinematics import (
    ARMS,
    _solver,
    flange_speeds,
    forward,
    inverse,
    inverse_each,
    jacobian,
    joint_limits,
    joint_speeds,
    link_frames,
)

MODELS: tuple[ArmModelName, ...] = ("ur3e", "ur5e", "ur10e")
models = st.sampled_from(MODELS)
angles = st.lists(st.floats(-6.2, 6.2), min_size=6, max_size=6).map(np.array)

# The poses of the solver are exact to rounding of doubles. The code under test checks its poses to 1e-7.
POSE = 2e-7


def turned(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of angles from the nearest whole turn, radians."""
    return np.abs(np.angle(np.exp(1j * q)))


@pytest.mark.parametrize(
    ("model", "place"),
    # x = a2 + a3, y = -(d4 + d6), z = d1 - d5 of the tables of UR, metres.
    [
        ("ur3e", (-0.45675, -0.22315, 0.0665)),
        ("ur5e", (-0.8172, -0.2329, 0.0628)),
        ("ur10e", (-1.18425, -0.2907, 0.06085)),
    ],
)
def test_at_zero_angles_the_arm_is_stretched_along_minus_x(
    model: ArmModelName, place: tuple[float, float, float]
) -> None:
    T = forward(model, np.zeros(6))
    assert T[:3, 3] == pytest.approx(place, abs=1e-9)
    # The z axis of the flange points along -y, and its x axis along the links.
    assert T[:3, 2] == pytest.approx((0, -1, 0), abs=1e-9)


@given(models, angles)
def test_the_table_and_the_solver_agree(model: ArmModelName, q: NDArray[np.float64]) -> None:
    frames = link_frames(model, q)
    assert frames.shape == (7, 4, 4)
    assert np.array_equal(frames[0], np.eye(4))
    assert np.array_equal(rigid(forward(model, q), "flange"), frames[6])
    # The solver returns its rotation by columns.
    R, t = _solver(model)[0].forward_kinematics(q.tolist())
    assert np.abs(np.array(R).T @ _solver(model)[1] - frames[6, :3, :3]).max() < 1e-12
    assert np.abs(t - frames[6, :3, 3]).max() < 1e-12


@given(models, angles)
def test_a_batch_gives_the_same_frames_as_single_configurations(model: ArmModelName, q: NDArray[np.float64]) -> None:
    many = np.array([[q, q + 0.3], [q - 0.2, -q]])
    frames = link_frames(model, many)
    assert frames.shape == (2, 2, 7, 4, 4)
    assert np.array_equal(frames[1, 0], link_frames(model, q - 0.2))
    assert np.array_equal(jacobian(model, many)[0, 1], jacobian(model, q + 0.3))


@given(models, angles)
def test_the_jacobian_is_the_derivative_of_the_pose(model: ArmModelName, q: NDArray[np.float64]) -> None:
    step = 1e-5
    J = jacobian(model, q)
    for k in range(6):
        ahead, behind = (forward(model, q + s * step * np.eye(6)[k]) for s in (1, -1))
        # The error of central differences is step^2 / 6 times the third derivative, at most the length of the arm.
        assert (ahead - behind)[:3, 3] / (2 * step) == pytest.approx(J[:3, k], abs=1e-8)
        spin = (ahead - behind)[:3, :3] / (2 * step) @ forward(model, q)[:3, :3].T
        assert (spin[2, 1], spin[0, 2], spin[1, 0]) == pytest.approx(tuple(J[3:, k]), abs=1e-8)


@given(models, angles, angles)
def test_the_speed_of_the_flange_is_that_of_the_jacobian(
    model: ArmModelName, q: NDArray[np.float64], qd: NDArray[np.float64]
) -> None:
    (speed,) = flange_speeds(model, q[None], qd[None])
    assert speed == pytest.approx(np.linalg.norm(jacobian(model, q)[:3] @ qd), abs=1e-12)


@given(models, angles)
def test_the_inverse_contains_the_original_configuration(model: ArmModelName, q: NDArray[np.float64]) -> None:
    found = inverse(model, forward(model, q))
    assert np.abs(link_frames(model, found)[:, 6] - forward(model, q)).max(initial=0.0) < POSE
    assert (found > -np.pi).all()
    assert (found <= np.pi).all()
    # At singular poses there are infinitely many configurations, of which only some are returned.
    if np.linalg.svd(jacobian(model, q), compute_uv=False)[-1] > 1e-3:
        assert turned(found - q).max(axis=1).min() < 1e-5
        assert len(found) <= 8


@given(models, angles)
def test_the_inverse_returns_each_configuration_once(model: ArmModelName, q: NDArray[np.float64]) -> None:
    found = inverse(model, forward(model, q))
    for k in range(len(found)):
        others = np.delete(found, k, axis=0)
        assert (turned(others - found[k]).max(axis=1) > 1e-6).all()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("degrees", "at_least"),
    [
        ((0, -90, 90, -90, -90, 0), 8),
        ((0, -90, -90, -90, 90, 0), 8),
        ((0, -90, 0, -90, 0, 0), 1),
        ((0, -90, 0, 0, 0, 0), 4),
    ],
)
def test_degenerate_poses_lose_no_configuration(
    model: ArmModelName, degrees: tuple[float, ...], at_least: int, capfd: pytest.CaptureFixture[str]
) -> None:
    q = np.deg2rad(degrees)
    T = forward(model, q)
    found = inverse(model, T)
    assert len(found) >= at_least
    assert np.abs(link_frames(model, found)[:, 6] - T).max() < POSE
    if at_least == 8:
        assert turned(found - q).max(axis=1).min() < 1e-5
    # The library prints nothing to the stream of the results.
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("model", MODELS)
def test_a_batch_gives_the_same_configurations_as_single_poses(model: ArmModelName) -> None:
    rng = np.random.default_rng(5)
    poses = np.array([forward(model, q) for q in rng.uniform(-np.pi, np.pi, (20, 6))])
    poses[7, :3, 3] = (3.0, 0.0, 0.0)
    q, which = inverse_each(model, poses)
    for k, pose in enumerate(poses):
        assert q[which == k] == pytest.approx(inverse(model, pose), abs=1e-9)
    assert not (which == 7).any()


@pytest.mark.parametrize("model", MODELS)
def test_an_unreachable_pose_has_no_configuration(model: ArmModelName) -> None:
    far = np.eye(4)
    far[0, 3] = sum(map(abs, ARMS[model].a_m)) + sum(ARMS[model].d_m)
    assert inverse(model, far).shape == (0, 6)
    # On the axis of the base: the wrist cannot be nearer to it than its offset.
    assert inverse(model, np.eye(4)).shape == (0, 6)
    q, which = inverse_each(model, np.zeros((0, 4, 4)))
    assert (q.shape, which.shape) == ((0, 6), (0,))


def test_limits_and_speeds_are_those_of_the_models() -> None:
    assert joint_limits("ur5e") == pytest.approx([2 * np.pi] * 6)
    assert joint_limits("ur3e")[:5] == pytest.approx([2 * np.pi] * 5)
    assert np.isinf(joint_limits("ur3e")[5])
    assert np.rad2deg(joint_speeds("ur3e")) == pytest.approx([180, 180, 180, 360, 360, 360])
    assert np.rad2deg(joint_speeds("ur10e")) == pytest.approx([120, 120, 180, 180, 180, 180])
