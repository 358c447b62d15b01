"""Pixel locking of a stereo camera: measure its error between whole disparities, and correct depth images.

Stereo matching interpolates between whole disparities, and the result is biased by an amount that depends on the
fraction of the disparity. A flat table therefore shows stripes, one per disparity, and a string that crosses them seems
to rise and fall. The disparity is proportional to the inverse depth, so the error is periodic in the inverse depth. Its
period, 1 / (f b) for a focal length f in pixels and a baseline b in metres, is measured and need not be known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.depth_correction.depth_warp import MAX_COUNT, CorrectedView, finer_unit_m, sample_table
from recognition.preprocessing.plane_fit import median_sigma
from recognition.preprocessing.table_measurement import ViewPlane
from recognition.preprocessing.target_cloud import DepthView, Scene, intensity_of

SAMPLE_SIZE = 6000
"""Approximate number of pixels per view after even subsampling."""
INLIER_SIGMAS = 3.0
"""Maximum deviation of the inverse depth from a smooth surface, in sigmas."""
N_PASSES = 3
"""Number of passes of the fit of the smooth surface, each with the inliers of the one before."""
MIN_SIGMA_PER_M = 1e-9
"""Minimum standard deviation of the deviations, 1/m. It keeps the pixels of an exact surface."""
PERIODS_PER_M = (0.008, 0.16)
"""Smallest and largest period in inverse depth, 1/m: products of focal length and baseline from 125 to 6 pixel metres.
"""
BIN_PER_M = 0.001
"""Width of the bins of the inverse depth in the search for the period, 1/m."""
N_TRANSFORM = 1 << 16
"""Number of values of the Fourier transform. Zeros are added, so that the period is found between whole frequencies."""
MAX_BINS = N_TRANSFORM // 4
"""Maximum number of bins. A table that spans more is out of the range of a stereo camera."""
MIN_POWER = 60.0
"""Minimum power of the period, in mean powers of independent errors of the same size. The errors of neighbouring pixels
are similar, which gives powers of up to about 20 by chance."""
HARMONICS = (1, 2, 3)
"""Harmonics of the error."""
MIN_ERROR = 0.03
"""Minimum amplitude of the first harmonic, in disparities. A smaller error is less than the noise of most cameras, and
not worth the time of a correction."""
N_PHASES = 72
"""Number of phases at which the size of the error is measured."""
MAX_COUNT_SHARE = 0.25
"""Maximum size of a depth count, in disparities. Where counts are coarser, the fraction of the disparity is unknown."""


@dataclass(frozen=True, eq=False)
class LockingSample:
    """Pixels of one view near the table."""

    inverse_depth: NDArray[np.float64]
    """(N,) measured inverse depths, 1/m."""
    deviation: NDArray[np.float64]
    """(N,) deviations of the inverse depths from a smooth surface, 1/m."""


@dataclass(frozen=True, eq=False)
class PixelLocking:
    """Error of the inverse depth that repeats with each disparity."""

    period_per_m: float
    """Inverse depth of one disparity, 1/m."""
    coefficients: NDArray[np.float64]
    """(2 * len(HARMONICS),) coefficients of sine and cosine of each harmonic, 1/m."""
    depth_m: float
    """Median depth of the table, from which it was measured, metres."""

    @property
    def amplitude_m(self) -> float:
        """Largest error of the depth at the median depth of the table, metres."""
        phase = np.arange(N_PHASES) / N_PHASES
        return float(np.abs(_waves(phase) @ self.coefficients).max()) * self.depth_m**2

    def error(self, inverse_depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the error (N,) of measured inverse depths (N,), 1/m."""
        return np.asarray(_waves(inverse_depth / self.period_per_m) @ self.coefficients, dtype=np.float64)


def sample_locking(view: DepthView, plane: ViewPlane, scene: Scene) -> LockingSample | None:
    """Return pixels of a view near the table, or None if it shows too little of it.

    Args:
        view: Captured depth image with its camera pose.
        plane: Plane of the table in the view.
        scene: Given table height, and sides of the workspace.
    """
    sample = sample_table(view, plane, scene, SAMPLE_SIZE)
    if sample is None:
        return None
    inverse_depth = sample.inverse_depth
    surface = np.column_stack([sample.linear, sample.terms])
    deviation = np.zeros(len(inverse_depth))
    for _ in range(N_PASSES):
        deviation = inverse_depth - surface @ np.linalg.lstsq(surface, inverse_depth, rcond=None)[0]
        is_inlier = np.abs(deviation) <= INLIER_SIGMAS * max(median_sigma(deviation), MIN_SIGMA_PER_M)
        surface = surface[is_inlier]
        inverse_depth = inverse_depth[is_inlier]
        deviation = deviation[is_inlier]
    return LockingSample(inverse_depth, deviation)


def measure_locking(views: Sequence[LockingSample]) -> PixelLocking | None:
    """Return the pixel locking that the table shows, or None if it shows none.

    Args:
        views: Samples of the views that show the table.
    """
    if not views:
        return None
    inverse_depth = np.concatenate([view.inverse_depth for view in views])
    deviation = np.concatenate([view.deviation for view in views])
    # The smooth surface has the true phase. Measured depths gather at certain phases.
    period_per_m = _find_period(inverse_depth - deviation, deviation)
    if period_per_m is None:
        return None
    # The mean error at a measured phase is what a measured depth has to be corrected by.
    waves = _waves(inverse_depth / period_per_m)
    coefficients = np.asarray(np.linalg.lstsq(waves, deviation, rcond=None)[0], dtype=np.float64)
    if float(np.hypot(coefficients[0], coefficients[len(HARMONICS)])) < MIN_ERROR * period_per_m:
        return None
    return PixelLocking(period_per_m, coefficients, depth_m=1 / float(np.median(inverse_depth)))


def correct_locking(view: DepthView, locking: PixelLocking) -> CorrectedView:
    """Return the view without pixel locking.

    Args:
        view: Captured view.
        locking: Pixel locking of its camera.
    """
    counts = np.arange(1, int(view.depth.max(initial=1)) + 1)
    inverse_depth = 1 / (counts * view.depth_unit_m)
    is_fine = inverse_depth**2 * view.depth_unit_m < MAX_COUNT_SHARE * locking.period_per_m
    depth_m = 1 / (inverse_depth - np.where(is_fine, locking.error(inverse_depth), 0.0))
    unit_m = finer_unit_m(view.depth_unit_m, float(depth_m.max()))
    corrected = np.zeros(len(counts) + 1, dtype=np.uint16)
    corrected[1:] = np.clip(np.rint(depth_m / unit_m), 1, MAX_COUNT)
    return CorrectedView(view.index, corrected[view.depth], unit_m, view.K, view.T_base_camera, intensity_of(view))


def _find_period(inverse_depth: NDArray[np.float64], deviation: NDArray[np.float64]) -> float | None:
    """Return the period of the deviations (N,) along the inverse depths (N,), 1/m, or None if there is none."""
    bins = ((inverse_depth - inverse_depth.min()) / BIN_PER_M).astype(np.int64)
    squares = float(deviation @ deviation)
    if bins.max() >= MAX_BINS or squares == 0:
        return None
    power = np.abs(np.fft.rfft(np.bincount(bins, deviation), N_TRANSFORM)) ** 2 / squares
    frequency = np.fft.rfftfreq(N_TRANSFORM, BIN_PER_M)
    shortest, longest = PERIODS_PER_M
    allowed = np.flatnonzero((frequency > 1 / longest) & (frequency < 1 / shortest))
    best = allowed[int(power[allowed].argmax())]
    return float(1 / frequency[best]) if power[best] > MIN_POWER else None


def _waves(phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sine and cosine of each harmonic (N, 2 * len(HARMONICS)) at phases (N,), in periods."""
    angle = 2 * np.pi * np.outer(phase, HARMONICS)
    return np.column_stack([np.sin(angle), np.cos(angle)])
