"""What a stereo camera makes of an exact depth image.

Faithful in: error growing with the square of the distance, a bias of the session, waves between whole
disparities (pixel locking), an error that averaging frames does not remove and that neighbouring pixels share,
rounding of disparities, holes, frayed rims, pixels flying between a string and the table, and the band that the
other camera does not see. Presets with measured errors also have the slow warp of one device, holes and flicker at
rims, and smooth wrong patches as on weak texture. Not modelled: the matching window's rounding of thin things,
repeating texture, shine, and interference of projected dots.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MEDIAN_OF_FIVE = 0.5355
"""Spread of the median of five normal samples, as a share of one sample's."""

MIN_DISPARITY_PX = 0.5
"""Smaller disparities are no measurement."""

WARP_ORDER = 3
"""Number of half periods of a device's warp across the image."""

RIM_M = 0.0015
"""A depth that departs by this much from its neighbours' plane is at a rim."""


@dataclass(frozen=True)
class StereoNoise:
    """The error model of a stereo camera, in pixels of disparity at the resolution that it matches in."""

    matching_focal_px: float
    """Focal length of the images that are matched; those of the depth image may be smaller."""
    baseline_m: float
    """Distance of the two cameras."""
    bias_px: float = 0.1
    """Spread of the session's bias (the bias itself is the session's, not the frame's)."""
    wave_px: float = 0.1
    """Amplitude of the error that repeats with each whole disparity."""
    fixed_px: float = 0.12
    """Spread of the error that stays from frame to frame, shared by about 3 neighbouring pixels."""
    frame_px: float = 0.09
    """Spread of the error of each frame."""
    step_px: float = 1 / 32
    """Rounding of disparities."""
    hole_share: float = 0.03
    """Share of pixels in holes, beside the occluded ones."""
    jitter_px: float = 1.0
    """Spread of the shift of rims in the image; more than two pixels never."""
    flying_share: float = 0.12
    """Share of rim pixels that lie between what is before and behind the rim."""
    warp_px: float = 0.0
    """Root mean square of the device's warp: a slow disparity error over the image that one device always has."""
    edge_ring_px: int = 8
    """Width of the ring at a rim in which pixels get lost or flicker."""
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

    @property
    def focal_baseline_px_m(self) -> float:
        """Disparity times depth; one pixel of disparity is `depth^2 / this` metres of depth."""
        return self.matching_focal_px * self.baseline_m


@dataclass(frozen=True, eq=False)
class StillImage:
    """What does not change from exposure to exposure while the camera stands still."""

    disparity: NDArray[np.float32]
    """(H, W), pixels, before the error of each frame and the rounding."""
    good: NDArray[np.bool_]
    """(H, W): pixels that can be measured."""
    flickering: NDArray[np.bool_] | None = None
    """(H, W): pixels that are measured in every second exposure on average; None without such pixels."""


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
    """What all exposures from one pose share, of an exact depth image (H, W), metres, infinite where nothing is.

    `focal_px` is the depth image's focal length, `bias_px` the session's disparity bias. The reference camera is the
    left one: what its partner can't see is the band left of what stands before it.
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


def expose(
    still: StillImage, noise: StereoNoise, rng: np.random.Generator, frame_share: float = 1.0
) -> NDArray[np.float32]:
    """The depth (H, W), metres, that one exposure measures; 0 where it measures nothing.

    The error of each frame is taken times `frame_share`: `MEDIAN_OF_FIVE` makes it the median of five exposures.
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
    """Pixels whose place in the other image is taken by something nearer; disparity in pixels of this image."""
    partner = np.arange(disparity.shape[1], dtype=np.float32) - disparity
    nearest = np.minimum.accumulate(partner[:, ::-1], axis=1)[:, ::-1]
    # Half a pixel of slack: a slanted surface is not hidden by itself.
    return partner > nearest + np.float32(0.5)


def _ring(rims: NDArray[np.bool_], width_px: int) -> NDArray[np.bool_]:
    """Return the pixels (H, W) within `width_px` of a rim."""
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
    """Rims moved by a pixel or two, and some of their pixels flying between front and back."""
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
    """Pixels next to a jump. The disparity of a plane has no second difference."""
    # A step of depth is a step of disparity times z^2 / (f b) = f b / disparity^2.
    step = np.float32(RIM_M / noise.focal_baseline_px_m) * disparity**2
    rims = np.zeros(disparity.shape, dtype=bool)
    across = np.abs(disparity[:, 2:] - 2 * disparity[:, 1:-1] + disparity[:, :-2])
    rims[:, 1:-1] = across > step[:, 1:-1]
    rims[1:-1] |= np.abs(disparity[2:] - 2 * disparity[1:-1] + disparity[:-2]) > step[1:-1]
    return rims


def _correlated(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Normal noise of unit spread that is alike over about three pixels (0.78 between neighbours)."""
    from scipy.ndimage import correlate1d

    kernel = np.exp(-0.5 * np.arange(-3, 4) ** 2).astype(np.float32)
    kernel /= np.sqrt((kernel**2).sum())
    white = rng.standard_normal(shape, dtype=np.float32)
    smooth = correlate1d(correlate1d(white, kernel, axis=0, mode="wrap"), kernel, axis=1, mode="wrap")
    return np.asarray(smooth, dtype=np.float32)


def _quantile(share: float) -> float:
    """Where the normal distribution has that share below."""
    from statistics import NormalDist

    return NormalDist().inv_cdf(share) if share > 0 else -np.inf
