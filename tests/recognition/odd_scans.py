"""Random scans: objects on the table, faults of the camera, and wrong poses and parameters."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from recognition.model.model import METHODS
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest

Image = NDArray[np.float64]
DOWN = np.diag([1.0, -1.0, -1.0])
"""A camera that looks straight down."""


@dataclass(frozen=True)
class Case:
    """What one example gives to `recognise`."""

    views: tuple[View, ...]
    request: RecognitionRequest
    scene: Scene


# --- objects on the table: heights (H, W), metres, at the positions x, y (H, W), metres, of the pixels ---


def tubes(distance: Image, r: float, lift: Image | float = 0.0) -> Image:
    """Strings of radius r whose axis is `distance` away in plan, on the table or lifted; seen from above."""
    top = r + lift + np.sqrt(np.maximum(r**2 - distance**2, 0.0))
    return np.asarray(np.where(distance < r, top, 0.0), dtype=np.float64)


def stripes(a: Image, pitch: float) -> Image:
    return np.asarray(np.abs((a / pitch + 0.5) % 1.0 - 0.5) * pitch, dtype=np.float64)


def flat(x: Image, _y: Image, _r: float, _rng: np.random.Generator) -> Image:
    return np.zeros_like(x)


def noise(x: Image, _y: Image, r: float, rng: np.random.Generator) -> Image:
    return rng.uniform(0, rng.choice([0.5, 3, 30]) * r, x.shape)


def blocks(x: Image, _y: Image, r: float, rng: np.random.Generator) -> Image:
    size = int(rng.integers(2, 9))
    small = rng.uniform(0, rng.choice([4, 20]) * r, (x.shape[0] // size + 1, x.shape[1] // size + 1))
    enlarged = np.repeat(np.repeat(small, size, axis=0), size, axis=1)
    return enlarged[: x.shape[0], : x.shape[1]]


def steps(x: Image, y: Image, r: float, rng: np.random.Generator) -> Image:
    step = np.floor((x * rng.normal() + y * rng.normal()) / (float(rng.choice([2, 8])) * r))
    return r * (step % float(rng.choice([3, 40])))


def ramp(x: Image, y: Image, r: float, rng: np.random.Generator) -> Image:
    return x * rng.normal() * 0.3 + y * rng.normal() * 0.3 + rng.choice([0, 2]) * r


def waves(x: Image, y: Image, r: float, rng: np.random.Generator) -> Image:
    pitch = rng.choice([3, 6, 15]) * r
    return 2 * r * (np.sin(x * 6.28 / pitch) * np.sin(y * 6.28 / pitch * rng.choice([0, 1])) + rng.choice([0, 1]))


def side_by_side(x: Image, y: Image, r: float, rng: np.random.Generator) -> Image:
    angle = rng.uniform(0, np.pi)
    return tubes(stripes(x * np.cos(angle) + y * np.sin(angle), rng.choice([2, 2.5, 4, 8]) * r), r)


def net(x: Image, y: Image, r: float, rng: np.random.Generator) -> Image:
    pitch, angle = rng.choice([5, 8, 14]) * r, rng.uniform(0.2, np.pi - 0.2)
    below = tubes(stripes(x, pitch), r)
    return np.maximum(
        below, tubes(stripes(x * np.cos(angle) + y * np.sin(angle), pitch), r, rng.choice([0.3, 1, 2]) * r)
    )


def rings(x: Image, y: Image, r: float, rng: np.random.Generator) -> Image:
    return tubes(stripes(np.hypot(x, y), rng.choice([2, 3, 6]) * r), r)


def spiral(x: Image, y: Image, r: float, rng: np.random.Generator) -> Image:
    pitch = rng.choice([2, 3, 6]) * r
    return tubes(stripes(np.hypot(x, y) - np.arctan2(y, x) / (2 * np.pi) * pitch, pitch), r)


def tangle(x: Image, y: Image, r: float, rng: np.random.Generator) -> Image:
    """Straight strings at random, each higher than those below, some floating."""
    height = np.zeros_like(x)
    for layer in range(int(rng.integers(1, 9))):
        angle = rng.uniform(0, np.pi)
        distance = np.abs(x * np.cos(angle) + y * np.sin(angle) - rng.normal() * 5 * r)
        height = np.maximum(height, tubes(distance, r, layer * rng.choice([0, 1, 2]) * r))
    return height


def domes(x: Image, y: Image, r: float, rng: np.random.Generator) -> Image:
    """Beads: as high as a string, and no line."""
    pitch = rng.choice([2, 3, 6]) * r
    return tubes(np.hypot(stripes(x, pitch), stripes(y, pitch)), r)


def spikes(x: Image, _y: Image, r: float, rng: np.random.Generator) -> Image:
    return np.where(rng.random(x.shape) < rng.choice([0.001, 0.05, 0.3]), rng.uniform(0, 20 * r, x.shape), 0.0)


PATTERNS: tuple[Callable[[Image, Image, float, np.random.Generator], Image], ...] = (
    flat, noise, blocks, steps, ramp, waves, side_by_side, net, rings, spiral, tangle, domes, spikes,
)  # fmt: skip
STRINGS = (side_by_side, net, rings, spiral, tangle)


# --- faults of a camera: changes of a depth image (H, W), uint16 ---


def zero_rows(depth: NDArray[np.uint16], rng: np.random.Generator) -> NDArray[np.uint16]:
    return np.where((rng.random(depth.shape[0]) < 0.5)[:, None], 0, depth).astype(np.uint16)


def mostly_zero(depth: NDArray[np.uint16], rng: np.random.Generator) -> NDArray[np.uint16]:
    return np.where(rng.random(depth.shape) < 0.9, 0, depth).astype(np.uint16)


def saturated(depth: NDArray[np.uint16], rng: np.random.Generator) -> NDArray[np.uint16]:
    return np.where(rng.random(depth.shape) < rng.choice([0.1, 1.0]), 65535, depth).astype(np.uint16)


def scaled(depth: NDArray[np.uint16], rng: np.random.Generator) -> NDArray[np.uint16]:
    return np.clip(depth * rng.choice([0.5, 0.9, 0.99, 1.01, 1.1, 10]), 0, 65535).astype(np.uint16)


def turned(depth: NDArray[np.uint16], _rng: np.random.Generator) -> NDArray[np.uint16]:
    return depth[::-1, ::-1].copy()


def shifted(depth: NDArray[np.uint16], rng: np.random.Generator) -> NDArray[np.uint16]:
    return np.roll(depth, rng.integers(-depth.shape[1] // 4, depth.shape[1] // 4, 2), (0, 1))


def stuck(depth: NDArray[np.uint16], _rng: np.random.Generator) -> NDArray[np.uint16]:
    return np.full_like(depth, max(int(np.median(depth)), 1))


def dark(depth: NDArray[np.uint16], _rng: np.random.Generator) -> NDArray[np.uint16]:
    return np.zeros_like(depth)


def grainy(depth: NDArray[np.uint16], rng: np.random.Generator) -> NDArray[np.uint16]:
    noisy = depth + rng.normal(0, 0.002 * float(np.median(depth)) + 1, depth.shape)
    return np.where(depth > 0, np.clip(noisy, 0, 65535), 0).astype(np.uint16)


FAULTS: tuple[Callable[[NDArray[np.uint16], np.random.Generator], NDArray[np.uint16]], ...] = (
    zero_rows, mostly_zero, saturated, scaled, turned, shifted, stuck, dark, grainy,
)  # fmt: skip


# --- wrong camera poses ---


def same(T: Image, _rng: np.random.Generator) -> Image:
    return T


def a_little_off(T: Image, rng: np.random.Generator) -> Image:
    return T @ from_rotation_vector(rng.normal(0, 0.0005, 3), rng.normal(0, 0.001, 3))


def far_off(T: Image, rng: np.random.Generator) -> Image:
    return T @ from_rotation_vector(rng.normal(0, 0.02, 3), rng.normal(0, 0.1, 3))


def anywhere(_T: Image, rng: np.random.Generator) -> Image:
    return from_rotation_vector(rng.normal(0, 0.5, 3), Rotation.from_quat(rng.normal(size=4)).as_rotvec())


def under_the_table(T: Image, _rng: np.random.Generator) -> Image:
    below = T.copy()
    below[1:3] *= -1
    return below


def at_50_m(T: Image, rng: np.random.Generator) -> Image:
    away = T.copy()
    away[:3, 3] += rng.choice([-50, 0, 50], 3)
    return away


POSES: tuple[Callable[[Image, np.random.Generator], Image], ...] = (
    same, a_little_off, far_off, anywhere, under_the_table, at_50_m,
)  # fmt: skip


@st.composite
def cases(
    draw: st.DrawFn,
    sizes: tuple[tuple[int, int], ...] = ((40, 30), (80, 50), (160, 100)),
    most_views: int = 40,
    kind: str | None = None,
) -> Case:
    """Scans of a pattern seen from above, all views alike or each with its own fault."""
    kind = kind or draw(st.sampled_from(("strings", "any", "chaos")))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    width, height = draw(st.sampled_from(sizes))
    r = draw(st.sampled_from((0.0042, 0.0005, 0.001, 0.002, 0.01, 0.02)))
    strings = kind == "strings"
    count = draw(st.sampled_from((3, 2, 8) if strings else (3, 2, 5, 8, 0, 1, most_views)))
    # The distance at which a string is `across` pixels wide, for any focal length.
    across = draw(st.sampled_from((8, 5, 12, 25) if strings else (8, 2, 60)))
    focal = width * draw(st.sampled_from((0.7, 1.2) if strings else (0.7, 0.05, 3.0, 100.0)))
    z = 2 * r * focal / across
    unit = draw(st.sampled_from((1e-4, 1e-5, 1e-3) if strings else (1e-4, 1e-5, 1e-3, 1e-2)))
    unit = max(unit, z / 60000) if strings else min(max(unit, z / 6e5), 0.01)
    table_z = draw(st.sampled_from((0.0, 0.3, -2.0)))
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal * (1 if strings else 1.1), (height - 1) / 2], [0, 0, 1.0]])
    v, u = np.indices((height, width), dtype=np.float64)
    x, y = (u - K[0, 2]) * z / K[0, 0], -(v - K[1, 2]) * z / K[1, 1]
    pattern = draw(st.sampled_from(STRINGS if strings else PATTERNS))
    heights = pattern(x, y, r, rng)
    fault_share = 0.0 if strings else draw(st.sampled_from((0.0, 0.3, 1.0)))
    poses = POSES[:2] if strings else POSES if kind == "chaos" else POSES[:3]
    views = []
    for k in range(count):
        T = np.eye(4)
        T[:3, :3], T[2, 3] = DOWN, table_z + z
        depth = np.clip(np.rint((z - heights) / unit), 0, 65535).astype(np.uint16)
        if k % 2:
            # The same scene with the camera turned by half a turn.
            depth, T[:2] = depth[::-1, ::-1], -T[:2]
        if rng.random() < fault_share:
            depth = FAULTS[rng.integers(len(FAULTS))](depth, rng)
        elif rng.random() < 0.7:
            depth = grainy(depth, rng)
        T = poses[rng.integers(len(poses))](T, rng)
        views.append(View(k, np.ascontiguousarray(depth), unit, K, T, np.eye(4)))
    if count > 1 and draw(st.integers(0, 19)) == 19:
        views[-1] = replace(views[-1], index=0)
    given_r = draw(st.sampled_from((r, None, r, 0.7 * r, 1.5 * r, 0.0042)))
    half = draw(st.sampled_from((None, None, 5 * r, 30 * r)))
    workspace = None if half is None else ((-half, half), (-half, half), (table_z, table_z + 8 * r))
    radius_m = None if given_r is None else float(np.clip(given_r, 0.0005, 0.02))
    request = RecognitionRequest(draw(st.sampled_from(METHODS)), radius_m)
    return Case(tuple(views), request, Scene(table_z, workspace))
