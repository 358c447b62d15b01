"""From fitted strands to the chains of the model: what is a string, how well it is known, and what its ends are."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.cover import Cover
from recognition.fitted_evidence import evidence
from recognition.model import Chain, End, arc_length
from recognition.parameters import ChainParameters
from recognition.preprocess import Scene
from recognition.refinement import FittedStrand, Refinement
from recognition.registration import Registration

SHORTEST = 10.0
"""A shorter piece, in radii, is no string: less than five times as long as thick. Edges and crumbs make such."""
STRING_SHARE = 0.75
"""Least share of the surface beside a string that lies on some string's tube: about 0.9 does, and beside an edge of
a box, whose faces go on, about half."""
BESIDE = 2.2
"""How far from the centre line surface is beside a string, as a share of its own radius."""
FLANK_SHARE = 0.12
"""Least share of a string's surface on each of its flanks; about 0.3 lies there when it is seen from both sides."""
ONE_SIDED_SHARE = 0.9
"""What `STRING_SHARE` is for a strand of which one flank is seen, as of a box's edge or by views from one side."""
BORNE_SHARE = 0.5
"""Least share of a string's points that measured surface bears."""
OTHER_RADIUS = 0.25
"""A measured radius that differs by more than this share from the told one is told."""


def fitted_chains(
    refinement: Refinement, registration: Registration, scene: Scene, parameters: ChainParameters
) -> tuple[tuple[Chain, ...], list[str]]:
    """The chains of the strings among the fitted strands, and in words what was left out or contradicts the radius."""
    strands, warnings = select_strings(refinement, registration.points, parameters)
    if not strands:
        warnings.append("no string found: nothing above the table is long and thin")
    cover = Cover(registration.points, parameters.r)
    chains = []
    for number, strand in enumerate(strands):
        sigma_m, views = evidence(strand, registration, refinement.scatter_m)
        ends = end_kinds(strand, cover, scene, parameters)
        chains.append(Chain(number, strand.closed, strand.radius_m, strand.points, sigma_m, views, ends))
        if abs(strand.measured_radius_m / parameters.r - 1) > OTHER_RADIUS:
            warnings.append(
                f"chain {number} measures {strand.measured_radius_m * 1000:.1f} mm in radius, not the "
                f"{parameters.r * 1000:.1f} mm told"
            )
    return tuple(chains), warnings


def select_strings(
    refinement: Refinement, surface: NDArray[np.float64], parameters: ChainParameters
) -> tuple[list[FittedStrand], list[str]]:
    """The fitted strands that are strings, in the model's order and direction, and in words what the others are.

    The longest comes first, and each begins at its end of smaller x (then y), so that the same string in the same
    place always reads the same.
    """
    explained = _explained(refinement, surface, parameters.r)
    usual = np.median(np.concatenate([s.support for s in refinement.strands])) if refinement.strands else 0.0
    kept, left_out = [], []
    for strand, share in zip(refinement.strands, explained, strict=True):
        length = float(arc_length(strand.points)[-1])
        borne = float(np.mean(strand.support > 0.1 * usual))
        if length < SHORTEST * parameters.r:
            why = "too short to be told from noise"
        elif share < (STRING_SHARE if strand.flank_share > FLANK_SHARE else ONE_SIDED_SHARE) or borne < BORNE_SHARE:
            why = "not round like a string"
        else:
            kept.append(_directed(strand))
            continue
        where = ", ".join(f"{value * 1000:.0f}" for value in strand.points.mean(axis=0))
        left_out.append(f"left out a piece of {length * 1000:.0f} mm at ({where}) mm: {why}")
    kept.sort(key=lambda strand: -arc_length(strand.points)[-1])
    return kept, left_out


def end_kinds(strand: FittedStrand, cover: Cover, scene: Scene, parameters: ChainParameters) -> tuple[End, End]:
    """For the first and the last point: `free` when the string was seen to stop there, else `unseen`.

    It was not seen to stop where it leaves the workspace or goes on under another strand. Both of a closed strand's
    are `free`: it has no end that was missed.
    """
    if strand.closed:
        return "free", "free"
    kinds: list[End] = []
    for points in (strand.points, strand.points[::-1]):
        way = points[0] - points[min(3, len(points) - 1)]
        way[2] = 0.0
        way /= max(float(np.linalg.norm(way)), 1e-12)
        ahead = points[0] + np.linspace(0.3, 1.3, 5)[:, None] * parameters.r * way
        hidden = cover.over(ahead)[0].mean() > 0.5
        kinds.append("unseen" if hidden or _at_border(points[0], scene, parameters.r_f) else "free")
    return kinds[0], kinds[1]


def _at_border(point: NDArray[np.float64], scene: Scene, margin: float) -> bool:
    if scene.workspace_m is None:
        return False
    low, high = np.asarray(scene.workspace_m, dtype=np.float64)[:2].T
    return bool(((point[:2] < low + margin) | (point[:2] > high - margin)).any())


def _explained(refinement: Refinement, surface: NDArray[np.float64], r: float) -> NDArray[np.float64]:
    """(K,) for each strand the share of the surface beside it that lies on some strand's tube."""
    if not refinement.strands:
        return np.empty(0)
    line = np.vstack([strand.points for strand in refinement.strands])
    which = np.repeat(np.arange(len(refinement.strands)), [len(strand.points) for strand in refinement.strands])
    radii = np.array([max(strand.radius_m, r) for strand in refinement.strands])
    distance, found = KDTree(line).query(surface)
    nearest = which[np.asarray(found)]
    beside = np.asarray(distance) < BESIDE * radii[nearest]
    strand = nearest[beside]
    count = np.bincount(strand, minlength=len(refinement.strands))
    return np.bincount(strand, refinement.owner[beside] >= 0, len(count)) / np.maximum(count, 1)


def _directed(strand: FittedStrand) -> FittedStrand:
    if tuple(strand.points[0]) <= tuple(strand.points[-1]):
        return strand
    return replace(
        strand,
        points=strand.points[::-1].copy(),
        bridged=strand.bridged[::-1].copy(),
        support=strand.support[::-1].copy(),
    )
