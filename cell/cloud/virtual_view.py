"""The depth image of a virtual pinhole camera that looks at a point cloud."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from calibration.geometry.transforms import inverse, transform_points
from cell.cloud.errors import CloudError
from cell.recording.limits import DEFAULT_LIMITS

WIDEST = np.tan(np.deg2rad(65.0))
"""Points farther than 65 degrees from the optical axis are not in the image."""
NEAREST_M = 0.03
"""A viewpoint nearer to a point than this is inside the cloud."""
NEIGHBOURS = 8
SAMPLE = 4000
"""Number of points at which the spacing is measured."""
BEHIND_PX = 2.0
"""A point is hidden if it is farther behind the front than this many pixel widths. A visible surface may be inclined to
the image by up to 63 degrees."""
FLATNESS = 0.003
"""Weight that keeps the slope of a pixel's plane at zero where its points do not determine it."""


@dataclass(frozen=True, eq=False)
class VirtualView:
    """Depth image of a point cloud from one viewpoint."""

    depth_m: NDArray[np.float64]
    """(H, W) along the optical axis; 0 where no point is."""
    K: NDArray[np.float64]
    """(3, 3), pixels."""
    T_base_camera: NDArray[np.float64]
    """(4, 4) camera pose."""
    pitch_m: float
    """Width of a pixel at the median depth of the points."""
    hidden: int
    """Number of points that other points hide."""
    outside: int
    """Number of points outside the image."""


def look_at(viewpoint: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return T_base_camera (4, 4) of a camera at `viewpoint` (3,) whose optical axis goes through `target` (3,)."""
    z = target - viewpoint
    z /= np.linalg.norm(z)
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (1.0, 0.0, 0.0), z)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = viewpoint
    return T


def virtual_view(points: NDArray[np.float64], viewpoint: NDArray[np.float64], points_per_pixel: float) -> VirtualView:
    """Return the depth image of the points that are visible from `viewpoint`.

    The image is as fine as the spacing of the points. A plane is fitted in inverse depth to the points in and around
    each pixel, and taken at the pixel's centre: a slope does not become steps, and noise is averaged.

    Args:
        points: (N, 3), base frame, metres.
        viewpoint: (3,), base frame, metres.
        points_per_pixel: Mean number of points in a pixel.

    Raises:
        CloudError: The viewpoint is inside the cloud, or the image would be too large.
    """
    nearest = float(np.linalg.norm(points - viewpoint, axis=1).min())
    where = f"the viewpoint ({', '.join(f'{value:g}' for value in viewpoint)})"
    if nearest < NEAREST_M:
        raise CloudError(
            f"{where} is {nearest * 1000:.0f} mm from a point, inside the cloud: give the camera's position"
        )
    T = look_at(viewpoint, np.median(points, axis=0))
    x, y, z = transform_points(inverse(T), points).T
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = x / z, y / z
        in_image = (z > NEAREST_M) & (np.hypot(a, b) < WIDEST)
    if in_image.mean() < 0.5:
        raise CloudError(
            f"{where} has most points beside or behind it: it is inside the cloud; give the camera's position, in the "
            "frame of the points"
        )
    a, b, w = a[in_image], b[in_image], 1 / z[in_image]
    step = _spacing(np.column_stack([a, b])) * np.sqrt(points_per_pixel)
    left, top = a.min() - step, b.min() - step
    width, height = (int(np.ceil((side.max() - side.min()) / step)) + 3 for side in (a, b))
    if width * height > DEFAULT_LIMITS.image_pixels:
        step *= np.sqrt(width * height / DEFAULT_LIMITS.image_pixels) * 1.01
        width, height = (int(np.ceil((side.max() - side.min()) / step)) + 3 for side in (a, b))
    u, v = (a - left) / step, (b - top) / step
    inverse_depth, front = _rasterise(u, v, w, step, (height, width))
    K = np.array([[1 / step, 0.0, -left / step], [0.0, 1 / step, -top / step], [0.0, 0.0, 1.0]])
    if not (0 < K[0, 2] < width and 0 < K[1, 2] < height):
        raise CloudError(f"{where} sees all points to one side of its optical axis: give the camera's position")
    with np.errstate(divide="ignore"):
        depth_m = np.where(inverse_depth > 0, 1 / inverse_depth, 0.0)
    pitch_m = step / float(np.median(w))
    return VirtualView(depth_m, K, T, pitch_m, int(np.count_nonzero(~front)), int(np.count_nonzero(~in_image)))


def _spacing(plane: NDArray[np.float64]) -> float:
    """Return the pitch of a square grid as dense as the points (N, 2) are at the median."""
    sample = plane[:: max(len(plane) // SAMPLE, 1)]
    distance = KDTree(plane).query(sample, k=NEIGHBOURS + 1)[0][:, -1]
    return float(np.median(distance)) * float(np.sqrt(np.pi / NEIGHBOURS))


def _rasterise(
    u: NDArray[np.float64], v: NDArray[np.float64], w: NDArray[np.float64], step: float, shape: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the inverse depth (H, W) at the pixel centres, 0 where no point is, and which points are in front.

    Args:
        u: (N,) columns, from the first pixel's centre.
        v: (N,) rows.
        w: (N,) inverse depths, 1/m.
        step: Width of a pixel at the depth 1 m, metres.
        shape: Height and width of the image.
    """
    height, width = shape
    nearest = np.zeros(shape)
    own = (np.rint(v).astype(np.int64), np.rint(u).astype(np.int64))
    nearer_last = np.argsort(w)
    nearest[own[0][nearer_last], own[1][nearer_last]] = w[nearer_last]
    filled = nearest > 0
    nearest = ndimage.maximum_filter(nearest, 3)
    front = 1 / w - 1 / nearest[own] < BEHIND_PX * step / w
    u, v, w = u[front], v[front], w[front]
    nearest, filled = nearest.ravel(), filled.ravel()
    sums = np.zeros((9, height * width))
    left, top = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    for column, row in ((left, top), (left + 1, top), (left, top + 1), (left + 1, top + 1)):
        at = row * width + column
        kept = 1 / w - 1 / nearest[at] < BEHIND_PX * step / w
        at, du, dv, wk = at[kept], (u - column)[kept], (v - row)[kept], w[kept]
        weight = (1 - np.abs(du)) * (1 - np.abs(dv))
        terms = (np.ones_like(wk), du, dv, du * du, du * dv, dv * dv, wk, du * wk, dv * wk)
        for k, term in enumerate(terms):
            sums[k] += np.bincount(at, weight * term, height * width)
    filled &= sums[0] > 0
    n, su, sv, suu, suv, svv, sw, suw, svw = sums
    M = np.stack([n, su, sv, su, suu + FLATNESS * n, suv, sv, suv, svv + FLATNESS * n], axis=1)[filled].reshape(
        -1, 3, 3
    )
    solved = np.linalg.solve(M, np.stack([sw, suw, svw], axis=1)[filled][..., None])[:, 0, 0]
    result = np.zeros(height * width)
    # A plane through few points may overshoot: the mean is used there.
    mean = sw[filled] / n[filled]
    result[filled] = np.where(np.abs(solved / mean - 1) < BEHIND_PX * step, solved, mean)
    return result.reshape(shape), front
