"""Cross-sections of fitted tubes: measures of how round the surface about a tube is.

The profile of a line is the distance of the surface from its tube as a function of the angle from the top.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import group_sums
from recognition.geometry.polyline import unit_vectors
from recognition.refinement.tube_fit import Assignment, TubeFit

MAX_PROFILE_SINE = 0.85
"""Maximum sine of the angle from the top in a profile. At larger angles, errors at the rims disturb the profile."""
N_SECTORS = 9
"""Number of sectors of a profile."""
SECTOR_SINES = MAX_PROFILE_SINE * (2 * np.arange(N_SECTORS) + 1 - N_SECTORS) / N_SECTORS
"""(N_SECTORS,) sines of the angles from the top in the middle of the sectors."""
MIN_SECTOR_POINTS = 10
"""Minimum number of surface points in a filled sector. The other sectors are not used."""
SECTION_LINKS = 6
"""Number of links in a section. A section is about 4 r long.

The depth errors of two sections are independent, so each section counts as one measurement.
"""
MIN_SECTIONS = 3
"""Minimum number of sections with surface points for a standard error of the squareness."""


@dataclass(frozen=True, eq=False)
class CrossSections:
    """Measures of the cross-section of each line of a fit."""

    roundness_error_m: NDArray[np.float64]
    """(K,) standard deviation of the mean profile from a circle, corrected for noise, metres."""
    squareness: NDArray[np.float64]
    """(K,) share of a square bar's profile in the line's profile: 0 for a tube, 1 for a bar with sharp edges."""
    squareness_sigma: NDArray[np.float64]
    """(K,) standard error of the squareness; infinite if the squareness cannot be measured."""


@dataclass(frozen=True, eq=False)
class _ProfilePoints:
    """P surface points on the upper part of the tubes."""

    sine: NDArray[np.float64]
    """(P,) sine of the angle of each point from the top."""
    link: NDArray[np.int64]
    """(P,) link of each point, as in `Assignment.link`."""
    residual: NDArray[np.float64]
    """(P,) signed distance of each point from the tube, metres; positive outside the tube."""


def measure_cross_sections(fit: TubeFit, assigned: Assignment, of_any_circle: bool = False) -> CrossSections:
    """Measure how round the surface about each line is, from the upper part of the mean profile of the line.

    Args:
        fit: Tube fit with K lines.
        assigned: Assignment of the surface points to the lines.
        of_any_circle: Whether the roundness error is that from the best circle of any radius and position. Matching
            windows change the radius of a profile, so that a stereo camera does not show that of the tube.

    Returns:
        The measures of each line.
    """
    vector = fit.points[assigned.link + 1] - fit.points[assigned.link]
    left = unit_vectors(np.column_stack([-vector[:, 1], vector[:, 0]]))
    sine = (assigned.outward[:, :2] * left).sum(axis=1)
    is_inner = np.abs(sine) < MAX_PROFILE_SINE
    points = _ProfilePoints(sine[is_inner], assigned.link[is_inner], assigned.residual[is_inner])
    out_of_round = _measure_out_of_round(fit, points, assigned.sigma, of_any_circle)
    squareness, squareness_sigma = _measure_squareness(fit, points)
    return CrossSections(out_of_round, squareness, squareness_sigma)


def _measure_out_of_round(
    fit: TubeFit, profile: _ProfilePoints, sigma: float, of_any_circle: bool
) -> NDArray[np.float64]:
    """Return the standard deviations (K,) of the mean profiles from a circle, metres, corrected for noise.

    If fewer than half of the sectors are filled, as for a wall, the result is the radius of the line. `sigma` is the
    standard deviation of the residuals, metres.

    The noise of a sector is that of independent points or, if it is larger, that of the means of the sections, because
    neighbouring pixels share their errors.
    """
    sector = ((profile.sine / MAX_PROFILE_SINE + 1) / 2 * N_SECTORS).astype(np.int64)
    first = _first_sections(fit)
    section = _sections(fit, first, profile.link)
    n_sections = int(first[-1])
    cell = section * N_SECTORS + sector
    shape = (n_sections, N_SECTORS)
    counts = np.bincount(cell, minlength=n_sections * N_SECTORS).reshape(shape)
    sums = group_sums(cell, profile.residual, n_sections * N_SECTORS).reshape(shape)
    out_of_round = np.empty(len(fit.radii))
    for k, radius in enumerate(fit.radii):
        rows = slice(int(first[k]), int(first[k + 1]))
        points = counts[rows].sum(axis=0)
        is_filled = points >= MIN_SECTOR_POINTS
        if 2 * is_filled.sum() <= N_SECTORS:
            out_of_round[k] = radius
            continue
        means = sums[rows].sum(axis=0)[is_filled] / points[is_filled]
        independent = sigma**2 / points[is_filled]
        shared = _squared_errors(sums[rows][:, is_filled], counts[rows][:, is_filled], means)
        noise = float(np.maximum(independent, shared).mean())
        if of_any_circle:
            means = _without_circle(SECTOR_SINES[is_filled], means)
        out_of_round[k] = np.sqrt(max(float(means.var()) - noise, 0.0))
    return out_of_round


def _without_circle(sine: NDArray[np.float64], means: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a profile (S,) without what another radius and another position explain."""
    circle = np.column_stack([np.ones_like(sine), sine, np.sqrt(1 - sine**2)])
    return means - circle @ np.linalg.lstsq(circle, means, rcond=None)[0]


def _squared_errors(
    sums: NDArray[np.float64], counts: NDArray[np.int64], means: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the squared standard errors (S,) of the means of S sectors, from the scatter between the sections.

    Args:
        sums: (N, S) sums of the residuals of each section and sector, metres.
        counts: (N, S) numbers of points.
        means: (S,) means of the sectors, metres.
    """
    n_sections = len(sums)
    if n_sections < MIN_SECTIONS:
        return np.zeros(len(means))
    remainder = (sums - counts * means) / counts.sum(axis=0)
    return np.asarray((remainder**2).sum(axis=0) * n_sections / (n_sections - 1), dtype=np.float64)


def _first_sections(fit: TubeFit) -> NDArray[np.int64]:
    """Return the numbers (K + 1,) of the first section of each line. The last section of a line may be shorter."""
    return np.concatenate([[0], np.cumsum(-(-np.diff(fit.starts) // SECTION_LINKS))])


def _sections(fit: TubeFit, first: NDArray[np.int64], link: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number (P,) of the section of each link (P,)."""
    line = fit.line_of_point[link]
    return np.asarray(first[line] + (link - fit.starts[line]) // SECTION_LINKS, dtype=np.int64)


def _measure_squareness(fit: TubeFit, profile: _ProfilePoints) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the squareness (K,) of each line, and its standard error (K,).

    A least-squares fit explains the residuals by four functions of the angle from the top. A constant stands for an
    error of the radius. The cosine and the sine stand for an error of the position. The fourth function is the profile
    of a square bar, `1 / max(cos, abs(sin))`. Its coefficient is the squareness.

    The standard error comes from the scatter between sections, because neighbouring pixels share their errors.
    """
    sine = profile.sine
    cosine = np.sqrt(np.maximum(1 - sine**2, 0.0))
    terms = np.column_stack([np.ones_like(sine), cosine, sine, 1 / np.maximum(cosine, np.abs(sine))])
    first = _first_sections(fit)
    line = fit.line_of_point[profile.link]
    section = _sections(fit, first, profile.link)
    products = np.column_stack([terms * term[:, None] for term in terms.T])
    A = group_sums(section, products, first[-1]).reshape(-1, 4, 4)
    b = group_sums(section, terms * (profile.residual / fit.radii[line])[:, None], first[-1])
    squareness = np.zeros(len(fit.radii))
    sigma = np.full(len(fit.radii), np.inf)
    for k in range(len(fit.radii)):
        # The first term is constant, so its entry is the number of surface points of the section.
        rows = np.flatnonzero(A[first[k] : first[k + 1], 0, 0]) + first[k]
        if len(rows) < MIN_SECTIONS:
            continue
        inverse = np.linalg.pinv(A[rows].sum(axis=0), hermitian=True)
        solved = inverse @ b[rows].sum(axis=0)
        remainder = (b[rows] - A[rows] @ solved) @ inverse[:, 3]
        squareness[k] = solved[3]
        sigma[k] = np.sqrt((remainder**2).sum() * len(rows) / (len(rows) - 1))
    return squareness, sigma
