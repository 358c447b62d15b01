"""Cross-sections of fitted tubes: whether the surface about a tube is round, from its profile."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import group_sums
from recognition.geometry.polyline import unit_vectors
from recognition.refinement.tube_fit import Assignment, TubeFit

MAX_PROFILE_SINE = 0.85
"""Maximum sine of the angle from the top within which the profile is taken. Beyond it, rims disturb the profile."""
N_SECTORS = 9
"""Number of sectors of the profile."""
MIN_SECTOR_POINTS = 10
"""Minimum number of surface points in a sector. The mean of fewer points is not used."""
SECTION_LINKS = 6
"""Number of links of a section, about 4 r.

The depth errors of two sections are independent, so each section counts as one measurement.
"""
MIN_SECTIONS = 3
"""Minimum number of sections for a standard error."""


@dataclass(frozen=True, eq=False)
class CrossSections:
    """Measures of the cross-section of each line of a fit."""

    out_of_round_m: NDArray[np.float64]
    """(K,) standard deviation of the mean profile about the tube, without the part from noise, metres."""
    squareness: NDArray[np.float64]
    """(K,) share of a square bar's profile in the line's profile: 0 for a tube, 1 for a bar with sharp edges."""
    squareness_sigma: NDArray[np.float64]
    """(K,) one sigma of the squareness; infinite if it cannot be measured."""


def measure_cross_sections(fit: TubeFit, assigned: Assignment) -> CrossSections:
    """Return how round the surface about each line is, from the upper part of its profile over its whole length.

    Args:
        fit: Tube fit with K lines.
        assigned: Assignment of the surface to the lines.

    Returns:
        The measures of each line.

    Source:
        Ours.
    """
    vector = fit.points[assigned.link + 1] - fit.points[assigned.link]
    left = unit_vectors(np.column_stack([-vector[:, 1], vector[:, 0]]))
    sine = (assigned.outward[:, :2] * left).sum(axis=1)
    is_inner = np.abs(sine) < MAX_PROFILE_SINE
    link, residual = assigned.link[is_inner], assigned.residual[is_inner]
    out_of_round = _measure_out_of_round(fit, sine[is_inner], link, residual, assigned.sigma)
    squareness, squareness_sigma = _measure_squareness(fit, sine[is_inner], link, residual)
    return CrossSections(out_of_round, squareness, squareness_sigma)


def _measure_out_of_round(
    fit: TubeFit, sine: NDArray[np.float64], link: NDArray[np.int64], residual: NDArray[np.float64], sigma: float
) -> NDArray[np.float64]:
    """Return (K,) the deviation of the profiles from a circle, metres.

    If less than half of the sectors are filled, as for a wall, it is the radius. A string fills more of them.
    """
    sector = ((sine / MAX_PROFILE_SINE + 1) / 2 * N_SECTORS).astype(np.int64)
    shape = (len(fit.radii), N_SECTORS)
    cell, count = fit.line_of_point[link] * N_SECTORS + sector, shape[0] * N_SECTORS
    points = np.bincount(cell, minlength=count).reshape(shape)
    means = group_sums(cell, residual, count).reshape(shape) / np.maximum(points, 1)
    is_filled = points >= MIN_SECTOR_POINTS
    share = is_filled / np.maximum(is_filled.sum(axis=1, keepdims=True), 1)
    variance = (share * means**2).sum(axis=1) - (share * means).sum(axis=1) ** 2
    noise = (share * sigma**2 / np.maximum(points, 1)).sum(axis=1)
    is_seen = 2 * is_filled.sum(axis=1) > N_SECTORS
    return np.where(is_seen, np.sqrt(np.maximum(variance - noise, 0.0)), fit.radii)


def _measure_squareness(
    fit: TubeFit, sine: NDArray[np.float64], link: NDArray[np.int64], residual: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (K,) the squareness of the lines, and (K,) one sigma of it.

    Least squares explains the residuals by four terms: a constant for a wrong radius, the cosine and sine of the angle
    from the top for a wrong position, and the profile of a square bar, whose faces are 1 / cos and 1 / sin of the angle
    away from its axis. A wrong radius or position of a round string therefore does not count as squareness.

    The standard error comes from the scatter between the sections, because neighbouring pixels share their errors.
    """
    n_lines = len(fit.radii)
    cosine = np.sqrt(np.maximum(1 - sine**2, 0.0))
    terms = np.column_stack([np.ones_like(sine), cosine, sine, 1 / np.maximum(cosine, np.abs(sine))])
    first = np.concatenate([[0], np.cumsum(-(-np.diff(fit.starts) // SECTION_LINKS))])
    line = fit.line_of_point[link]
    section = first[line] + (link - fit.starts[line]) // SECTION_LINKS
    products = np.column_stack([terms[:, i] * terms[:, j] for i in range(4) for j in range(4)])
    A = group_sums(section, products, first[-1]).reshape(-1, 4, 4)
    b = group_sums(section, terms * (residual / fit.radii[line])[:, None], first[-1])
    squareness, sigma = np.zeros(n_lines), np.full(n_lines, np.inf)
    for k in range(n_lines):
        rows = np.flatnonzero(A[first[k] : first[k + 1], 0, 0]) + first[k]
        if len(rows) < MIN_SECTIONS:
            continue
        inverse = np.linalg.pinv(A[rows].sum(axis=0), hermitian=True)
        solved = inverse @ b[rows].sum(axis=0)
        remainder = (b[rows] - A[rows] @ solved) @ inverse[:, 3]
        squareness[k] = solved[3]
        sigma[k] = np.sqrt((remainder**2).sum() * len(rows) / (len(rows) - 1))
    return squareness, sigma
