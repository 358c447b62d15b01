"""Rigid transforms form a group; other matrices are rejected."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from calibration.geometry.transforms import (
    ROTATION_TOLERANCE,
    NotRigidError,
    from_quaternion,
    from_rotation_vector,
    inverse,
    rigid,
    rotation_angle,
    to_quaternion,
    transform_points,
    with_nearest_rotation,
)

NEAR = {"rtol": 0, "atol": 1e-13}
"""Tolerance of a few hundred rounding errors of doubles below ten metres."""


def vectors(bound: float) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, 3, elements=st.floats(-bound, bound))


transforms = st.builds(from_rotation_vector, vectors(2.0), vectors(5.0))
points = hnp.arrays(np.float64, st.tuples(st.integers(1, 5), st.just(3)), elements=st.floats(-2, 2))


@settings(deadline=None)
@given(transforms, transforms)
def test_a_product_of_transforms_is_a_transform(T_a_b: np.ndarray, T_b_c: np.ndarray) -> None:
    T_a_c = T_a_b @ T_b_c
    np.testing.assert_array_equal(rigid(T_a_c, "T_a_c"), T_a_c)


@settings(deadline=None)
@given(transforms, transforms, transforms)
def test_composition_is_associative(T_a_b: np.ndarray, T_b_c: np.ndarray, T_c_d: np.ndarray) -> None:
    np.testing.assert_allclose((T_a_b @ T_b_c) @ T_c_d, T_a_b @ (T_b_c @ T_c_d), **NEAR)


@settings(deadline=None)
@given(points)
def test_the_identity_changes_no_point(p: np.ndarray) -> None:
    np.testing.assert_array_equal(transform_points(np.eye(4), p), p)
    np.testing.assert_array_equal(inverse(np.eye(4)), np.eye(4))
    np.testing.assert_array_equal(from_rotation_vector((0, 0, 0), (0, 0, 0)), np.eye(4))


@settings(deadline=None)
@given(transforms)
def test_the_inverse_cancels_a_transform(T_a_b: np.ndarray) -> None:
    np.testing.assert_allclose(T_a_b @ inverse(T_a_b), np.eye(4), **NEAR)
    np.testing.assert_allclose(inverse(T_a_b) @ T_a_b, np.eye(4), **NEAR)
    np.testing.assert_allclose(inverse(inverse(T_a_b)), T_a_b, **NEAR)


@settings(deadline=None)
@given(transforms, transforms, points)
def test_a_product_acts_like_successive_transforms(T_a_b: np.ndarray, T_b_c: np.ndarray, p_c: np.ndarray) -> None:
    step_by_step = transform_points(T_a_b, transform_points(T_b_c, p_c))
    np.testing.assert_allclose(transform_points(T_a_b @ T_b_c, p_c), step_by_step, **NEAR)


@settings(deadline=None)
@given(transforms, points)
def test_distances_and_handedness_are_kept(T: np.ndarray, p: np.ndarray) -> None:
    q = transform_points(T, p)
    before, after = np.linalg.norm(p - p[0], axis=1), np.linalg.norm(q - q[0], axis=1)
    np.testing.assert_allclose(after, before, **NEAR)
    np.testing.assert_allclose(np.linalg.det(T[:3, :3]), 1.0, **NEAR)


@settings(deadline=None)
@given(transforms)
def test_a_quaternion_gives_the_original_transform(T: np.ndarray) -> None:
    np.testing.assert_allclose(from_quaternion(T[:3, 3], to_quaternion(T), "T"), T, **NEAR)
    # q and -q are the same rotation.
    np.testing.assert_allclose(from_quaternion(T[:3, 3], -to_quaternion(T), "T"), T, **NEAR)


@settings(deadline=None)
@given(transforms)
def test_inverse_turns_by_the_same_angle(T: np.ndarray) -> None:
    # Like acos near 0 and pi: rounding errors of 1e-16 become angles of 1e-8.
    assert rotation_angle(inverse(T)) == pytest.approx(rotation_angle(T), abs=1e-7)


def test_a_quarter_turn_about_z_is_exact() -> None:
    half = np.sqrt(0.5)
    T_a_b = from_quaternion((1, 2, 3), (0, 0, half, half), "T_a_b")
    np.testing.assert_allclose(transform_points(T_a_b, np.array([[1.0, 0.0, 0.0]])), [[1, 3, 3]], **NEAR)
    np.testing.assert_allclose(from_rotation_vector((1, 2, 3), (0, 0, np.pi / 2)), T_a_b, **NEAR)
    assert rotation_angle(T_a_b) == pytest.approx(np.pi / 2, abs=1e-12)


def test_a_checked_matrix_is_a_copy() -> None:
    given_matrix = np.eye(4)
    checked = rigid(given_matrix, "T")
    given_matrix[0, 3] = 5.0
    assert checked[0, 3] == 0.0
    assert rigid(np.eye(4).tolist(), "T").dtype == np.float64


def test_the_tolerance_is_that_of_the_constant() -> None:
    stretched = np.eye(4)
    # (1 + e)^2 - 1 = 2 e to first order.
    stretched[0, 0] = 1 + 0.49 * ROTATION_TOLERANCE
    rigid(stretched, "T")
    stretched[0, 0] = 1 + 0.51 * ROTATION_TOLERANCE
    with pytest.raises(NotRigidError, match="T is not rigid"):
        rigid(stretched, "T")


@settings(deadline=None)
@given(transforms)
def test_an_exact_rotation_is_kept_bit_by_bit(T_a_b: np.ndarray) -> None:
    assert with_nearest_rotation(T_a_b).tobytes() == T_a_b.tobytes()


@settings(deadline=None)
@given(transforms, st.integers(4, 10))
def test_a_rounded_rotation_becomes_the_nearest_exact_one(T_a_b: np.ndarray, decimals: int) -> None:
    rounded = T_a_b.round(decimals)
    exact = with_nearest_rotation(rounded)
    R = exact[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), **NEAR)
    assert np.linalg.det(R) > 0
    # The nearest rotation is at most as far from the rounded one as the original: sqrt(9) roundings of half a unit.
    assert np.linalg.norm(R - rounded[:3, :3]) <= 1.5 * 10.0**-decimals + 1e-12
    np.testing.assert_array_equal(exact[:, 3], rounded[:, 3])


def with_entry(row: int, column: int, value: float) -> np.ndarray:
    T = np.eye(4)
    T[row, column] = value
    return T


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ("words", "is not a matrix of numbers"),
        ([[1, 2], [3]], "is not a matrix of numbers"),
        ({"T": 1}, "is not a matrix of numbers"),
        (np.eye(3), r"has shape \(3, 3\); a 4x4 matrix is needed"),
        (np.zeros((2, 4, 4)), r"has shape \(2, 4, 4\)"),
        (with_entry(0, 3, np.nan), "holds NaN or infinity"),
        (with_entry(1, 1, np.inf), "holds NaN or infinity"),
        (with_entry(3, 0, 0.1), r"has the last row \[0.1, 0.0, 0.0, 1.0\]"),
        (2 * np.eye(4), "has the last row"),
        (np.diag([1000.0, 1000.0, 1000.0, 1.0]), "is not rigid: .*mean scale 1000"),
        (with_entry(0, 1, 0.01), "is not rigid"),
        (with_entry(0, 0, 1e300), "is not rigid"),
        (np.zeros((4, 4)) + np.diag([0, 0, 0, 1]), "is not rigid"),
        (np.diag([1, 1, -1, 1]), r"is mirrored \(determinant -1\)"),
        (np.diag([-1, -1, -1, 1]), r"is mirrored \(determinant -1\)"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_a_matrix_that_is_not_rigid_is_rejected(matrix: Any, message: str) -> None:
    with pytest.raises(NotRigidError, match=f"T_base_flange {message}"):
        rigid(matrix, "T_base_flange")


def test_a_transposed_matrix_is_rejected() -> None:
    with pytest.raises(NotRigidError, match="has the last row"):
        rigid(from_rotation_vector((0.1, 0.2, 0.3), (0, 0, 1)).T, "T")


@pytest.mark.parametrize(
    ("translation", "quaternion", "message"),
    [
        ((0, 0, np.nan), (0, 0, 0, 1), "^T holds NaN or infinity"),
        ((0, 0, 0), (0, 0, 0, np.inf), "^T holds NaN or infinity"),
        ((0, 0, 0), (0, 0, 0, 0), "^T has a rotation quaternion of length 0; it must be 1"),
        ((0, 0, 0), (0, 0, 0, 1.01), "^T has a rotation quaternion of length 1.01; it must be 1"),
        ((0, 0, 0), (0, 1e100, 0, 0), r"^T has a rotation quaternion of length 1e\+100"),
    ],
)
def test_a_quaternion_that_is_not_a_rotation_is_rejected(translation: Any, quaternion: Any, message: str) -> None:
    with pytest.raises(NotRigidError, match=message):
        from_quaternion(translation, quaternion, "T")
