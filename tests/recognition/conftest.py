"""Strings and parameters that the tests of several stages share."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, points_at
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.registration import Registration

Points = NDArray[np.float64]


@pytest.fixture(scope="session")
def table_1() -> ChainParameters:
    """The paper's parameters: r = 4.2 mm."""
    return ChainParameters.for_radius(0.0042)


@pytest.fixture(scope="session")
def round_figures() -> ChainParameters:
    """R = 10 mm: r_n = 10, r_f = 20, r_cn = 30, r_cf = 35 mm, so that hand-made points are easy to read."""
    return ChainParameters.for_radius(0.01)


@pytest.fixture(scope="session")
def tube() -> Callable[..., tuple[Points, Points]]:
    """`tube(curve, r, low, high, around)`: points and exact outward normals of the tube of radius r about a curve.

    Both (N * around, 3). Only the part between the angles `low` and `high` is made, 0 being to the curve's left
    and pi/2 on top, as a camera sees one side only.
    """

    def make(
        curve: Points, r: float, low: float = 0.0, high: float = 2 * np.pi, around: int = 24
    ) -> tuple[Points, Points]:
        tangent = np.gradient(curve, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        left = np.cross((0.0, 0.0, 1.0), tangent)
        left /= np.linalg.norm(left, axis=1, keepdims=True)
        up = np.cross(tangent, left)
        whole = np.isclose(high - low, 2 * np.pi)
        angles = np.linspace(low, high, around, endpoint=not whole)[:, None]
        normals = np.cos(angles) * left[:, None] + np.sin(angles) * up[:, None]
        return (curve[:, None] + r * normals).reshape(-1, 3), normals.reshape(-1, 3)

    return make


@pytest.fixture(scope="session")
def seen(tube: Callable[..., tuple[Points, Points]]) -> Callable[..., tuple[Points, Points]]:
    """`seen(curves, r, radii, noise, seed)`: points and normals of several strings as a camera above sees them.

    Only what lies above the height threshold of a string on the table is made, and what another string, or another
    part of the same one, covers is left out. `noise` is one sigma along the normals, metres.
    """

    def make(
        curves: Sequence[Points],
        r: float = 0.0042,
        radii: Sequence[float] | None = None,
        noise: float = 0.0,
        seed: int = 0,
    ) -> tuple[Points, Points]:
        radii = radii or [r] * len(curves)
        # 14 points around: 1 mm apart at r = 4.2 mm, like the merged cloud. Lower than 0.2 rad the table begins.
        tubes = [tube(curve, radius, 0.2, np.pi - 0.2, 14) for curve, radius in zip(curves, radii, strict=True)]
        points, normals = (np.vstack(parts) for parts in zip(*tubes, strict=True))
        owner = np.repeat(np.arange(len(curves)), [len(part) for part, _ in tubes])
        s = np.concatenate([np.repeat(arc_length(curve), 14) for curve in curves])
        hidden = np.zeros(len(points), dtype=bool)
        for number, (curve, radius) in enumerate(zip(curves, radii, strict=True)):
            beside = KDTree(points[:, :2]).sparse_distance_matrix(
                KDTree(curve[:, :2]), 0.999 * radius, output_type="ndarray"
            )
            point, place = beside["i"], beside["j"]
            another = (owner[point] != number) | (np.abs(s[point] - arc_length(curve)[place]) > 4 * radius)
            top = curve[place, 2] + np.sqrt(radius**2 - beside["v"] ** 2)
            hidden[point[another & (top > points[point, 2] + 1e-6)]] = True
        scatter = np.random.default_rng(seed).normal(0.0, noise, (int((~hidden).sum()), 1)) if noise else 0.0
        return points[~hidden] + scatter * normals[~hidden], normals[~hidden]

    return make


@pytest.fixture(scope="session")
def straight() -> Callable[..., Points]:
    """`straight(a, b, step)`: points from a to b, metres, `step` apart."""

    def make(a: Sequence[float], b: Sequence[float], step: float = 0.001) -> Points:
        start, end = np.array(a, dtype=np.float64), np.array(b, dtype=np.float64)
        return np.linspace(start, end, round(float(np.linalg.norm(end - start)) / step) + 1)

    return make


@pytest.fixture(scope="session")
def arc() -> Callable[..., Points]:
    """`arc(radius, start_deg, end_deg, z, centre)`: points of an arc in the plane z, 1 mm apart."""

    def make(
        radius: float, start_deg: float, end_deg: float, z: float = 0.0042, centre: tuple[float, float] = (0, 0)
    ) -> Points:
        count = round(np.radians(abs(end_deg - start_deg)) * radius / 0.001) + 1
        angle = np.radians(np.linspace(start_deg, end_deg, count))
        x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
        return np.column_stack([x, y, np.full(count, z)])

    return make


@pytest.fixture(scope="session")
def heap(straight: Callable[..., Points]) -> Callable[..., list[Points]]:
    """`heap(degrees, gap, half)`: straight strands of r = 4.2 mm through the origin in these directions.

    Each passes over those before it with its centre line `gap` higher than the one below, and comes down to the
    table within 40 mm, as a string does; `half` of each lies on either side of the origin.
    """

    def make(degrees: Sequence[float], gap: float, half: float = 0.06) -> list[Points]:
        strands = []
        for layer, angle in enumerate(np.radians(degrees)):
            way = half * np.array([np.cos(angle), np.sin(angle), 0.0])
            strand = straight(-way, way)
            from_middle = np.minimum(np.linalg.norm(strand, axis=1) / 0.04, 1.0)
            strand[:, 2] = 0.0042 + layer * gap * (0.5 + 0.5 * np.cos(np.pi * from_middle))
            strands.append(strand)
        return strands

    return make


@pytest.fixture(scope="session")
def off_line() -> Callable[..., NDArray[np.float64]]:
    """`off_line(points, curves)`: (N,) distance of each point from the nearest of the polylines `curves`."""

    def measure(points: Points, curves: Sequence[Points]) -> NDArray[np.float64]:
        fine = []
        for curve in curves:
            # 20 places a link: what lies beside a link of 1 mm at 0.1 mm is measured within 3 micrometres.
            fine.append(points_at(curve, np.linspace(0.0, arc_length(curve)[-1], 20 * len(curve))))
        return np.asarray(KDTree(np.vstack(fine)).query(points)[0])

    return measure


@pytest.fixture(scope="session")
def registered() -> Callable[..., Registration]:
    """`registered(clouds, sigma_m)`: the (points, normals) of several views as registered.

    Each view's position is known to `sigma_m` in every direction, independently of the others', and its rotation
    exactly.
    """

    def make(clouds: Sequence[tuple[Points, Points]], sigma_m: float = 0.0001) -> Registration:
        points, normals = (np.vstack(parts) for parts in zip(*clouds, strict=True))
        views = tuple(NormalCloud(view, *cloud, np.eye(4)) for view, cloud in enumerate(clouds))
        covariance = np.diag(np.tile([0.0] * 3 + [sigma_m**2] * 3, len(clouds)))
        return Registration(points, normals, views, (), np.zeros(3), covariance)

    return make
