"""Tube fit: fits centre lines and radii to a measured surface by robust least squares.

A link is the straight part of a centre line between two neighbouring points.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.sparse import csr_array, eye_array, kron
from scipy.spatial import KDTree

from recognition.geometry.neighbours import group_sums
from recognition.geometry.polyline import unit_vectors

Points = NDArray[np.float64]

BEND_SIGMA_RADII = 1 / 38
"""Standard deviation of the second difference of three neighbouring points, in radii r. It sets the bending penalty."""
MAX_RESIDUAL_RADII = 0.6
"""Maximum distance between a tube and a surface point that belongs to the tube, in radii r."""
MIN_NORMAL_COSINE = 0.5
"""Minimum cosine between the normal of a surface point and the direction from the centre line to the point."""
MAX_BEYOND_END_RADII = 0.35
"""Maximum distance of a surface point beyond the end of its line, in radii r."""
TUKEY_SIGMAS = 3.0
"""Limit of the Tukey weight, in sigmas. Larger residuals have no weight."""
MIN_SIGMA_RADII = 0.03
"""Lower limit of the sigma of the residuals, in radii r. The traced lines have an error of about 0.1 r."""
N_BANDS = 6
"""Number of upper off-diagonals of the normal matrix. The bending penalty couples points up to two links apart."""
MAX_CANDIDATES = 4
"""Number of nearest links that are tried for each surface point. At a crossing, these must include both strands."""


@dataclass(frozen=True, eq=False)
class Assignment:
    """Assignment of K surface points to the links of the centre lines."""

    point: NDArray[np.int64]
    """(K,) index of the surface point in `TubeFit.surface`."""
    link: NDArray[np.int64]
    """(K,) index of the link's first point in `TubeFit.points`."""
    fraction: NDArray[np.float64]
    """(K,) position of the foot point along the link, 0 (first point) to 1 (second point)."""
    outward: Points
    """(K, 3) unit vectors from the foot point to the surface point."""
    residual: NDArray[np.float64]
    """(K,) signed distance of the surface point from the tube, metres; positive outside the tube."""
    weight: NDArray[np.float64]
    """(K,) Tukey weight, 0 to 1."""
    sigma: float
    """Robust standard deviation of the residuals, metres."""


class TubeFit:
    """Fit of centre lines and radii to a surface, by Gauss-Newton steps.

    `points` holds the points of all lines, one line after the other.

    Args:
        lines: (N_k, 3) points of each line, metres, base frame.
        r: Expected radius, metres. All limits are in multiples of r.
        surface: (M, 3) surface points, metres, base frame.
        normals: (M, 3) outward unit normals.
        radii: (K,) radius of each line, metres; None for r.

    Source:
        The fit is not in the paper. It replaces the means of eqs. (2) and (3).
    """

    def __init__(
        self,
        lines: Sequence[Points],
        r: float,
        surface: Points,
        normals: Points,
        radii: NDArray[np.float64] | None = None,
    ) -> None:
        self.r, self.surface, self.normals = r, surface, normals
        self.points = np.vstack(lines)
        lengths = [len(line) for line in lines]
        self.starts = np.concatenate([[0], np.cumsum(lengths)])
        self.line_of_point = np.repeat(np.arange(len(lines)), lengths)
        self.radii = np.full(len(lines), r) if radii is None else radii
        self._is_link = np.ones(len(self.points), dtype=bool)
        self._is_link[self.starts[1:] - 1] = False
        self._bending = _bending_matrix(self.starts, r)

    @property
    def lines(self) -> list[Points]:
        """(N_k, 3) points of each line, metres, base frame."""
        return [self.points[self.rows(number)] for number in range(len(self.radii))]

    def rows(self, number: int) -> slice:
        """Return the slice of `points` that belongs to the line `number`."""
        return slice(int(self.starts[number]), int(self.starts[number + 1]))

    def assign(self) -> Assignment:
        """Assign each surface point to the link with the tube that fits the point best in distance and normal."""
        links = np.flatnonzero(self._is_link)
        tree = KDTree((self.points[links] + self.points[links + 1]) / 2)
        count = min(MAX_CANDIDATES, len(links))
        max_distance = float(self.radii.max()) + MAX_RESIDUAL_RADII * self.r + self.r
        nearest = tree.query(self.surface, count, distance_upper_bound=max_distance)[1]
        nearest = nearest.reshape(len(self.surface), count)
        point, candidate = np.nonzero(nearest < len(links))
        candidates = self._project(point, links[nearest[point, candidate]])
        cosine = np.vecdot(candidates.outward, self.normals[candidates.point])
        cost = np.abs(candidates.residual) + 0.5 * self.r * (1 - cosine)
        # Sort by surface point, then by cost. The first candidate of each surface point is the best.
        order = np.lexsort((cost, candidates.point))
        order = order[np.diff(candidates.point[order], prepend=-1) > 0]
        return self._project(candidates.point[order], candidates.link[order])

    def update_assignment(self, assigned: Assignment) -> Assignment:
        """Return the updated assignment after a step. A surface point may change to a neighbouring link of its line."""
        shift = np.where(assigned.fraction >= 1, 1, np.where(assigned.fraction <= 0, -1, 0))
        link = np.clip(assigned.link + shift, 0, len(self.points) - 1)
        is_same_line = self._is_link[link] & (self.line_of_point[link] == self.line_of_point[assigned.link])
        return self._project(assigned.point, np.where(is_same_line, link, assigned.link))

    def step(self, assigned: Assignment, radius_sigma: float | None) -> None:
        """Update the points of all lines, and the radii, by one Gauss-Newton step.

        The normal matrix of the points is banded. Each radius adds one border column, with entries only in the rows of
        its own line. The border columns are therefore stored and solved as one column, their sum.

        Args:
            assigned: Current assignment of the surface points.
            radius_sigma: Standard deviation of the prior on the radii, with mean r, metres. None keeps the radii fixed.
        """
        weight = assigned.weight / assigned.sigma**2
        J = self._jacobian(assigned)
        gradient = J.T @ (weight * assigned.residual) + self._bending @ self.points.ravel()
        border = -(J.T @ weight)
        A = csr_array(J.T @ (weight[:, None] * J)) + self._bending
        size = self.points.size
        bands = np.zeros((N_BANDS + 1, size))
        for offset in range(min(N_BANDS + 1, size)):
            bands[N_BANDS - offset, offset:] = A.diagonal(offset)
        # The surface constrains neither motion along a line nor points without surface. Damp these motions.
        hold = 3 * float(bands[N_BANDS].mean())
        bands[N_BANDS] += 1e-3 * hold
        t = self._tangents()
        for p in range(3):
            for q in range(p, 3):
                bands[N_BANDS - (q - p), q::3] += hold * t[:, p] * t[:, q]
        solved = solveh_banded(bands, np.column_stack([gradient, border]))
        change = np.zeros(len(self.radii))
        line_of_row, line = np.repeat(self.line_of_point, 3), self.line_of_point[assigned.link]
        if radius_sigma is not None:
            # Eliminate the points (Schur complement) and solve for the radii first.
            pull = group_sums(line, -weight * assigned.residual, len(change)) + (self.radii - self.r) / radius_sigma**2
            stiffness = (
                group_sums(line, weight, len(change))
                + radius_sigma**-2
                - group_sums(line_of_row, border * solved[:, 1], len(change))
            )
            change = (group_sums(line_of_row, border * solved[:, 0], len(change)) - pull) / stiffness
            change = np.clip(self.radii + change, 0.4 * self.r, 2.5 * self.r) - self.radii
        self.radii = self.radii + change
        self.points = self.points - (solved[:, 0] + solved[:, 1] * change[line_of_row]).reshape(-1, 3)

    def support(self, assigned: Assignment) -> NDArray[np.float64]:
        """Return the support (N,) of each line point: the sum of the weights of its surface points.

        The weight of a surface point is divided between the two points of its link.
        """
        count = len(self.points)
        start = group_sums(assigned.link, assigned.weight * (1 - assigned.fraction), count)
        return start + group_sums(assigned.link + 1, assigned.weight * assigned.fraction, count)

    def lines_of_points(self, assigned: Assignment) -> NDArray[np.int64]:
        """Return the line index (M,) of each surface point; -1 if the point lies on no tube."""
        line = np.full(len(self.surface), -1)
        line[assigned.point] = self.line_of_point[assigned.link]
        return line

    def _project(self, point: NDArray[np.int64], link: NDArray[np.int64]) -> Assignment:
        """Project the surface points `point` (K,) onto the links `link` (K,). Exclude points that lie on no tube."""
        start = self.points[link]
        vector = self.points[link + 1] - start
        offset = self.surface[point] - start
        square = np.maximum(np.vecdot(vector, vector), 1e-18)
        along = np.vecdot(offset, vector) / square
        fraction = np.clip(along, 0.0, 1.0)
        outward = offset - fraction[:, None] * vector
        distance = np.sqrt(np.vecdot(outward, outward))
        outward /= np.maximum(distance, 1e-12)[:, None]
        residual = distance - self.radii[self.line_of_point[link]]
        is_beside = np.abs(along - fraction) * np.sqrt(square) <= MAX_BEYOND_END_RADII * self.r
        is_on = (np.abs(residual) < MAX_RESIDUAL_RADII * self.r) & is_beside
        is_on &= np.vecdot(outward, self.normals[point]) > MIN_NORMAL_COSINE
        residual = residual[is_on]
        sigma = max(1.4826 * float(np.median(np.abs(residual))), MIN_SIGMA_RADII * self.r) if len(residual) else self.r
        weight = np.maximum(1 - (residual / (TUKEY_SIGMAS * sigma)) ** 2, 0.0) ** 2
        return Assignment(point[is_on], link[is_on], fraction[is_on], outward[is_on], residual, weight, sigma)

    def _tangents(self) -> Points:
        """Return the unit tangents (N, 3) of the lines at all points."""
        after = np.where(np.append(self._is_link[:-1], False), 1, 0) + np.arange(len(self.points))
        before = np.arange(len(self.points)) - np.where(np.insert(self._is_link[:-1], 0, False), 1, 0)
        return unit_vectors(self.points[after] - self.points[before])

    def _jacobian(self, assigned: Assignment) -> csr_array:
        """Return the Jacobian (K, 3N) of the residuals with respect to the coordinates of the points."""
        shares = np.column_stack([1 - assigned.fraction, assigned.fraction])
        values = -(shares[:, :, None] * assigned.outward[:, None, :]).ravel()
        columns = (3 * assigned.link[:, None] + np.arange(6)).ravel()
        starts = 6 * np.arange(len(assigned.link) + 1)
        return csr_array((values, columns, starts), shape=(len(assigned.link), 3 * len(self.points)))


def _bending_matrix(starts: NDArray[np.int64], r: float) -> csr_array:
    """Return the information matrix (3N, 3N) of the bending penalty, from the second differences of each line.

    Line k has the points `starts[k]` to `starts[k + 1]` - 1.
    """
    count = int(starts[-1])
    inner = np.setdiff1d(np.arange(count), np.concatenate([starts[:-1], starts[1:] - 1]))
    columns = (inner[:, None] + (-1, 0, 1)).ravel()
    D = csr_array((np.tile((1.0, -2.0, 1.0), len(inner)), columns, 3 * np.arange(len(inner) + 1)), (len(inner), count))
    return csr_array(kron(D.T @ D, eye_array(3)) * (BEND_SIGMA_RADII * r) ** -2.0)
