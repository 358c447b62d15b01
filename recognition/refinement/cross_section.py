"""Whether what tubes were fitted to is round: the profile of the surface about each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import group_sums
from recognition.refinement.tube_fit import Assignment, TubeFit

PROFILE_WIDTH = 0.85
"""Sine of the angle from the top within which the profile is taken: beyond, rims disturb it."""
SECTORS = 9
"""Parts of the profile."""
FEW_IN_SECTOR = 10
"""Fewer surface points in a part say nothing."""
STRETCH = 6
"""Links of a line between which errors of depth have nothing in common, some 4 r: that many make one measurement."""
FEW_STRETCHES = 3
"""Of fewer, no standard error can be told."""


@dataclass(frozen=True, eq=False)
class CrossSections:
    """Of each line of a fit."""

    out_of_round_m: NDArray[np.float64]
    """(K,) standard deviation of its mean profile about its tube, beyond what noise leaves of it."""
    squareness: NDArray[np.float64]
    """(K,) how much of a square bar's profile is in its own: 0 for a tube, 1 for a bar with sharp edges."""
    squareness_sigma: NDArray[np.float64]
    """(K,) one sigma of it; infinite where nothing can be told."""


def measure_cross_sections(fit: TubeFit, assigned: Assignment) -> CrossSections:
    """How round each line's surface is, from the upper part of its profile, over its whole length."""
    way = fit.points[assigned.link + 1] - fit.points[assigned.link]
    left = np.column_stack([-way[:, 1], way[:, 0]])
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12)
    side = (assigned.outward[:, :2] * left).sum(axis=1)
    inner = np.abs(side) < PROFILE_WIDTH
    link, residual = assigned.link[inner], assigned.residual[inner]
    out_of_round = _out_of_round(fit, side[inner], link, residual, assigned.sigma)
    return CrossSections(out_of_round, *_squareness(fit, side[inner], link, residual))


def _out_of_round(
    fit: TubeFit, side: NDArray[np.float64], link: NDArray[np.int64], residual: NDArray[np.float64], sigma: float
) -> NDArray[np.float64]:
    """The radius where less than half of the profile is seen, as of a wall: from its sides a string shows more."""
    sector = ((side / PROFILE_WIDTH + 1) / 2 * SECTORS).astype(np.int64)
    shape = (len(fit.radii), SECTORS)
    cell, count = fit.strand[link] * SECTORS + sector, shape[0] * SECTORS
    points = np.bincount(cell, minlength=count).reshape(shape)
    means = group_sums(cell, residual, count).reshape(shape) / np.maximum(points, 1)
    enough = points >= FEW_IN_SECTOR
    share = enough / np.maximum(enough.sum(axis=1, keepdims=True), 1)
    variance = (share * means**2).sum(axis=1) - (share * means).sum(axis=1) ** 2
    noise = (share * sigma**2 / np.maximum(points, 1)).sum(axis=1)
    return np.where(2 * enough.sum(axis=1) > SECTORS, np.sqrt(np.maximum(variance - noise, 0.0)), fit.radii)


def _squareness(
    fit: TubeFit, side: NDArray[np.float64], link: NDArray[np.int64], residual: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least squares: the residuals are those of a tube that is too thick or thin (a constant) or lies beside its place
    (sine and cosine of the angle from the top), and so much of a square bar's, whose faces are 1 / cos and 1 / sin of
    the angle away from its axis. That is told from a wrong radius or place, for which a round string must not pay.

    The standard error is that of the stretches' disagreement, since neighbouring pixels share their errors.
    """
    lines = len(fit.radii)
    top = np.sqrt(np.maximum(1 - side**2, 0.0))
    terms = np.column_stack([np.ones_like(side), top, side, 1 / np.maximum(top, np.abs(side))])
    first = np.concatenate([[0], np.cumsum(-(-np.diff(fit.starts) // STRETCH))])
    stretch = first[fit.strand[link]] + (link - fit.starts[fit.strand[link]]) // STRETCH
    products = np.column_stack([terms[:, i] * terms[:, j] for i in range(4) for j in range(4)])
    A = group_sums(stretch, products, first[-1]).reshape(-1, 4, 4)
    b = group_sums(stretch, terms * (residual / fit.radii[fit.strand[link]])[:, None], first[-1])
    squareness, sigma = np.zeros(lines), np.full(lines, np.inf)
    for k in range(lines):
        rows = np.flatnonzero(A[first[k] : first[k + 1], 0, 0]) + first[k]
        if len(rows) < FEW_STRETCHES:
            continue
        inverse = np.linalg.pinv(A[rows].sum(axis=0), hermitian=True)
        solved = inverse @ b[rows].sum(axis=0)
        left_over = (b[rows] - A[rows] @ solved) @ inverse[:, 3]
        squareness[k] = solved[3]
        sigma[k] = np.sqrt((left_over**2).sum() * len(rows) / (len(rows) - 1))
    return squareness, sigma
