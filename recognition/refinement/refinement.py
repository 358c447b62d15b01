"""Refinement: the centre line fitted so that the measured surface lies one radius from it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, close_polyline, points_at
from recognition.parameters import ChainParameters
from recognition.refinement.cross_section import measure_cross_sections
from recognition.refinement.end_localisation import localise_end
from recognition.refinement.end_merging import merge_overlapping_ends
from recognition.refinement.tube_fit import Assignment, TubeFit
from recognition.strand import Strand

STEP_SHARE = 0.7
"""Distance of the fitted points as a share of r."""
FIRST_LOOK = 2
"""Of so many surface points one is used for the first fit."""
STEPS = (2, 1)
"""Gauss-Newton steps of the first fit: after so many the surface is assigned to the lines anew."""
LAST_STEPS = (2,)
"""The same of the second fit, which begins near its end: the last step moves a line by micrometres."""
RADIUS_TIE_SHARE = 0.3
"""One sigma by which a string's radius may differ from the one told, as a share of it."""
SAME_RADIUS = 0.12
"""A measured radius within this share of the told one does not contradict it, and the told one holds, ..."""
SAME_AS_SCATTER = 0.8
"""... nor one within this share of the surface's scatter: where that is a quarter of the radius, radii come out a
sixth off, and lines with them."""
RESTING_PERCENTILE = 20.0
"""Of the heights of a string's points, the one taken for where it rests on the table."""
RESTING_AGREES = 0.2
"""Share by which the radius from the height above the table may exceed that of the fitted tube."""
LEAST_SHARE = 0.4
"""A string of less than this share of the told radius can't be told from noise with what that radius sets."""
BORNE_SHARE = 0.1
"""A point of a line with less than this share of the usual surface is not seen but bridged."""
MOST_JOINS = 3
"""Times that strands are joined where their ends meet: all that do are joined at once, so one is enough."""
OVERLAP = 8
"""Points by which a closed strand is continued beyond its seam, so that it is fitted there like elsewhere."""


@dataclass(frozen=True, eq=False)
class FittedStrand:
    """A strand whose tube fits the surface."""

    points: NDArray[np.float64]
    """(N, 3), `STEP_SHARE` r apart."""
    closed: bool
    bridged: NDArray[np.bool_]
    """(N,) points at which no surface bears the line."""
    support: NDArray[np.float64]
    """(N,) weight of the surface points that bear each."""
    radius_m: float
    """Of the tube."""
    measured_radius_m: float
    """By its height where it rests on the table, else that fits the surface best."""
    out_of_round_m: float
    """Standard deviation of its mean profile about the tube: noise averages out, an edge stays."""
    squareness: float
    """How much of a square bar's profile is in its own: 0 for a tube, 1 for a bar with sharp edges."""
    squareness_sigma: float
    """One sigma of it; infinite where nothing can be told."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """All strands of a scene, fitted."""

    strands: list[FittedStrand]
    owner: NDArray[np.int64]
    """(M,) for each surface point the strand on whose tube it lies, -1 for none."""
    scatter_m: float
    """One sigma of the surface's distance from the tubes."""


def refine(
    strands: Sequence[Strand],
    surface: NDArray[np.float64],
    normals: NDArray[np.float64],
    parameters: ChainParameters,
    table_z_m: float = 0.0,
    joins: int = MOST_JOINS,
) -> Refinement:
    """Strands fitted to the `surface` (M, 3) with outward `normals` (M, 3), above a table at `table_z_m`.

    The means of eqs. (2) and (3) are drawn to where most of the surface was seen: upwards, away from the hidden
    underside, and inwards in bends. Here each centre line is a polyline whose points minimise the squared distance
    of the surface from the tube about it (robust weights), with a price on bending. Points that lie on no tube, as
    those of other things, count nothing.

    Strands whose ends turn out to lie over one another are joined and fitted anew, at most `joins` times.

    Each string's radius is measured along (`_measured_radii`); where it does not contradict the told one, the told
    one is used.
    """
    r = parameters.r
    strands = [strand for strand in strands if len(strand.points) > 1]
    if not strands or len(surface) == 0:
        return Refinement([], np.full(len(surface), -1), 0.0)
    # A part of the surface is enough to bring the lines near and to measure radii.
    fit = TubeFit([_even(strand, r) for strand in strands], r, surface[::FIRST_LOOK], normals[::FIRST_LOOK])
    scatter = _settle(fit, STEPS, RADIUS_TIE_SHARE * r).sigma
    measured = _measured_radii(fit, table_z_m)
    contradicts = np.abs(measured - r) > max(SAME_RADIUS * r, SAME_AS_SCATTER * scatter)
    radii = np.where(contradicts, measured, r)
    lines = [fit.points[fit.line(k)] for k in range(len(strands))]
    fit = TubeFit(lines, r, surface, normals)
    fit.radii = radii
    owner = fit.owners(fit.assign()) if len(lines) > 1 else np.zeros(len(surface), dtype=np.int64)
    for k, strand in enumerate(strands):
        if not strand.closed:
            # What lies about another string is not this one's end.
            own = (owner == k) | (owner < 0)
            lines[k] = _to_both_ends(lines[k], surface[own], normals[own], radii[k])
    brought = [
        strand if strand.closed else Strand(line, np.zeros(len(line), dtype=bool))
        for strand, line in zip(strands, lines, strict=True)
    ]
    joined = merge_overlapping_ends(brought, parameters) if joins else None
    if joined is not None:
        return refine(joined, surface, normals, parameters, table_z_m, joins - 1)
    fit = TubeFit(lines, r, surface, normals)
    fit.radii = radii
    assigned = _settle(fit, LAST_STEPS, None)
    support = fit.support(assigned)
    shape = measure_cross_sections(fit, assigned)
    fitted = [
        FittedStrand(
            *_once(strand, fit.points[rows], support[rows]),
            float(fit.radii[k]),
            float(measured[k]),
            float(shape.out_of_round_m[k]),
            float(shape.squareness[k]),
            float(shape.squareness_sigma[k]),
        )
        for k, strand in enumerate(strands)
        for rows in [fit.line(k)]
    ]
    return Refinement(fitted, fit.owners(assigned), assigned.sigma)


def _measured_radii(fit: TubeFit, table_z_m: float) -> NDArray[np.float64]:
    """(K,) radius of each line's string, metres.

    A string rests on the table somewhere, and there its top is 2 r above it. The top is what the fit knows best:
    flying pixels at the rims, and noise along the line of sight, make the fitted radius itself up to a tenth too
    large or too small. No string is thicker than it is high; one that is much thinner rests on something else, and
    there the fit's counts.
    """
    measured = fit.radii.copy()
    for k, radius in enumerate(fit.radii):
        top = fit.points[fit.line(k), 2] + radius - table_z_m
        resting = float(np.percentile(top, RESTING_PERCENTILE)) / 2
        if resting < radius * (1 + RESTING_AGREES):
            measured[k] = resting
    # Where the table is not where it is said to be, heights say nothing.
    return np.where(measured > LEAST_SHARE * fit.r, measured, fit.radii)


def _settle(fit: TubeFit, rounds: Sequence[int], radius_tie: float | None) -> Assignment:
    assigned = None
    for steps in rounds:
        assigned = fit.assign()
        for _ in range(steps):
            fit.step(assigned, radius_tie)
            assigned = fit.follow(assigned)
    return assigned or fit.assign()


def _to_both_ends(
    line: NDArray[np.float64], surface: NDArray[np.float64], normals: NDArray[np.float64], r: float
) -> NDArray[np.float64]:
    line = localise_end(line, surface, normals, r)
    return localise_end(line[::-1], surface, normals, r)[::-1]


def _even(strand: Strand, r: float) -> NDArray[np.float64]:
    """The strand's line in even steps; a closed one goes round and `OVERLAP` points on."""
    points = close_polyline(strand.points, strand.closed)
    length = float(arc_length(points)[-1])
    line = points_at(points, np.linspace(0.0, length, max(round(length / (STEP_SHARE * r)), 2) + 1))
    return np.vstack([line, line[1 : OVERLAP + 1]]) if strand.closed else line


def _once(
    strand: Strand, line: NDArray[np.float64], support: NDArray[np.float64]
) -> tuple[NDArray[np.float64], bool, NDArray[np.bool_], NDArray[np.float64]]:
    """The fitted points, whether they go round, which are bridged, and their support; once round if closed."""
    if strand.closed:
        # Cut in the middle of the overlap, where neither end of the fitted line is near.
        once = slice(OVERLAP // 2, len(line) - 1 - OVERLAP + OVERLAP // 2)
        line, support = line[once], support[once]
    return line, strand.closed, support < BORNE_SHARE * np.median(support), support
