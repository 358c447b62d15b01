"""Tubes fitted to a measured surface: lines of points and a radius each, by robust least squares."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.sparse import csr_array, eye_array, kron
from scipy.spatial import KDTree

from recognition.geometry.neighbours import group_sums

Points = NDArray[np.float64]

BEND_SHARE = 1 / 38
"""One sigma of the second difference of neighbouring points, as a share of r: how much a string may bend."""
NEAR_SHARE = 0.6
"""A surface point farther than this share of r from a tube is not of it."""
SAME_SIDE = 0.5
"""Least cosine between a point's normal and its direction from the centre line."""
BEYOND_SHARE = 0.35
"""How far beyond a line's end, as a share of r, surface still counts as beside it."""
CUT_SIGMAS = 3.0
"""Residuals beyond this many sigma count nothing (Tukey)."""
SIGMA_FLOOR = 0.03
"""Residuals are never taken to be smaller than this share of r: the lines themselves begin a tenth of r off."""
BANDS = 6
"""Off-diagonals of the points' normal matrix: bending couples the coordinates of points two apart."""
CANDIDATES = 4
"""Nearest links looked at for each surface point: at a crossing, both strands must be among them."""


@dataclass(frozen=True, eq=False)
class Assignment:
    """Surface points and the links of the lines that they lie over."""

    point: NDArray[np.int64]
    """(K,) which surface point."""
    link: NDArray[np.int64]
    """(K,) first point of the link."""
    share: NDArray[np.float64]
    """(K,) where on the link the foot is, 0 to 1."""
    outward: Points
    """(K, 3) unit vectors from the foot."""
    residual: NDArray[np.float64]
    """(K,) distance from the foot less the radius."""
    weight: NDArray[np.float64]
    """(K,) Tukey weight, 0 to 1."""
    sigma: float
    """One sigma of the residuals, metres."""


class TubeFit:
    """Lines and radii that are moved to fit a surface, step by step.

    All lines lie in one array, one after the other.
    """

    def __init__(self, lines: Sequence[Points], r: float, surface: Points, normals: Points) -> None:
        self.r, self.surface, self.normals = r, surface, normals
        self.points = np.vstack(lines)
        lengths = [len(line) for line in lines]
        self.starts = np.concatenate([[0], np.cumsum(lengths)])
        self.strand = np.repeat(np.arange(len(lines)), lengths)
        self.radii = np.full(len(lines), r)
        self._is_link = np.ones(len(self.points), dtype=bool)
        self._is_link[self.starts[1:] - 1] = False
        self._bending = _bending(self.starts, r)

    def line(self, number: int) -> slice:
        """Rows of one line's points."""
        return slice(int(self.starts[number]), int(self.starts[number + 1]))

    def assign(self) -> Assignment:
        """Each surface point to the link whose tube it lies on best, by distance and normal."""
        links = np.flatnonzero(self._is_link)
        tree = KDTree((self.points[links] + self.points[links + 1]) / 2)
        count = min(CANDIDATES, len(links))
        reach = float(self.radii.max()) + NEAR_SHARE * self.r + self.r
        near = tree.query(self.surface, count, distance_upper_bound=reach)[1].reshape(len(self.surface), count)
        point, candidate = np.nonzero(near < len(links))
        found = self._over(point, links[near[point, candidate]])
        cosine = np.vecdot(found.outward, self.normals[found.point])
        badness = np.abs(found.residual) + 0.5 * self.r * (1 - cosine)
        # The best of each point's candidates is the first in this order.
        order = np.lexsort((badness, found.point))
        order = order[np.diff(found.point[order], prepend=-1) > 0]
        return self._over(found.point[order], found.link[order])

    def follow(self, assigned: Assignment) -> Assignment:
        """The same points after a step: each may have slid to the next link."""
        on = np.where(assigned.share >= 1, 1, np.where(assigned.share <= 0, -1, 0))
        link = np.clip(assigned.link + on, 0, len(self.points) - 1)
        same = self._is_link[link] & (self.strand[link] == self.strand[assigned.link])
        return self._over(assigned.point, np.where(same, link, assigned.link))

    def step(self, assigned: Assignment, radius_tie: float | None) -> None:
        """One Gauss-Newton step of all points, and of the radii, tied to r by `radius_tie` (one sigma, metres).

        The points' normal matrix is banded. The radii border it with a column each, and since the lines do not meet
        in it, all these columns fit in one. Without a tie the radii stay.
        """
        weight = assigned.weight / assigned.sigma**2
        J = self._slopes(assigned)
        gradient = J.T @ (weight * assigned.residual) + self._bending @ self.points.ravel()
        border = -(J.T @ weight)
        A = csr_array(J.T @ (weight[:, None] * J)) + self._bending
        size = self.points.size
        bands = np.zeros((BANDS + 1, size))
        for away in range(min(BANDS + 1, size)):
            bands[BANDS - away, away:] = A.diagonal(away)
        # Nothing measured holds the points along their line, nor those that no surface bears: they stay.
        hold = 3 * float(bands[BANDS].mean())
        bands[BANDS] += 1e-3 * hold
        t = self._tangents()
        for p in range(3):
            for q in range(p, 3):
                bands[BANDS - (q - p), q::3] += hold * t[:, p] * t[:, q]
        solved = solveh_banded(bands, np.column_stack([gradient, border]))
        change = np.zeros(len(self.radii))
        line, owner = np.repeat(self.strand, 3), self.strand[assigned.link]
        if radius_tie is not None:
            # The radii come first, by the points' Schur complement.
            pull = group_sums(owner, -weight * assigned.residual, len(change)) + (self.radii - self.r) / radius_tie**2
            stiffness = (
                group_sums(owner, weight, len(change))
                + radius_tie**-2
                - group_sums(line, border * solved[:, 1], len(change))
            )
            change = (group_sums(line, border * solved[:, 0], len(change)) - pull) / stiffness
            change = np.clip(self.radii + change, 0.4 * self.r, 2.5 * self.r) - self.radii
        self.radii = self.radii + change
        self.points = self.points - (solved[:, 0] + solved[:, 1] * change[line]).reshape(-1, 3)

    def support(self, assigned: Assignment) -> NDArray[np.float64]:
        """(N,) weight of the surface points that bear each point of the lines."""
        count = len(self.points)
        start = group_sums(assigned.link, assigned.weight * (1 - assigned.share), count)
        return start + group_sums(assigned.link + 1, assigned.weight * assigned.share, count)

    def owners(self, assigned: Assignment) -> NDArray[np.int64]:
        """(M,) for each surface point the number of the line on whose tube it lies, -1 for none."""
        owner = np.full(len(self.surface), -1)
        owner[assigned.point] = self.strand[assigned.link]
        return owner

    def _over(self, point: NDArray[np.int64], link: NDArray[np.int64]) -> Assignment:
        """Where the surface points lie over their links; those that lie on no tube are left out."""
        start = self.points[link]
        way = self.points[link + 1] - start
        offset = self.surface[point] - start
        square = np.maximum(np.vecdot(way, way), 1e-18)
        along = np.vecdot(offset, way) / square
        share = np.clip(along, 0.0, 1.0)
        outward = offset - share[:, None] * way
        distance = np.sqrt(np.vecdot(outward, outward))
        outward /= np.maximum(distance, 1e-12)[:, None]
        residual = distance - self.radii[self.strand[link]]
        beside = np.abs(along - share) * np.sqrt(square) <= BEYOND_SHARE * self.r
        on = (np.abs(residual) < NEAR_SHARE * self.r) & beside
        on &= np.vecdot(outward, self.normals[point]) > SAME_SIDE
        residual = residual[on]
        sigma = max(1.4826 * float(np.median(np.abs(residual))), SIGMA_FLOOR * self.r) if len(residual) else self.r
        weight = np.maximum(1 - (residual / (CUT_SIGMAS * sigma)) ** 2, 0.0) ** 2
        return Assignment(point[on], link[on], share[on], outward[on], residual, weight, sigma)

    def _tangents(self) -> Points:
        """(N, 3) unit vectors along the lines."""
        ahead = np.where(np.append(self._is_link[:-1], False), 1, 0) + np.arange(len(self.points))
        behind = np.arange(len(self.points)) - np.where(np.insert(self._is_link[:-1], 0, False), 1, 0)
        way = self.points[ahead] - self.points[behind]
        return way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)

    def _slopes(self, assigned: Assignment) -> csr_array:
        """(K, 3N) derivative of the residuals by the points' coordinates."""
        shares = np.column_stack([1 - assigned.share, assigned.share])
        values = -(shares[:, :, None] * assigned.outward[:, None, :]).ravel()
        columns = (3 * assigned.link[:, None] + np.arange(6)).ravel()
        starts = 6 * np.arange(len(assigned.link) + 1)
        return csr_array((values, columns, starts), shape=(len(assigned.link), 3 * len(self.points)))


def _bending(starts: NDArray[np.int64], r: float) -> csr_array:
    """(3N, 3N) price of the second differences within each line, as a quadratic form."""
    count = int(starts[-1])
    inner = np.setdiff1d(np.arange(count), np.concatenate([starts[:-1], starts[1:] - 1]))
    columns = (inner[:, None] + (-1, 0, 1)).ravel()
    D = csr_array((np.tile((1.0, -2.0, 1.0), len(inner)), columns, 3 * np.arange(len(inner) + 1)), (len(inner), count))
    return csr_array(kron(D.T @ D, eye_array(3)) * (BEND_SHARE * r) ** -2.0)
