"""Estimate normal vectors and remove outliers (sections II.C and II.D)."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from recognition.errors import TooCrowdedError
from recognition.geometry.voxel_grid import voxel_means
from recognition.parameters import ChainParameters
from recognition.preprocessing.table_scatter import TableScatter
from recognition.preprocessing.target_cloud import DepthView, TargetCloud

NEIGHBOURHOOD_RADII = 0.55
"""Radius of the PCA neighbourhood, in radii r. The paper gives no value.

A larger neighbourhood flattens the normals, because the string is curved. On simulated scans, the error of the centre
line of eqs. (1) and (2) is 0.37 mm with 0.4 to 0.5 r, 0.43 mm with 0.6 r, and 0.57 mm with 0.9 r. In a smaller
neighbourhood, noise dominates the single centre points of eq. (1).
"""
GROWTH_FACTORS = (1.0, 1.5, 2.25)
"""Factors of the neighbourhood radius. The smallest factor that gives `MIN_NEIGHBOURS` is used. Sparse pixels need a
larger neighbourhood."""
MIN_NEIGHBOURS = 6
"""Minimum median number of neighbours over the points of a view."""
OUTLIER_NEIGHBOUR_SHARE = 0.5
"""Minimum number of neighbours of an inlier, as a share of the median number. Outliers are flying pixels, specks, and
points at edges, where the neighbours do not determine a plane."""
MAX_POINTS = 100_000
"""Maximum number of points of one view after voxel averaging. A metre of string has about 8,000 points."""
VOXEL_RADII = 1 / 4
"""Edge length of the averaging voxels, in radii r. The depth errors of closer pixels are correlated."""
MIN_CUBE = 1e-300
"""Lower limit of a divisor. It keeps the eigenvalues of a zero matrix finite."""
DEGENERATE_SHARE = 1e-12
"""Length of a cross product, relative to the squared size of the matrix, below which two eigenvalues are equal."""


@dataclass(frozen=True, eq=False)
class NormalCloud:
    """The point cloud with normal vectors of one view ("point cloud with NV" in the paper)."""

    view: int
    """Index of the view."""
    points: NDArray[np.float64]
    """(N, 3) points in the base frame, metres."""
    normals: NDArray[np.float64]
    """(N, 3) unit normal vectors, oriented towards the camera."""
    T_correction: NDArray[np.float64]
    """(4, 4) motion of the view from its hand-eye pose to its current pose, base to base, metres."""
    T_base_camera: NDArray[np.float64] | None = None
    """(4, 4) camera pose after the correction, metres; None if unknown."""
    image: DepthView | None = None
    """View that the points come from; None if unknown."""
    scatter: TableScatter = field(default_factory=TableScatter)
    """Scatter of the depth of the view, measured on the table."""

    @cached_property
    def tree(self) -> KDTree:
        """k-d tree of the points, built at the first access."""
        return KDTree(self.points)


def estimate_normals(target: TargetCloud, parameters: ChainParameters) -> NormalCloud:
    """Average the points of a view in voxels, remove outliers and estimate normal vectors by PCA.

    Args:
        target: Points of one view above the height threshold.
        parameters: Method parameters; uses the radius r.

    Returns:
        The points with unit normal vectors that are oriented towards the camera.

    Raises:
        TooCrowdedError: The view has more than `MAX_POINTS` points.

    Source:
        Sections II.C and II.D. The paper does not give the sizes of voxels and neighbourhood.
    """
    points, _ = voxel_means(target.points, parameters.r * VOXEL_RADII)
    if len(points) > MAX_POINTS:
        raise TooCrowdedError(
            f"view {target.view} has {len(points)} points above the table, more than {MAX_POINTS}: "
            "check the camera, the table height, the workspace and the string radius"
        )
    kept, normals = _inliers_and_normals(points, NEIGHBOURHOOD_RADII * parameters.r)
    points = points[kept]
    faces_away = ((target.T_base_camera[:3, 3] - points) * normals).sum(axis=1) < 0
    normals[faces_away] *= -1
    return NormalCloud(
        target.view,
        points,
        normals,
        target.T_table_alignment,
        target.T_base_camera,
        target.image,
        target.scatter,
    )


def _inliers_and_normals(points: NDArray[np.float64], radius: float) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return the inlier mask (N,) of the points (N, 3), and the normals (M, 3) of the inliers, of either sign.

    The outlier test and the normals use the same neighbour search.
    """
    count = len(points)
    if count <= MIN_NEIGHBOURS:
        return np.ones(count, dtype=bool), np.tile((0.0, 0.0, 1.0), (count, 1))
    i, j, n_neighbours = _find_neighbours(points, radius)
    kept = np.asarray(n_neighbours >= OUTLIER_NEIGHBOUR_SHARE * np.median(n_neighbours), dtype=np.bool_)
    A = csr_array((np.ones(len(i)), (i, j)), shape=(count, count))
    x, y, z = (points - points.mean(axis=0)).T
    terms = np.column_stack([x, y, z, x * x, x * y, x * z, y * y, y * z, z * z])
    means = (A @ terms + A.T @ terms + terms) / (n_neighbours[:, None] + 1)
    mean = means[:, :3]
    covariance = means[:, [3, 4, 5, 4, 6, 7, 5, 7, 8]].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    return kept, smallest_eigenvectors(covariance[kept])


def _find_neighbours(
    points: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices (M,) and (M,) of the neighbouring point pairs, and the number of neighbours (N,) per point."""
    tree = KDTree(points)
    pairs = np.empty((0, 2), dtype=np.intp)
    n_neighbours = np.zeros(len(points), dtype=np.intp)
    for factor in GROWTH_FACTORS:
        pairs = tree.query_pairs(factor * radius, output_type="ndarray")
        n_neighbours = np.bincount(pairs.ravel(), minlength=len(points))
        if np.median(n_neighbours) >= MIN_NEIGHBOURS:
            break
    return pairs[:, 0], pairs[:, 1], n_neighbours


def smallest_eigenvectors(A: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the eigenvectors of the smallest eigenvalues of symmetric matrices.

    The closed form (trigonometric solution of the cubic) is five times faster than LAPACK.

    Args:
        A: (N, 3, 3) symmetric matrices.

    Returns:
        Unit vectors (N, 3) of either sign; (0, 0, 1) where the smallest eigenvalue is a multiple eigenvalue.
    """
    # The rows of a matrix are (a, d, e), (d, b, f) and (e, f, c).
    diagonal = np.stack([A[:, 0, 0], A[:, 1, 1], A[:, 2, 2]])
    a, b, c = diagonal
    d, e, f = (A[:, i, j] for i, j in ((0, 1), (0, 2), (1, 2)))
    # The closed form needs a matrix of trace zero.
    diagonal = diagonal - (a + b + c) / 3
    a, b, c = diagonal
    p = np.sqrt((a**2 + b**2 + c**2 + 2 * (d**2 + e**2 + f**2)) / 6)
    determinant = a * (b * c - f**2) - d * (d * c - f * e) + e * (d * f - b * e)
    cosine = np.clip(determinant / np.maximum(2 * p**3, MIN_CUBE), -1, 1)
    smallest = 2 * p * np.cos((np.arccos(cosine) + 2 * np.pi) / 3)
    a, b, c = diagonal - smallest
    # The eigenvector is normal to the rows of A - smallest I. The longest cross product of two rows is most exact.
    products = np.stack(
        [
            np.column_stack([d * f - e * b, e * d - a * f, a * b - d**2]),
            np.column_stack([d * c - e * f, e**2 - a * c, a * f - d * e]),
            np.column_stack([b * c - f**2, f * e - d * c, d * f - b * e]),
        ]
    )
    length = np.linalg.norm(products, axis=2)
    longest = length.argmax(axis=0)
    index = np.arange(len(A))
    length = length[longest, index]
    eigenvectors = products[longest, index]
    is_degenerate = length <= DEGENERATE_SHARE * p**2
    eigenvectors[is_degenerate] = (0.0, 0.0, 1.0)
    length[is_degenerate] = 1.0
    return eigenvectors / length[:, None]
