"""Import of depth images: poses, file names, depths and units."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.geometry.transforms import from_quaternion, to_quaternion
from cell.frames.depth_file import fine_unit, to_counts
from cell.frames.folder import natural_order
from cell.frames.import_frames import encodable


@given(st.integers(0, 2**32 - 1))
def test_a_pose_of_a_recording_is_read_exactly(seed: int) -> None:
    random = np.random.default_rng(seed)
    quaternion = random.normal(size=4)
    first = from_quaternion(random.normal(size=3), quaternion / np.linalg.norm(quaternion), "T")
    recorded = from_quaternion(first[:3, 3], to_quaternion(first), "T")
    encoded = encodable(recorded)
    np.testing.assert_allclose(encoded, recorded, rtol=0, atol=1e-14)
    read = from_quaternion(encoded[:3, 3], to_quaternion(encoded), "T")
    np.testing.assert_allclose(read, recorded, rtol=0, atol=1e-15)


def test_numbers_in_file_names_are_ordered_by_value() -> None:
    names = ["view10.png", "view2.png", "view1b.png", "view1.png"]
    assert [path.name for path in sorted(map(Path, names), key=natural_order)] == [
        "view1.png",
        "view1b.png",
        "view2.png",
        "view10.png",
    ]


def test_metres_become_counts_and_missing_depths_become_zero() -> None:
    metres = np.array([[0.5, np.nan, np.inf], [0.0, 7.0, 1e-9]])
    assert to_counts(metres, 1.0, 1e-4).tolist() == [[5000, 0, 0], [0, 0, 0]]


def test_integer_counts_are_unchanged() -> None:
    counts = np.array([[0, 1, 65535, 65536]], dtype=np.int32)
    assert to_counts(counts, 0.001, 0.001).tolist() == [[0, 1, 65535, 0]]


@pytest.mark.parametrize(("largest_m", "unit_m"), [(0.6, 1e-5), (1.3, 2e-5), (3.2, 5e-5), (6.5, 1e-4), (60.0, 1e-4)])
def test_the_unit_is_the_finest_that_reaches_the_largest_depth(largest_m: float, unit_m: float) -> None:
    assert fine_unit(largest_m) == unit_m
