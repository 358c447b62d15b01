"""Which of the fitted strands are strings, and which the edges of boxes, folds or noise."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, close_polyline
from recognition.messages import format_position
from recognition.model.chain_order import canonical_order
from recognition.parameters import ChainParameters
from recognition.refinement.refinement import FittedStrand, Refinement

SHORTEST = 10.0
"""A shorter piece, in radii, is no string: less than five times as long as thick. Edges and crumbs make such."""
STRING_SHARE = 0.75
"""Least share of the surface beside a string that lies on its tube: about 0.9 does, and beside an edge of a box,
whose faces go on, about half."""
BESIDE = 2.2
"""How far from the centre line surface is beside a string, as a share of its own radius."""
OUT_OF_ROUND = 0.04
"""Largest deviation of a string's profile from a circle (standard deviation), as a share of its radius or, if that is
larger, the told one. Strings had up to 0.03 in simulated and foreign scans, edges of boxes 0.05 and more, and so had
bars seen from near."""
SQUARE = 0.25
"""Share of a square bar's profile from which on it is a bar's. Depth noise of a fifth of the radius leaves a bar about
half of it; strings of 0.1 m and more had up to 0.15."""
DOUBTFUL_SIGMAS = 2.0
"""What is within so many sigmas of a string's and of a bar's profile may be either: it is kept, and that is told."""
SUNK = 0.6
"""A string's centre line is its radius above the table or higher; lower than this share of it runs something else,
like the edge of a leaning plate, ..."""
SUNK_PERCENTILE = 15.0
"""... if so much of it does, in per cent: ends are known worst."""
LONG = 40.0
"""Of a piece of so many radii that is hardly seen, nobody can tell that it is no string."""
BORNE_SHARE = 0.5
"""Least share of a strand's points that the surface bears as well as `BORNE`."""
BORNE = 0.25
"""Share of what bears the longest string."""


def classify_strings(
    refinement: Refinement, surface: NDArray[np.float64], parameters: ChainParameters, table_z_m: float = 0.0
) -> tuple[list[FittedStrand], list[str], list[str]]:
    """The fitted strands that are strings, in the model's order and direction; in words which others may be strings
    too, and what is left out.

    A string is round: the surface beside it lies on its tube and has no flat top with edges. It lies on the table, not
    in it. The longest comes first.
    """
    strands = refinement.strands
    on_tube = _on_tube(refinement, surface, parameters.r)
    kept: list[int] = []
    doubts, left_out = [], []
    lengths = [float(arc_length(close_polyline(strand.points, strand.closed))[-1]) for strand in strands]
    for k in np.argsort(-np.array(lengths), kind="stable").tolist():
        strand, length = strands[k], lengths[k]
        usual = float(np.median(strands[kept[0]].support)) if kept else 0.0
        borne = np.mean(strand.support >= BORNE * usual) >= BORNE_SHARE
        circular = strand.out_of_round_m <= OUT_OF_ROUND * max(strand.radius_m, parameters.r)
        square = strand.squareness > max(SQUARE, DOUBTFUL_SIGMAS * strand.squareness_sigma)
        round_ = circular and not square and on_tube[k] >= STRING_SHARE
        sunk = float(np.percentile(strand.points[:, 2], SUNK_PERCENTILE)) - table_z_m < SUNK * strand.radius_m
        if length >= SHORTEST * parameters.r and borne and round_ and not sunk:
            kept.append(k)
            continue
        why = (
            "too short to be told from noise"
            if length < SHORTEST * parameters.r
            else "hardly seen"
            if not borne
            else "not round like a string"
            if not round_
            else "its tube would reach into the table"
        )
        maybe = length >= LONG * parameters.r and not borne
        (doubts if maybe else left_out).append(
            f"left out a piece of {length * 1000:.0f} mm at {format_position(strand.points.mean(axis=0))}: {why}"
            + (", so it may be a string" if maybe else "")
        )
    return [_directed(strands[k]) for k in kept], doubts, left_out


def may_be_square(strand: FittedStrand) -> bool:
    """Whether the surface of this string tells too little to say that it is no square bar."""
    return strand.squareness + DOUBTFUL_SIGMAS * strand.squareness_sigma > SQUARE


def _on_tube(refinement: Refinement, surface: NDArray[np.float64], r: float) -> NDArray[np.float64]:
    """(K,) for each strand the share of the surface beside it, and nearer to no other, that lies on its tube."""
    strands = refinement.strands
    if not strands:
        return np.empty(0)
    which = np.repeat(np.arange(len(strands)), [len(strand.points) for strand in strands])
    radii = np.array([max(strand.radius_m, r) for strand in strands])
    distance, found = KDTree(np.vstack([strand.points for strand in strands])).query(surface)
    nearest = which[np.asarray(found)]
    beside = np.asarray(distance) < BESIDE * radii[nearest]
    count = np.bincount(nearest[beside], minlength=len(strands))
    return np.bincount(nearest[beside], refinement.owner[beside] == nearest[beside], len(strands)) / np.maximum(
        count, 1
    )


def _directed(strand: FittedStrand) -> FittedStrand:
    order = canonical_order(strand.points, strand.closed)
    return replace(strand, points=strand.points[order], bridged=strand.bridged[order], support=strand.support[order])
