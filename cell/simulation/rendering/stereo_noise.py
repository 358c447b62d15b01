"""Error model of a stereo camera, applied to an exact depth image.

Modelled: an error that grows with the square of the distance, a bias of the session, waves between whole disparities
(pixel locking), an error that is constant over frames and shared by neighbouring pixels, rounding of disparities,
holes, frayed edges, flying pixels between a string and the table, and the area that the other camera does not see.
Presets with measured errors also have the warp of one device, holes and flicker near edges, and wrong patches as on
weak texture. Strings can lose a share of their pixels. Not modelled: the effect of the matching window on thin objects,
repeating texture, gloss, and interference of projected dots.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

MEDIAN_OF_FIVE = 0.5355
"""Standard deviation of the median of five normal samples, relative to that of one sample."""

MIN_DISPARITY_PX = 0.5
"""Smallest measurable disparity."""

MAX_SHARE = 0.45
"""Largest share of bad pixels of one kind in a scaled model."""

WARP_ORDER = 3
"""Number of half periods of a device's warp across the image."""

RIM_M = 0.0015
"""Distance of a depth from its neighbours' plane beyond which a pixel is at an edge."""


@dataclass(frozen=True)
class StereoNoise:
    """Parameters of the error model, in pixels of disparity at the resolution of the matching."""

    matching_focal_px: float
    """Focal length of the matched images. That of the depth image may be smaller."""
    baseline_m: float
    """Distance between the two cameras."""
    bias_px: float = 0.1
    """Standard deviation of the bias, which is constant during a session."""
    wave_px: float = 0.1
    """Amplitude of the error that repeats with each whole disparity."""
    fixed_px: float = 0.12
    """Standard deviation of the error that is constant over frames and shared by about 3 neighbouring pixels."""
    frame_px: float = 0.09
    """Standard deviation of the error of each frame."""
    step_px: float = 1 / 32
    """Step of the disparities."""
    hole_share: float = 0.03
    """Share of pixels in holes, in addition to occluded pixels."""
    jitter_px: float = 1.0
    """Standard deviation of the displacement of edges in the image, at most two pixels."""
    flying_share: float = 0.12
    """Share of edge pixels with a depth between foreground and background."""
    warp_px: float = 0.0
    """Root mean square of the device's warp, a slow disparity error over the image that is constant for one device."""
    edge_ring_px: int = 8
    """Width of the ring at an edge in which pixels get lost or flicker."""
    edge_hole_share: float = 0.0
    """Share of the pixels of that ring that are never measured."""
    flicker_share: float = 0.0
    """Share of the pixels of that ring that are measured in every second exposure on average."""
    patches: float = 0.0
    """Mean number of patches per image in which weak texture gives a smooth but wrong disparity."""
    patch_px: float = 10.0
    """Largest disparity error of a patch."""
    patch_radius_px: float = 12.0
    """Radius of a patch in the depth image."""
    string_dropout_share: float = 0.0
    """Share of the pixels on strings that are not measured, as on dark or glossy strings."""
    string_dropout_blobs: bool = False
    """Whether these pixels form blobs of about three pixels. Otherwise, they are independent."""

    def scaled(self, factor: float) -> "StereoNoise":
        """Return the model with the errors of the disparity, the shares of bad pixels and the patches times `factor`.

        A share is at most `MAX_SHARE`. The size and the height of a patch stay.
        """
        errors = ("wave_px", "fixed_px", "frame_px", "warp_px", "patches")
        shares = ("hole_share", "edge_hole_share", "flicker_share", "flying_share")
        return replace(
            self,
            **{name: factor * getattr(self, name) for name in errors},
            **{name: min(factor * getattr(self, name), MAX_SHARE) for name in shares},
        )

    @property
    def focal_baseline_px_m(self) -> float:
        """Product of disparity and depth. One pixel of disparity is `depth^2 / this` metres of depth."""
        return self.matching_focal_px * self.baseline_m


@dataclass(frozen=True, eq=False)
class StillImage:
    """What stays constant over exposures while the camera stands still."""

    disparity: NDArray[np.float32]
    """Disparity (H, W), pixels, before the error of each frame and the rounding."""
    good: NDArray[np.bool_]
    """Pixels (H, W) that can be measured."""
    flickering: NDArray[np.bool_] | None = None
    """Pixels (H, W) that are measured in every second exposure on average, or None."""


def device_warp(noise: StereoNoise, shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float32] | None:
    """Return the disparity error (H, W) of one device, pixels, or None for a preset without warp.

    The error is a sum of cosines with up to `WARP_ORDER` half periods across the image, scaled to `noise.warp_px` root
    mean square, with zero mean. Real devices differ by such an error of some tenths of a pixel.
    """
    if noise.warp_px == 0:
        return None
    v, u = (np.cos(np.pi * np.outer(np.arange(WARP_ORDER + 1), (np.arange(n) + 0.5) / n)) for n in shape)
    weights = rng.standard_normal((WARP_ORDER + 1, WARP_ORDER + 1))
    weights[0, 0] = 0.0  # the mean is `bias_px`
    warp = np.einsum("ij,ih,jw->hw", weights, v, u)
    return (noise.warp_px * warp / np.sqrt(np.mean(warp**2))).astype(np.float32)


def still_image(
    depth: NDArray[np.float32],
    focal_px: float,
    noise: StereoNoise,
    bias_px: float,
    rng: np.random.Generator,
    warp: NDArray[np.float32] | None = None,
) -> StillImage:
    """Return what all exposures from one pose share.

    The reference camera is the left one. The area that the right one does not see is to the left of foreground objects.

    Args:
        depth: Exact depth image (H, W), metres, infinite without a surface.
        focal_px: Focal length of the depth image.
        noise: Error model.
        bias_px: Bias of the session.
        rng: Generator of the errors of this pose.
        warp: Disparity error of the device (H, W), or None.
    """
    fb = np.float32(noise.focal_baseline_px_m)
    seen = np.isfinite(depth) & (depth > 0)
    disparity = np.where(seen, fb / np.where(seen, depth, 1), 0).astype(np.float32)
    hidden = _occluded(disparity * np.float32(focal_px / noise.matching_focal_px))
    rims = _rims(disparity, noise)
    disparity = _fray(disparity, rims, noise, rng)
    blobs = _correlated(rng, depth.shape)
    wave = np.sin(np.float32(2 * np.pi) * disparity)
    disparity += np.float32(noise.wave_px) * wave + np.float32(bias_px)
    disparity += np.float32(noise.fixed_px) * _correlated(rng, depth.shape)
    good = seen & ~hidden & (blobs > _quantile(noise.hole_share))
    # these errors draw nothing where a preset has none of them
    if warp is not None:
        disparity += warp
    if noise.patches > 0:
        disparity += _patches(disparity.shape, noise, rng)
    flickering = None
    if noise.edge_hole_share > 0 or noise.flicker_share > 0:
        ring, quality = _ring(rims, noise.edge_ring_px), _correlated(rng, depth.shape)
        lost = quality <= _quantile(noise.edge_hole_share)
        good &= ~(ring & lost)
        flickering = ring & ~lost & (quality <= _quantile(noise.edge_hole_share + noise.flicker_share))
    return StillImage(disparity, good, flickering)


def drop_pixels(
    still: StillImage, is_string: NDArray[np.bool_], noise: StereoNoise, rng: np.random.Generator
) -> StillImage:
    """Return the image without a share of the pixels on strings. A preset without dropouts draws nothing.

    Args:
        still: What all exposures from the pose share.
        is_string: Pixels (H, W) on a string.
        noise: Error model.
        rng: Generator of the errors of this pose.
    """
    if noise.string_dropout_share == 0:
        return still
    draw = _correlated(rng, is_string.shape) if noise.string_dropout_blobs else rng.standard_normal(is_string.shape)
    return replace(still, good=still.good & ~(is_string & (draw < _quantile(noise.string_dropout_share))))


def expose(
    still: StillImage, noise: StereoNoise, rng: np.random.Generator, frame_share: float = 1.0
) -> NDArray[np.float32]:
    """Return the depth (H, W) that one exposure measures, metres; 0 = not measured.

    Args:
        still: What all exposures from the pose share.
        noise: Error model.
        rng: Generator of the noise.
        frame_share: Factor on the error of each frame. `MEDIAN_OF_FIVE` gives the median of five exposures.
    """
    fb = np.float32(noise.focal_baseline_px_m)
    spread = np.float32(noise.frame_px * frame_share)
    disparity = still.disparity + spread * rng.standard_normal(still.disparity.shape, dtype=np.float32)
    disparity = np.rint(disparity / np.float32(noise.step_px)) * np.float32(noise.step_px)
    good = still.good & (disparity > MIN_DISPARITY_PX)
    if still.flickering is not None:
        good &= ~still.flickering | (rng.random(good.shape, dtype=np.float32) < 0.5)
    return np.where(good, fb / np.where(good, disparity, 1), 0).astype(np.float32)


def _occluded(disparity: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the pixels whose point in the other image is covered by something nearer.

    The disparity is in pixels of this image.
    """
    partner = np.arange(disparity.shape[1], dtype=np.float32) - disparity
    nearest = np.minimum.accumulate(partner[:, ::-1], axis=1)[:, ::-1]
    # half a pixel of tolerance, so that a slanted surface does not hide itself
    return partner > nearest + np.float32(0.5)


def _ring(rims: NDArray[np.bool_], width_px: int) -> NDArray[np.bool_]:
    """Return the pixels (H, W) within `width_px` of an edge."""
    from scipy.ndimage import maximum_filter

    return np.asarray(maximum_filter(rims, size=2 * width_px + 1), dtype=np.bool_)


def _patches(shape: tuple[int, ...], noise: StereoNoise, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the disparity error (H, W) of smooth bumps at random positions, as on weak texture."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    error = np.zeros(shape, dtype=np.float32)
    for _ in range(rng.poisson(noise.patches)):
        v0, u0 = rng.random(2) * shape
        radius, height_px = noise.patch_radius_px * rng.uniform(0.5, 1.5), rng.uniform(-noise.patch_px, noise.patch_px)
        error += np.float32(height_px) * np.exp(-((v - v0) ** 2 + (u - u0) ** 2) / np.float32(radius) ** 2)
    return error


def _fray(
    disparity: NDArray[np.float32], rims: NDArray[np.bool_], noise: StereoNoise, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Displace edges by a pixel or two, and let some of their pixels fly between foreground and background."""
    height, width = disparity.shape
    v, u = np.nonzero(rims)
    shift_v, shift_u = (
        np.clip(np.rint(noise.jitter_px * _correlated(rng, disparity.shape)[v, u]), -2, 2).astype(np.int64)
        for _ in range(2)
    )
    frayed = disparity.copy()
    frayed[v, u] = disparity[np.clip(v + shift_v, 0, height - 1), np.clip(u + shift_u, 0, width - 1)]
    flies = rng.random(len(v)) < noise.flying_share
    share = rng.random(len(v))[flies]
    v, u = v[flies], u[flies]
    around = np.stack(
        [
            disparity[np.clip(v + dv, 0, height - 1), np.clip(u + du, 0, width - 1)]
            for dv in (-2, -1, 0, 1, 2)
            for du in (-2, -1, 0, 1, 2)
        ]
    )
    low, high = around.min(axis=0), around.max(axis=0)
    frayed[v, u] = low + share * (high - low)
    return frayed


def _rims(disparity: NDArray[np.float32], noise: StereoNoise) -> NDArray[np.bool_]:
    """Return the pixels next to a depth step. The disparity of a plane has no second difference."""
    # a depth step is a disparity step times z^2 / (f b) = f b / disparity^2
    step = np.float32(RIM_M / noise.focal_baseline_px_m) * disparity**2
    rims = np.zeros(disparity.shape, dtype=bool)
    across = np.abs(disparity[:, 2:] - 2 * disparity[:, 1:-1] + disparity[:, :-2])
    rims[:, 1:-1] = across > step[:, 1:-1]
    rims[1:-1] |= np.abs(disparity[2:] - 2 * disparity[1:-1] + disparity[:-2]) > step[1:-1]
    return rims


def _correlated(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return normal noise of unit variance that is correlated over about three pixels (0.78 between neighbours)."""
    from scipy.ndimage import correlate1d

    kernel = np.exp(-0.5 * np.arange(-3, 4) ** 2).astype(np.float32)
    kernel /= np.sqrt((kernel**2).sum())
    white = rng.standard_normal(shape, dtype=np.float32)
    smooth = correlate1d(correlate1d(white, kernel, axis=0, mode="wrap"), kernel, axis=1, mode="wrap")
    return np.asarray(smooth, dtype=np.float32)


def _quantile(share: float) -> float:
    """Return the quantile of the normal distribution."""
    from statistics import NormalDist

    return NormalDist().inv_cdf(share) if share > 0 else -np.inf
