"""Refinement: centre lines fitted so that the measured surface is one radius away from them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, close_polyline, points_at
from recognition.parameters import ChainParameters
from recognition.refinement.cross_section import CrossSections, measure_cross_sections
from recognition.refinement.end_localisation import localise_end
from recognition.refinement.end_merging import merge_overlapping_ends
from recognition.refinement.tube_fit import Assignment, TubeFit
from recognition.strand import Strand

Points = NDArray[np.float64]

STEP_RADII = 0.7
"""Distance of the fitted points, in radii."""
SAMPLE_STRIDE = 2
"""Every second surface point is used for the first fit. It is enough to bring the lines near and to measure radii."""
FIRST_FIT_STEPS = (2, 1)
"""Number of Gauss-Newton steps of the first fit. The surface is assigned to the lines again before each group."""
LAST_FIT_STEPS = (2,)
"""Number of steps of the last fit. It starts near its solution: the last step moves a line by micrometres."""
RADIUS_SIGMA_SHARE = 0.3
"""One sigma of the difference between a string's radius and the expected r, as a share of r."""
MAX_DEVIATION_SHARE = 0.12
"""A measured radius that differs from r by at most this share of r does not contradict r, and r is used."""
MAX_DEVIATION_SCATTERS = 0.8
"""The same limit as a multiple of the surface scatter; the larger of the two limits applies.

Where the scatter is a quarter of the radius, measured radii are a sixth off, and the lines with them.
"""
RESTING_PERCENTILE = 20.0
"""Percentile of the heights of a string's points that is taken for the part that rests on the table."""
MAX_RESTING_EXCESS_SHARE = 0.2
"""Share by which the radius from the height above the table may exceed the radius of the fitted tube."""
MIN_RADIUS_SHARE = 0.4
"""Minimum radius, as a share of r. With the limits that r sets, a thinner string cannot be distinguished from noise."""
MIN_SUPPORT_SHARE = 0.1
"""A point of a line with less than this share of the median support was not seen. It is bridged."""
MAX_MERGES = 3
"""Maximum number of times that overlapping ends are merged. Each time merges all of them, so one is usually enough."""
SEAM_OVERLAP = 8
"""Number of points by which a closed strand overlaps itself, so that its seam is fitted like any other part."""


@dataclass(frozen=True, eq=False)
class FittedStrand:
    """A strand whose tube was fitted to the surface."""

    points: Points
    """(N, 3) points about `STEP_RADII` r apart, metres, base frame."""
    closed: bool
    """Whether the last point connects to the first."""
    bridged: NDArray[np.bool_]
    """(N,) mask of the points that no surface supports."""
    support: NDArray[np.float64]
    """(N,) weight of the surface points that support each point."""
    radius_m: float
    """Radius of the tube, metres: r, or the measured radius if it contradicts r."""
    measured_radius_m: float
    """Radius from the height where the strand rests on the table, otherwise from the first tube fit, metres."""
    out_of_round_m: float
    """Standard deviation of the mean profile about the tube, without the part from noise, metres."""
    squareness: float
    """Share of a square bar's profile in the strand's profile: 0 for a tube, 1 for a bar with sharp edges."""
    squareness_sigma: float
    """One sigma of the squareness; infinite if it cannot be measured."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """All fitted strands of a scene."""

    strands: list[FittedStrand]
    """Fitted strands."""
    owner: NDArray[np.int64]
    """(M,) index of the strand on whose tube each surface point lies, -1 for none."""
    scatter_m: float
    """One sigma of the distance of the surface from the tubes, metres."""


def refine(
    strands: Sequence[Strand],
    surface: Points,
    normals: Points,
    parameters: ChainParameters,
    table_z_m: float = 0.0,
    max_merges: int = MAX_MERGES,
) -> Refinement:
    """Return the strands fitted to the surface, with radii, localised ends and cross-sections.

    Each centre line is a polyline. Its points minimise the squared distance of the surface from the tube, with robust
    weights and a bending penalty. Points that lie on no tube, such as those of other objects, have no weight.

    Args:
        strands: Traced strands. Strands of one point are dropped.
        surface: (M, 3) registered surface points, metres, base frame.
        normals: (M, 3) outward unit normals.
        parameters: Radius r, and the radii for joining strands.
        table_z_m: Height of the table, metres.
        max_merges: Number of times that overlapping ends may still be merged.

    Returns:
        The fitted strands, the strand of each surface point, and the scatter of the surface. There are no strands if
        there is no surface.

    Source:
        Ours. It replaces the means of eqs. (2) and (3). These are drawn to where most of the surface was seen: upwards,
        away from the hidden underside, and inwards in bends.
    """
    r = parameters.r
    strands = [strand for strand in strands if len(strand.points) > 1]
    if not strands or len(surface) == 0:
        return Refinement([], np.full(len(surface), -1), 0.0)

    first_fit, scatter_m = _fit_to_sample(strands, surface, normals, r)
    measured_radii = _measure_radii(first_fit, table_z_m)
    radii = _select_radii(measured_radii, scatter_m, r)
    lines = _localise_ends(strands, first_fit.lines, radii, surface, normals, r)

    merged = merge_overlapping_ends(_replace_lines(strands, lines), parameters) if max_merges else None
    if merged is not None:
        return refine(merged, surface, normals, parameters, table_z_m, max_merges - 1)

    last_fit = TubeFit(lines, r, surface, normals, radii)
    assigned = _iterate(last_fit, LAST_FIT_STEPS, None)
    cross_sections = measure_cross_sections(last_fit, assigned)
    fitted = _collect_strands(strands, last_fit, assigned, measured_radii, cross_sections)
    return Refinement(fitted, last_fit.owners(assigned), assigned.sigma)


def _fit_to_sample(strands: Sequence[Strand], surface: Points, normals: Points, r: float) -> tuple[TubeFit, float]:
    """Return a fit of lines and radii to a part of the surface, and one sigma of its residuals, metres."""
    lines = [_resample_evenly(strand, r) for strand in strands]
    fit = TubeFit(lines, r, surface[::SAMPLE_STRIDE], normals[::SAMPLE_STRIDE])
    assigned = _iterate(fit, FIRST_FIT_STEPS, RADIUS_SIGMA_SHARE * r)
    return fit, assigned.sigma


def _measure_radii(fit: TubeFit, table_z_m: float) -> NDArray[np.float64]:
    """Return (K,) the radius of each line's string, metres.

    A string rests on the table somewhere, and there its top is 2 r above the table. The fit knows the top best: flying
    pixels at the rims, and noise along the line of sight, make the fitted radius up to a tenth too large or too small.
    Half the height of the top is therefore an upper bound of the radius. If it is much larger than the fitted radius,
    the string is raised, and the fitted radius counts.
    """
    measured = fit.radii.copy()
    for k, (line, radius) in enumerate(zip(fit.lines, fit.radii, strict=True)):
        top = line[:, 2] + radius - table_z_m
        resting = float(np.percentile(top, RESTING_PERCENTILE)) / 2
        if resting < radius * (1 + MAX_RESTING_EXCESS_SHARE):
            measured[k] = resting
    # If the table height is wrong, the heights give no radius.
    return np.where(measured > MIN_RADIUS_SHARE * fit.r, measured, fit.radii)


def _select_radii(measured: NDArray[np.float64], scatter_m: float, r: float) -> NDArray[np.float64]:
    """Return (K,) the measured radii where they contradict r, and r elsewhere, metres."""
    contradicts = np.abs(measured - r) > max(MAX_DEVIATION_SHARE * r, MAX_DEVIATION_SCATTERS * scatter_m)
    return np.where(contradicts, measured, r)


def _localise_ends(
    strands: Sequence[Strand],
    lines: Sequence[Points],
    radii: NDArray[np.float64],
    surface: Points,
    normals: Points,
    r: float,
) -> list[Points]:
    """Return the lines, with both ends of open strands moved to the ends of their strings."""
    fit = TubeFit(lines, r, surface, normals, radii)
    owner = fit.owners(fit.assign()) if len(lines) > 1 else np.zeros(len(surface), dtype=np.int64)
    localised = list(lines)
    for k, strand in enumerate(strands):
        if not strand.closed:
            # Surface on the tube of another strand does not show where this one ends.
            is_own = (owner == k) | (owner < 0)
            line = localise_end(lines[k], surface[is_own], normals[is_own], radii[k])
            localised[k] = localise_end(line[::-1], surface[is_own], normals[is_own], radii[k])[::-1]
    return localised


def _replace_lines(strands: Sequence[Strand], lines: Sequence[Points]) -> list[Strand]:
    """Return the strands after the lines of open strands are replaced by fitted lines. Closed strands stay."""
    return [
        strand if strand.closed else Strand(line, np.zeros(len(line), dtype=bool))
        for strand, line in zip(strands, lines, strict=True)
    ]


def _iterate(fit: TubeFit, groups: Sequence[int], radius_sigma: float | None) -> Assignment:
    """Run groups of Gauss-Newton steps, and return the last assignment of the surface."""
    assigned = None
    for n_steps in groups:
        assigned = fit.assign()
        for _ in range(n_steps):
            fit.step(assigned, radius_sigma)
            assigned = fit.update_assignment(assigned)
    return assigned or fit.assign()


def _resample_evenly(strand: Strand, r: float) -> Points:
    """Return the strand's line in even steps. A closed line overlaps itself by `SEAM_OVERLAP` points."""
    points = close_polyline(strand.points, strand.closed)
    length = float(arc_length(points)[-1])
    line = points_at(points, np.linspace(0.0, length, max(round(length / (STEP_RADII * r)), 2) + 1))
    return np.vstack([line, line[1 : SEAM_OVERLAP + 1]]) if strand.closed else line


def _collect_strands(
    strands: Sequence[Strand],
    fit: TubeFit,
    assigned: Assignment,
    measured_radii: NDArray[np.float64],
    cross_sections: CrossSections,
) -> list[FittedStrand]:
    """Return the fitted strands. The self-overlap of closed strands is removed."""
    all_support = fit.support(assigned)
    fitted = []
    for k, strand in enumerate(strands):
        points, support = fit.points[fit.rows(k)], all_support[fit.rows(k)]
        if strand.closed:
            # The cut is in the middle of the overlap, far from both ends of the fitted line.
            once = slice(SEAM_OVERLAP // 2, len(points) - 1 - SEAM_OVERLAP + SEAM_OVERLAP // 2)
            points, support = points[once], support[once]
        fitted.append(
            FittedStrand(
                points=points,
                closed=strand.closed,
                bridged=support < MIN_SUPPORT_SHARE * np.median(support),
                support=support,
                radius_m=float(fit.radii[k]),
                measured_radius_m=float(measured_radii[k]),
                out_of_round_m=float(cross_sections.out_of_round_m[k]),
                squareness=float(cross_sections.squareness[k]),
                squareness_sigma=float(cross_sections.squareness_sigma[k]),
            )
        )
    return fitted
