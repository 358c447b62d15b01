"""Refinement: fit each centre line so that the measured surface is one radius away from the line."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, close_polyline, points_at, unit_vectors
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.support_surface import SupportSurface
from recognition.refinement.border_offset import measure_border_offset
from recognition.refinement.cross_section import CrossSections, measure_cross_sections
from recognition.refinement.end_merging import merge_overlapping_ends
from recognition.refinement.line_ends import localise_line_ends, localise_line_ends_in_images
from recognition.refinement.resting_height import add_lost_height, find_resting_heights
from recognition.refinement.tube_fit import Assignment, TubeFit
from recognition.refinement.visible_gaps import split_at_visible_gaps
from recognition.strand import Strand

Points = NDArray[np.float64]

STEP_RADII = 0.7
"""Spacing of the fitted points, in radii r."""
SAMPLE_STRIDE = 2
"""Stride of the surface points in the first fit. Every second point is enough to measure radii and move the lines."""
FIRST_FIT_STEPS = (2, 1)
"""Number of Gauss-Newton steps in each group of the first fit. Each group begins with a new assignment."""
LAST_FIT_STEPS = (2,)
"""Number of Gauss-Newton steps in each group of the last fit. The last step moves a line by micrometres only."""
EXCESS_SIGMA_SHARE = 0.5
"""Standard deviation of the excess height of resting strings that was removed, as a share of it."""
REST_STEPS = 2
"""Number of Gauss-Newton steps with the heights of resting strings."""
RADIUS_SIGMA_SHARE = 0.3
"""Standard deviation of the prior on the radius of a string, as a share of r. The prior has the mean r."""
MAX_DEVIATION_SHARE = 0.12
"""Maximum difference between measured radius and r, as a share of r. Within this limit, the tube has the radius r."""
MAX_DEVIATION_SCATTERS = 0.8
"""The limit `MAX_DEVIATION_SHARE`, but as a multiple of the surface scatter. The larger of the two limits applies.

With a scatter of r / 4, a measured radius has an error of about r / 6. This error also displaces the line.
"""
RESTING_PERCENTILE = 20.0
"""Percentile of the heights along a string. At this height, the string is assumed to rest on the table."""
LOWEST_PERCENTILE = 5.0
"""Percentile of the heights along a string of its lowest part, without outliers."""
MAX_RESTING_SPREAD_SHARE = 0.08
"""Maximum difference of the radii from both percentiles, as a share of the fitted radius. A string is equally high
wherever it rests, but not where it hangs between others in a heap. The limit is below `MAX_DEVIATION_SHARE`, so that a
hanging string seems not to contradict r."""
MAX_RESTING_EXCESS_SHARE = 0.2
"""Maximum share by which the radius from the height above the table may exceed the fitted radius."""
MIN_RADIUS_SHARE = 0.4
"""Minimum radius from the height above the table, as a share of r. Below this limit, the fitted radius is used."""
MIN_SEEN_SUPPORT_SHARE = 0.1
"""Minimum support of an observed point, as a share of the median support of the strand. Other points are bridged."""
MAX_MERGES = 3
"""Maximum number of passes that merge overlapping ends. One pass is usually enough."""
SEAM_OVERLAP = 8
"""Number of points by which a closed line overlaps itself in the fit. The seam is then fitted like the other points."""


@dataclass(frozen=True, eq=False)
class FittedStrand:
    """A strand after the tube fit."""

    points: Points
    """(N, 3) points of the centre line, about `STEP_RADII` r apart, metres, base frame."""
    closed: bool
    """Whether the last point connects to the first."""
    bridged: NDArray[np.bool_]
    """(N,) mask, True where hardly any surface supports the point (`MIN_SEEN_SUPPORT_SHARE`)."""
    support: NDArray[np.float64]
    """(N,) sum of the weights of the surface points that support each point."""
    radius_m: float
    """Radius of the tube, metres: r, or the measured radius if the measured radius contradicts r."""
    measured_radius_m: float
    """Measured radius, metres: from the height if the strand rests on the table, otherwise from the first tube fit."""
    roundness_error_m: float
    """Standard deviation of the mean profile from a circle, corrected for noise, metres."""
    squareness: float
    """Share of a square bar's profile in the strand's profile: 0 for a tube, 1 for a bar with sharp edges."""
    squareness_sigma: float
    """Standard error of the squareness; infinite if the squareness cannot be measured."""
    height_sigma_m: float = 0.0
    """Standard deviation of the heights of resting strings in the scene, metres; 0 if too few of them rest."""


@dataclass(frozen=True, eq=False)
class _Surface:
    """Registered surface."""

    points: Points
    """(M, 3) surface points, metres, base frame."""
    normals: Points
    """(M, 3) outward unit normals."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """All fitted strands of a scene, and the strand of each surface point."""

    strands: list[FittedStrand]
    """Fitted strands."""
    strand_of_point: NDArray[np.int64]
    """(M,) strand index of each surface point; -1 if the point lies on no tube."""
    scatter_m: float
    """Robust standard deviation of the point-to-tube distances, metres."""
    lost_m: float = 0.0
    """Height that was added to resting strings, metres. It is negative if they were lowered."""
    border_offset_m: float = 0.0
    """Distance by which ends were moved inwards because windows widen strings, metres. It is negative if outwards."""


def refine(
    strands: Sequence[Strand],
    surface: Points,
    normals: Points,
    parameters: ChainParameters,
    support: SupportSurface | None = None,
    views: Sequence[NormalCloud] = (),
    radius_is_given: bool = True,
    other_lines: Sequence[Points] = (),
    bends: Points | None = None,
) -> Refinement:
    """Fit the strands to the surface: measure radii, localise ends and measure cross-sections.

    Each centre line is a polyline. The fit minimises the squared distances between the surface points and the tube of
    the line, with robust weights and a bending penalty. Surface points that lie on no tube have no weight.

    Args:
        strands: Traced strands. Strands of one point are dropped.
        surface: (M, 3) registered surface points, metres, base frame.
        normals: (M, 3) outward unit normals.
        parameters: Method parameters; uses the radius r, the length r_f of an end and the spacing r_n of bridges.
        support: What the strings rest on. None means a table at z = 0.
        views: Registered views. Their depth images show the ends of the strings. Without views, an end is where the
            surface ends.
        radius_is_given: Whether r is the given radius. If it is only a rough one, each tube has its measured radius.
        other_lines: (K, 3) centre lines of other strings near the strands, metres, base frame.
        bends: (B, 3) points of the hidden bends of the strands, metres, base frame; None for none.

    Returns:
        The fitted strands, the strand index of each surface point, and the scatter of the surface about the tubes. The
        result has no strands if `surface` is empty.

    Source:
        The fit is not in the paper. It replaces the means of eqs. (2) and (3), which are biased towards the seen
        surface: upwards, because the underside is hidden, and inwards in bends.
    """
    r = parameters.r
    support = support or SupportSurface()
    measured = _Surface(surface, normals)
    n_merges = 0
    while True:
        strands = [strand for strand in strands if len(strand.points) > 1]
        if not strands or len(surface) == 0:
            return Refinement([], np.full(len(surface), -1), 0.0)
        first_fit, scatter_m = _fit_to_sample(strands, measured, r, bends)
        measured_radii = _measure_radii(first_fit, support)
        radii = measured_radii
        if radius_is_given:
            radii = _select_radii(measured_radii, scatter_m, r)
        lines = _lines_of_radii(first_fit, radii)
        floors = _floors(lines, radii, support)
        lost_m = find_resting_heights(lines, radii, floors, r, support.scatter_m).lost_m
        raised = _raise(measured, support.table_z_m, 2 * r, lost_m)
        lines = [
            _raise_line(line, radius, support.table_z_m, lost_m) for line, radius in zip(lines, radii, strict=True)
        ]
        lines = localise_line_ends(strands, TubeFit(lines, r, raised.points, raised.normals, radii))
        if n_merges >= MAX_MERGES:
            break
        # Joined and split strands are fitted again from the start.
        located = _replace_lines(strands, lines)
        changed = merge_overlapping_ends(located, parameters)
        if changed is None:
            changed = split_at_visible_gaps(located, radii, surface, views)
        if changed is None:
            break
        strands = changed
        n_merges += 1
    offset_m = 0.0
    if any(not strand.closed for strand in strands):
        offset_m = measure_border_offset(lines, radii, views, support.table_z_m, r)
    lines = localise_line_ends_in_images(strands, lines, radii, views, other_lines, offset_m)

    last_fit = TubeFit(lines, r, raised.points, raised.normals, radii, bends)
    assigned = _iterate(last_fit, LAST_FIT_STEPS, None)
    cross_sections = measure_cross_sections(last_fit, assigned, of_any_circle=support.is_matched)
    # support and residuals stay those of the surface alone
    ripple_m = _pull_to_rest(last_fit, assigned, support)
    height_sigma_m = float(np.hypot(ripple_m, EXCESS_SIGMA_SHARE * min(lost_m, 0.0)))
    fitted = _collect_strands(strands, last_fit, assigned, measured_radii, cross_sections)
    fitted = [replace(strand, height_sigma_m=height_sigma_m) for strand in fitted]
    return Refinement(
        strands=fitted,
        strand_of_point=last_fit.lines_of_points(assigned),
        scatter_m=assigned.sigma,
        lost_m=lost_m,
        border_offset_m=offset_m,
    )


def _fit_to_sample(
    strands: Sequence[Strand], surface: _Surface, r: float, bends: Points | None
) -> tuple[TubeFit, float]:
    """Fit lines and radii to every second surface point. Return the fit and the sigma of its residuals, metres."""
    lines = [_resample_evenly(strand, r) for strand in strands]
    fit = TubeFit(lines, r, surface.points[::SAMPLE_STRIDE], surface.normals[::SAMPLE_STRIDE], bends=bends)
    assigned = _iterate(fit, FIRST_FIT_STEPS, RADIUS_SIGMA_SHARE * r)
    return fit, assigned.sigma


def _lines_of_radii(fit: TubeFit, radii: NDArray[np.float64]) -> list[Points]:
    """Return the fitted lines, moved vertically so that the tops of their tubes stay with the given radii (K,)."""
    moved = []
    for line, fitted, radius in zip(fit.lines, fit.radii, radii, strict=True):
        moved.append(line + (0.0, 0.0, float(fitted - radius)))
    return moved


def _floors(lines: Sequence[Points], radii: NDArray[np.float64], support: SupportSurface) -> NDArray[np.float64]:
    """Return the height (K,) of what each line rests on, metres."""
    return np.array([support.height_under(line, float(radius)) for line, radius in zip(lines, radii, strict=True)])


def _raise(surface: _Surface, table_z_m: float, top_m: float, lost_m: float) -> _Surface:
    """Return the surface with the height that resting strings lost (see `add_lost_height`), and its normals."""
    points = surface.points.copy()
    points[:, 2] = add_lost_height(points[:, 2], table_z_m, top_m, lost_m)
    # heights below the top are stretched, which turns normals to the sides
    is_stretched = surface.points[:, 2] - table_z_m < top_m - lost_m
    normals = surface.normals.copy()
    normals[is_stretched, 2] *= (top_m - lost_m) / top_m
    return _Surface(points, unit_vectors(normals))


def _raise_line(line: Points, radius_m: float, table_z_m: float, lost_m: float) -> Points:
    """Return a centre line, with the top of its tube raised by the height that resting strings lost."""
    raised = line.copy()
    raised[:, 2] = add_lost_height(line[:, 2] + radius_m, table_z_m, 2 * radius_m, lost_m) - radius_m
    return raised


def _pull_to_rest(fit: TubeFit, assigned: Assignment, support: SupportSurface) -> float:
    """Pull the lines to one radius above what they rest on, where they rest.

    Return the standard deviation of their heights there before, metres.
    """
    resting = find_resting_heights(fit.lines, fit.radii, _floors(fit.lines, fit.radii, support), fit.r)
    for _ in range(REST_STEPS):
        fit.step(assigned, None, resting)
        assigned = fit.update_assignment(assigned)
    return resting.ripple_m


def _measure_radii(fit: TubeFit, support: SupportSurface) -> NDArray[np.float64]:
    """Return the measured radius (K,) of each string, metres.

    Where a string rests on the table or on a large object, its radius is half the height of its top above it. This
    radius is more accurate than the fitted radius: flying pixels at the rims and noise along the line of sight change
    the fitted radius by up to 10 %. If half the height of the top exceeds the fitted radius by more than
    `MAX_RESTING_EXCESS_SHARE`, or if the lowest part of the string is much lower than that, the string does not rest on
    it. The fitted radius is then used.
    """
    measured = fit.radii.copy()
    for k, (line, radius) in enumerate(zip(fit.lines, fit.radii, strict=True)):
        top = line[:, 2] + radius - support.height_under(line, float(radius))
        lowest, resting = np.percentile(top, (LOWEST_PERCENTILE, RESTING_PERCENTILE)) / 2
        is_level = resting - lowest < MAX_RESTING_SPREAD_SHARE * radius
        if is_level and resting < radius * (1 + MAX_RESTING_EXCESS_SHARE):
            measured[k] = resting
    # A very small radius shows a wrong table height. The fitted radius does not depend on the table.
    return np.where(measured > MIN_RADIUS_SHARE * fit.r, measured, fit.radii)


def _select_radii(measured: NDArray[np.float64], scatter_m: float, r: float) -> NDArray[np.float64]:
    """Return the tube radius (K,) of each line, metres: the measured radius if it contradicts r, otherwise r."""
    contradicts = np.abs(measured - r) > max(MAX_DEVIATION_SHARE * r, MAX_DEVIATION_SCATTERS * scatter_m)
    return np.where(contradicts, measured, r)


def _replace_lines(strands: Sequence[Strand], lines: Sequence[Points]) -> list[Strand]:
    """Return the strands with fitted lines in place of the traced lines. Closed strands are unchanged."""
    replaced = list(strands)
    for k, line in enumerate(lines):
        if not strands[k].closed:
            replaced[k] = Strand(line, np.zeros(len(line), dtype=bool))
    return replaced


def _iterate(fit: TubeFit, groups: Sequence[int], radius_sigma: float | None) -> Assignment:
    """Run groups of Gauss-Newton steps and return the last assignment of the surface points.

    Args:
        fit: Tube fit; its lines and radii are changed in place.
        groups: Number of steps in each group. Each group begins with a new assignment.
        radius_sigma: Standard deviation of the prior on the radii, metres. None keeps the radii fixed.
    """
    assigned = None
    for n_steps in groups:
        assigned = fit.assign()
        for _ in range(n_steps):
            fit.step(assigned, radius_sigma)
            assigned = fit.update_assignment(assigned)
    return assigned or fit.assign()


def _resample_evenly(strand: Strand, r: float) -> Points:
    """Resample the line of a strand in even steps. A closed line overlaps itself by `SEAM_OVERLAP` points."""
    points = close_polyline(strand.points, strand.closed)
    length = float(arc_length(points)[-1])
    n_steps = max(round(length / (STEP_RADII * r)), 2)
    line = points_at(points, np.linspace(0.0, length, n_steps + 1))
    if strand.closed:
        line = np.vstack([line, line[1 : SEAM_OVERLAP + 1]])
    return line


def _collect_strands(
    strands: Sequence[Strand],
    fit: TubeFit,
    assigned: Assignment,
    measured_radii: NDArray[np.float64],
    cross_sections: CrossSections,
) -> list[FittedStrand]:
    """Collect the results for each strand. The self-overlap of closed lines is removed."""
    all_support = fit.support(assigned)
    fitted = []
    for k, strand in enumerate(strands):
        rows = fit.rows(k)
        if strand.closed:
            # Cut in the middle of the overlap, far from the two ends of the fitted line.
            first = rows.start + SEAM_OVERLAP // 2
            n_points = rows.stop - rows.start - 1 - SEAM_OVERLAP
            rows = slice(first, first + n_points)
        support = all_support[rows]
        fitted.append(
            FittedStrand(
                points=fit.points[rows],
                closed=strand.closed,
                bridged=support < MIN_SEEN_SUPPORT_SHARE * np.median(support),
                support=support,
                radius_m=float(fit.radii[k]),
                measured_radius_m=float(measured_radii[k]),
                roundness_error_m=float(cross_sections.roundness_error_m[k]),
                squareness=float(cross_sections.squareness[k]),
                squareness_sigma=float(cross_sections.squareness_sigma[k]),
            )
        )
    return fitted
