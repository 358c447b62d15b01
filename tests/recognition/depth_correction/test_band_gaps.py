"""Axes go on across gaps in which windows lowered a string, and not across bare table."""

import numpy as np
import pytest
from numpy.typing import NDArray

from recognition.depth_correction.band_gaps import MAX_GAP_RADII, MIN_GAP_HEIGHT, bridge_gaps
from tests.recognition.depth_correction.test_string_bands import R_PX, K, R, bands_of, in_windows, string_heights

LOW = 1.35 * MIN_GAP_HEIGHT
"""Height of a string that is too low for a band, as a share of its height. Windows lower it by another 10 %."""
COLUMN = round(K[0, 2])
"""Column in the middle of the image, in which the string is straight."""


def with_gap(length_radii: float, height: float, shift_px: int = 0) -> NDArray[np.float64]:
    """Return the heights (H, W) of a string with a gap in the middle, metres.

    Args:
        length_radii: Length of the gap along x, in radii.
        height: Height of the string in the gap, as a share of its height.
        shift_px: Distance by which the string beyond the gap is moved aside, pixels.
    """
    heights = string_heights()
    half = round(length_radii * R_PX / 2)
    heights[:, COLUMN + half :] = np.roll(heights[:, COLUMN + half :], shift_px, axis=0)
    heights[:, COLUMN - half : COLUMN + half] *= height
    return in_windows(heights)


def largest_hole_px(axis: NDArray[np.float64]) -> float:
    """Return the largest distance between two successive axis points (N, 2) along x, pixels."""
    return float(np.diff(np.sort(axis[:, 0])).max())


@pytest.mark.parametrize("length_radii", [2.0, 3.0])
def test_a_low_part_of_a_string_is_bridged(length_radii: float) -> None:
    bands = bands_of(with_gap(length_radii, LOW))
    bridged = bridge_gaps(bands)
    assert largest_hole_px(bands.axis) > 2 * R_PX
    assert largest_hole_px(bridged.axis) < R_PX
    number = len(bridged.axis) - len(bands.axis)
    for values in (bridged.tangent, bridged.curvature, bridged.across_rise, bridged.axis_tops_m, bridged.axis_slopes):
        assert len(values) == len(bridged.axis)
    added = bridged.axis[-number:]
    whole = bands_of(in_windows(string_heights())).axis
    nearest = np.abs(added[:, None, 0] - whole[None, :, 0]).argmin(axis=1)
    # the axes at the ends of the gap are off by up to 1.2 pixels, as those of whole strings
    assert np.abs(added[:, 1] - whole[nearest, 1]).max() < 0.35 * R_PX
    assert bridged.axis_tops_m[-number:] == pytest.approx(bands.compression * 2 * R)


@pytest.mark.parametrize(
    ("length_radii", "height", "shift_px"),
    [
        (4.0, 0.0, 0),  # bare table between two strings
        (4.0, LOW, 16),  # the ends do not face each other
        (MAX_GAP_RADII, LOW, 0),
    ],
)
def test_other_gaps_stay(length_radii: float, height: float, shift_px: int) -> None:
    bands = bands_of(with_gap(length_radii, height, shift_px))
    assert largest_hole_px(bridge_gaps(bands).axis) == largest_hole_px(bands.axis) > 2 * R_PX


def test_bands_without_gaps_stay_as_they_are() -> None:
    bands = bands_of(in_windows(string_heights()))
    assert len(bridge_gaps(bands).axis) == len(bands.axis)
