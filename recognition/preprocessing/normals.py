"""Normal vector estimation (section II.D)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from recognition.errors import TooCrowdedError
from recognition.geometry.voxel_grid import voxel_means
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import DepthView, TargetCloud

RADIUS_SHARE = 0.55
"""Neighbourhood of the PCA as a share of r. The paper gives none. Measured on simulated scans: the centre line of
eqs. (1) and (2) is off by 0.37 mm with 0.4 to 0.5 r, by 0.43 with 0.6 r and by 0.57 with 0.9 r, as the string's own
curvature flattens the normals; with less, noise rules the single centres of eq. (1)."""
RADIUS_GROWTH = (1.0, 1.5, 2.25)
"""Where pixels are sparse for the string's radius, the neighbourhood is made larger by these factors, ..."""
FEW_NEIGHBOURS = 6
"""... until most points have as many neighbours."""
OUTLIER_SHARE = 0.5
"""A point with less than this share of the usual number of neighbours is an outlier: it flies, is a
speck, or fringes a rim, where a plane cannot be told."""
MAX_POINTS = 100_000
"""Evenly spread points that one view may have; a metre of string has about 8,000."""
VOXEL_SHARE = 1 / 4
"""Points are averaged in voxels of this share of r: pixels that fall closer together repeat one another's error."""


@dataclass(frozen=True, eq=False)
class NormalCloud:
    """The paper's "point cloud with NV"."""

    view: int
    """Index of the view it comes from."""
    points: NDArray[np.float64]
    """(N, 3), base frame."""
    normals: NDArray[np.float64]
    """(N, 3), unit length, on the side of the camera."""
    T_correction: NDArray[np.float64]
    """(4, 4), base to base: how far the view has been moved from its hand-eye pose."""
    T_base_camera: NDArray[np.float64] | None = None
    """(4, 4) where the camera was, so moved; None where it is not known."""
    image: DepthView | None = None
    """The depth image that it comes from; None where it is not known."""

    @cached_property
    def tree(self) -> KDTree:
        """Of the points; built when first asked for."""
        return KDTree(self.points)


def estimate_normals(target: TargetCloud, parameters: ChainParameters) -> NormalCloud:
    """The points of `target`, evenly spread and without outliers, with normals turned to the camera.

    Normals are by PCA over the neighbours within 0.55 r, on the camera's side.

    Raises:
        TooCrowdedError: more points than strings have.
    """
    points, _ = voxel_means(target.points, parameters.r * VOXEL_SHARE)
    if len(points) > MAX_POINTS:
        raise TooCrowdedError(
            f"view {target.view} has {len(points)} points above the table, more than {MAX_POINTS}: "
            "check the camera, the table's height, the workspace and the string's radius"
        )
    kept, normals = _surface(points, RADIUS_SHARE * parameters.r)
    points = points[kept]
    away = ((target.T_base_camera[:3, 3] - points) * normals).sum(axis=1) < 0
    normals[away] *= -1
    return NormalCloud(target.view, points, normals, target.T_levelling, target.T_base_camera, target.image)


def _surface(points: NDArray[np.float64], radius: float) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """(N,) which of the points (N, 3) are no outliers, and the normals (M, 3) of those, of either sign.

    One search for neighbours serves both.
    """
    count = len(points)
    if count <= FEW_NEIGHBOURS:
        return np.ones(count, dtype=bool), np.tile((0.0, 0.0, 1.0), (count, 1))
    i, j, neighbours = _neighbours(points, radius)
    kept = np.asarray(neighbours >= OUTLIER_SHARE * np.median(neighbours), dtype=np.bool_)
    A = csr_array((np.ones(len(i)), (i, j)), shape=(count, count))
    x, y, z = (points - points.mean(axis=0)).T
    terms = np.column_stack([x, y, z, x * x, x * y, x * z, y * y, y * z, z * z])
    means = (A @ terms + A.T @ terms + terms) / (neighbours[:, None] + 1)
    mean = means[:, :3]
    covariance = means[:, [3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    return kept, smallest_eigenvectors(covariance[kept])


def _neighbours(
    points: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Pairs (M,), (M,) of neighbouring points and how many neighbours each point (N,) has."""
    tree = KDTree(points)
    pairs, neighbours = np.empty((0, 2), dtype=np.intp), np.zeros(len(points), dtype=np.intp)
    for growth in RADIUS_GROWTH:
        pairs = tree.query_pairs(growth * radius, output_type="ndarray")
        neighbours = np.bincount(pairs.ravel(), minlength=len(points))
        if np.median(neighbours) >= FEW_NEIGHBOURS:
            break
    return pairs[:, 0], pairs[:, 1], neighbours


def smallest_eigenvectors(A: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3) unit eigenvectors of the least eigenvalue of symmetric matrices (N, 3, 3); up where there is none.

    In closed form (the trigonometric solution of the cubic): five times as fast as LAPACK one by one.
    """
    a, b, c, d, e, f = (A[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    mean = (a + b + c) / 3
    a, b, c = a - mean, b - mean, c - mean
    p = np.sqrt((a**2 + b**2 + c**2 + 2 * (d**2 + e**2 + f**2)) / 6)
    determinant = a * (b * c - f**2) - d * (d * c - f * e) + e * (d * f - b * e)
    cosine = np.clip(determinant / np.maximum(2 * p**3, 1e-300), -1, 1)
    least = 2 * p * np.cos((np.arccos(cosine) + 2 * np.pi) / 3)
    a, b, c = a - least, b - least, c - least
    # The rows of A - least I are at right angles to the eigenvector: of their cross products the longest is safest.
    products = np.stack(
        [
            np.column_stack([d * f - e * b, e * d - a * f, a * b - d**2]),
            np.column_stack([d * c - e * f, e**2 - a * c, a * f - d * e]),
            np.column_stack([b * c - f**2, f * e - d * c, d * f - b * e]),
        ]
    )
    length = np.linalg.norm(products, axis=2)
    longest = length.argmax(axis=0)
    at = np.arange(len(A))
    length = length[longest, at]
    axes = products[longest, at]
    flat = length <= 1e-12 * p**2
    axes[flat], length[flat] = (0.0, 0.0, 1.0), 1.0
    return axes / length[:, None]
