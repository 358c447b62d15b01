"""Tube fit: fits centre lines and radii to a measured surface by robust least squares.

A link is the straight part of a centre line between two neighbouring points.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.spatial import KDTree

from recognition.geometry.neighbours import group_sums
from recognition.geometry.polyline import unit_vectors

Points = NDArray[np.float64]

BEND_SIGMA_RADII = 1 / 38
"""Standard deviation of the second difference of three neighbouring points, in radii r. It sets the bending penalty."""
END_BEND_POINTS = 3
"""Number of second differences at each end of a line whose penalty is reduced."""
END_BEND_FACTOR = 2.0
"""Factor of the standard deviation at the ends of a line.

An end has surface on one side only. The full penalty turns the last part of a bent line straight, and displaces the end
across by up to 4 mm where the surface is noisy. A larger factor makes the ends of repeated scans differ more.
"""
TIGHT_BEND_SIGMA_RADII = 0.2
"""The same standard deviation near hidden bends, in radii r: in a tight knot, strands have bend radii of about 2.5 r.

The usual penalty makes a tight bend wider by more than r.
"""
TIGHT_RADII = 3.0
"""Maximum distance of a point from a hidden bend to which this standard deviation applies, in radii r."""
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
SECOND_DIFFERENCE = (1.0, -2.0, 1.0)
"""Coefficients of the second difference at a point: of the point before it, of itself, and of the point after it."""
MAX_CANDIDATES = 4
"""Number of nearest links that are tried for each surface point. At a crossing, these must include both strands."""
NORMAL_COST_RADII = 0.5
"""Cost of a link for one minus the cosine between the normal and the direction from the link, in radii r."""
ALONG_DAMPING = 3.0
"""Damping of the motion of a point along its line, in mean diagonal entries of the normal matrix."""
DAMPING_SHARE = 1e-3
"""Damping of the motion of a point in every direction, as a share of the damping along the line."""
RADIUS_LIMITS = (0.4, 2.5)
"""Smallest and largest fitted radius, in radii r."""
SIGMA_PER_MAD = 1.4826
"""Standard deviation of normally distributed residuals, in medians of their absolute values."""


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


class HeightPull(Protocol):
    """Heights to which the points of the lines are pulled. `RestingHeights` is one."""

    @property
    def height_m(self) -> NDArray[np.float64]:
        """(N,) height of each point, metres, base frame."""
        ...

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """(N,) weight of the height, relative to the weight of the surface beside the point."""
        ...


class TubeFit:
    """Fit of centre lines and radii to a surface, by Gauss-Newton steps.

    `points` holds the points of all lines, one line after the other.

    Args:
        lines: (N_k, 3) points of each line, metres, base frame.
        r: Expected radius, metres. All limits are in multiples of r.
        surface: (M, 3) surface points, metres, base frame.
        normals: (M, 3) outward unit normals.
        radii: (K,) radius of each line, metres; None for r.
        bends: (B, 3) points of the hidden bends of strands, metres, base frame; None for none. Strands near them may
            bend tightly.

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
        bends: Points | None = None,
    ) -> None:
        self.r = r
        self.surface = surface
        self.normals = normals
        self.points = np.vstack(lines)
        lengths = [len(line) for line in lines]
        self.starts = np.concatenate([[0], np.cumsum(lengths)])
        self.line_of_point = np.repeat(np.arange(len(lines)), lengths)
        self.radii = np.full(len(lines), r) if radii is None else radii
        self._is_link = np.ones(len(self.points), dtype=bool)
        self._is_link[self.starts[1:] - 1] = False
        ends = np.concatenate([self.starts[:-1], self.starts[1:] - 1])
        self._inner = np.setdiff1d(np.arange(len(self.points)), ends)
        self._bending_weights = _bending_weights(self._inner, self.starts, r)
        if bends is not None and len(bends):
            distance, _ = KDTree(bends).query(self.points[self._inner], distance_upper_bound=TIGHT_RADII * r)
            self._bending_weights[np.isfinite(distance)] = (TIGHT_BEND_SIGMA_RADII * r) ** -2.0
        self._bending_bands = _bending_bands(self._inner, self._bending_weights, len(self.points))

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
        _, nearest = tree.query(self.surface, count, distance_upper_bound=max_distance)
        nearest = nearest.reshape(len(self.surface), count)
        point, candidate = np.nonzero(nearest < len(links))
        candidates = self._project(point, links[nearest[point, candidate]])
        cosine = _dot(candidates.outward.T, self.normals.T.take(candidates.point, axis=1))
        cost = np.abs(candidates.residual) + NORMAL_COST_RADII * self.r * (1 - cosine)
        # The candidates are in the order of the surface points. The first one with the lowest cost is the best.
        lowest = np.full(len(self.surface), np.inf)
        np.minimum.at(lowest, candidates.point, cost)
        best = np.flatnonzero(cost == lowest[candidates.point])
        best = best[np.diff(candidates.point[best], prepend=-1) > 0]
        return self._project(candidates.point[best], candidates.link[best])

    def update_assignment(self, assigned: Assignment) -> Assignment:
        """Return the updated assignment after a step. A surface point may change to a neighbouring link of its line."""
        shift = np.where(assigned.fraction >= 1, 1, np.where(assigned.fraction <= 0, -1, 0))
        link = np.clip(assigned.link + shift, 0, len(self.points) - 1)
        is_same_line = self._is_link[link] & (self.line_of_point[link] == self.line_of_point[assigned.link])
        return self._project(assigned.point, np.where(is_same_line, link, assigned.link))

    def step(self, assigned: Assignment, radius_sigma: float | None, pull: HeightPull | None = None) -> None:
        """Update the points of all lines, and the radii, by one Gauss-Newton step.

        The normal matrix of the points is banded. Each radius adds one border column, with entries only in the rows of
        its own line. The border columns are therefore stored and solved as one column, their sum.

        Args:
            assigned: Current assignment of the surface points.
            radius_sigma: Standard deviation of the prior on the radii, with mean r, metres. None keeps the radii fixed.
            pull: Heights to which points are pulled, or None.
        """
        weight = assigned.weight / assigned.sigma**2
        bands, gradient, border = self._normal_equations(assigned, weight)
        if pull is not None:
            information = self.support(assigned) / assigned.sigma**2
            # Normals point in all directions across the string, so the vertical one has half of the information.
            stiffness = pull.stiffness * np.minimum(information, np.median(information)) / 2
            bands[N_BANDS, 2::3] += stiffness
            gradient[2::3] += stiffness * (self.points[:, 2] - pull.height_m)
        # The surface constrains neither motion along a line nor points without surface. Damp these motions.
        hold = ALONG_DAMPING * float(bands[N_BANDS].mean())
        bands[N_BANDS] += DAMPING_SHARE * hold
        t = self._tangents()
        for p in range(3):
            for q in range(p, 3):
                bands[N_BANDS - (q - p), q::3] += hold * t[:, p] * t[:, q]
        solved = solveh_banded(bands, np.column_stack([gradient, border]))
        move = solved[:, 0]
        move_per_radius = solved[:, 1]
        line_of_row = np.repeat(self.line_of_point, 3)
        n_lines = len(self.radii)
        change = np.zeros(n_lines)
        if radius_sigma is not None:
            # Eliminate the points (Schur complement) and solve for the radii first.
            line = self.line_of_point[assigned.link]
            radius_gradient = group_sums(line, -weight * assigned.residual, n_lines)
            radius_gradient += (self.radii - self.r) / radius_sigma**2
            own_stiffness = group_sums(line, weight, n_lines) + radius_sigma**-2
            stiffness = own_stiffness - group_sums(line_of_row, border * move_per_radius, n_lines)
            change = (group_sums(line_of_row, border * move, n_lines) - radius_gradient) / stiffness
            smallest, largest = (share * self.r for share in RADIUS_LIMITS)
            change = np.clip(self.radii + change, smallest, largest) - self.radii
        self.radii = self.radii + change
        self.points = self.points - (move + move_per_radius * change[line_of_row]).reshape(-1, 3)

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
        # Each coordinate is one row: numpy is several times faster on three long rows than on rows of three.
        start = self.points.T.take(link, axis=1)
        vector = self.points.T.take(link + 1, axis=1) - start
        offset = self.surface.T.take(point, axis=1) - start
        square = np.maximum(_dot(vector, vector), 1e-18)
        along = _dot(offset, vector) / square
        fraction = np.clip(along, 0.0, 1.0)
        outward = offset - fraction * vector
        distance = np.sqrt(_dot(outward, outward))
        outward /= np.maximum(distance, 1e-12)
        residual = distance - self.radii[self.line_of_point[link]]
        is_beside = np.abs(along - fraction) * np.sqrt(square) <= MAX_BEYOND_END_RADII * self.r
        is_on = (np.abs(residual) < MAX_RESIDUAL_RADII * self.r) & is_beside
        is_on &= _dot(outward, self.normals.T.take(point, axis=1)) > MIN_NORMAL_COSINE
        on = np.flatnonzero(is_on)
        residual = residual[on]
        sigma = self.r
        if len(residual):
            sigma = max(SIGMA_PER_MAD * float(np.median(np.abs(residual))), MIN_SIGMA_RADII * self.r)
        weight = np.maximum(1 - (residual / (TUKEY_SIGMAS * sigma)) ** 2, 0.0) ** 2
        return Assignment(point[on], link[on], fraction[on], outward.take(on, axis=1).T, residual, weight, sigma)

    def _tangents(self) -> Points:
        """Return the unit tangents (N, 3) of the lines at all points."""
        after = np.where(np.append(self._is_link[:-1], False), 1, 0) + np.arange(len(self.points))
        before = np.arange(len(self.points)) - np.where(np.insert(self._is_link[:-1], 0, False), 1, 0)
        return unit_vectors(self.points[after] - self.points[before])

    def _normal_equations(self, assigned: Assignment, weight: NDArray[np.float64]) -> tuple[Points, Points, Points]:
        """Return the normal matrix in bands (N_BANDS + 1, 3N), the gradient (3N,) and the radius column (3N,).

        The coordinates of the points are the unknowns. The residual of a surface point depends on the six coordinates
        of its link. The entries of each pair of coordinates are summed over the surface points of each link.

        `weight` (K,) are the weights of the residuals.
        """
        count = len(self.points)
        bands = self._bending_bands.copy()
        gradient = self._bending_gradient()
        border = np.zeros(3 * count)
        shares = np.stack([1 - assigned.fraction, assigned.fraction])
        J = -(shares[:, None] * assigned.outward.T).reshape(6, -1)
        weighted_J = weight * J
        for a in range(6):
            # Coordinate `a` of the links is every third row. The last point begins no link.
            n_links = count - a // 3
            gradient[a::3] += group_sums(assigned.link, weighted_J[a] * assigned.residual, count)[:n_links]
            border[a::3] -= group_sums(assigned.link, weighted_J[a], count)[:n_links]
            for b in range(a + 1):
                products = group_sums(assigned.link, weighted_J[a] * J[b], count)
                bands[N_BANDS - (a - b), a::3] += products[:n_links]
        return bands, gradient, border

    def _bending_gradient(self) -> Points:
        """Return the gradient (3N,) of the bending penalty with respect to the coordinates of the points."""
        neighbours = [(coefficient, self._inner + k - 1) for k, coefficient in enumerate(SECOND_DIFFERENCE)]
        second = sum(coefficient * self.points[point] for coefficient, point in neighbours)
        gradient = np.zeros_like(self.points)
        for coefficient, point in neighbours:
            gradient[point] += coefficient * self._bending_weights[:, None] * second
        return gradient.ravel()


def _dot(a: Points, b: Points) -> NDArray[np.float64]:
    """Return the dot products (K,) of the columns of two arrays (3, K)."""
    return np.einsum("ij,ij->j", a, b)


def _bending_weights(inner: NDArray[np.int64], starts: NDArray[np.int64], r: float) -> NDArray[np.float64]:
    """Return the weights of the squared second differences at the points `inner`, smaller near the ends of a line.

    Line k has the points `starts[k]` to `starts[k + 1]` - 1.
    """
    line = np.searchsorted(starts, inner, side="right") - 1
    to_end = np.minimum(inner - starts[line], starts[line + 1] - 1 - inner)
    sigma = BEND_SIGMA_RADII * r * np.where(to_end <= END_BEND_POINTS, END_BEND_FACTOR, 1.0)
    return sigma**-2.0


def _bending_bands(inner: NDArray[np.int64], weights: NDArray[np.float64], count: int) -> Points:
    """Return the information matrix (3N, 3N) of the bending penalty, in upper bands (N_BANDS + 1, 3N).

    `inner` are the points of the lines that are no ends, among `count` points, and `weights` those of their second
    differences.
    """
    bands = np.zeros((N_BANDS + 1, count, 3))
    for a in range(3):
        for b in range(a + 1):
            products = SECOND_DIFFERENCE[a] * SECOND_DIFFERENCE[b] * weights
            bands[N_BANDS - 3 * (a - b), inner + a - 1] += products[:, None]
    return bands.reshape(N_BANDS + 1, -1)
