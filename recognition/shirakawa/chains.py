"""Conversion of strands to the chains of the model, with the uncertainty of each point."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.excluded_pieces import excluded_piece, shortened
from recognition.geometry.neighbours import neighbourhood_means
from recognition.geometry.polyline import arc_length, unit_vectors
from recognition.model.canonical_order import canonical_line, order_key
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import Scene
from recognition.shirakawa.end_extension import classify_ends
from recognition.strand import Strand

MIN_SIGMA_M = 0.0002
"""Lower limit of sigma, metres. All views share the hand-eye error, so differences between views do not show it."""
UNSEEN_BEND_RADII = 5.0
"""Bend radius that is assumed between a point that no view saw and the nearest seen point, in radii r."""
TOP_PERCENTILE = 90
"""Percentile of the heights of the surface at a point that counts as its top."""
MIN_ABOVE_RADII = 1.5
"""Minimum height of the surface of another strand above a point that it hides, in radii r."""


@dataclass(frozen=True, eq=False)
class StrandAssembly:
    """Chains of one of the paper's methods, and the strands from which the chains were made."""

    strands: Sequence[Strand]
    """The kept strands. `strands[k]` has the same points in the same order as `chains[k]`."""
    chains: tuple[Chain, ...]
    """One chain for each kept strand, in canonical order."""
    findings: Sequence[Finding]
    """Notes on the excluded strands. If no strand was kept, the first one says that no string was found."""


def assemble_chains(
    strands: Sequence[Strand],
    unaveraged: NDArray[np.float64],
    clouds: Sequence[NormalCloud],
    scene: Scene,
    parameters: ChainParameters,
) -> StrandAssembly:
    """Make the chains of the model from strands.

    Strands shorter than r_cn, the extent of an intersection, are excluded. Such short strands are remains of an
    intersection, or noise. The chains and the points of each chain are in canonical order.

    Args:
        strands: Strands of the scene.
        unaveraged: (N, 3) centre points c_i of eq. (1), metres.
        clouds: Points and normals of each view, after registration.
        scene: Scene; uses the workspace.
        parameters: Method parameters; uses r, r_n, r_f and r_cn.

    Returns:
        The kept strands, their chains, and the findings.
    """
    kept = []
    excluded = []
    for strand in strands:
        length = float(arc_length(strand.points)[-1])
        if length >= parameters.r_cn:
            kept.append(_orient(_without_repeats(strand)))
        else:
            reason = "too short to be distinguished from noise"
            excluded.append(excluded_piece("piece-too-short", strand.points, length, reason))
    kept.sort(key=lambda strand: order_key(strand.points, strand.closed))
    excluded.sort(key=lambda piece: -piece.value)
    findings = shortened(excluded)
    if not kept:
        findings.insert(0, finding("no-string-found", "no string found: nothing above the table is long and thin"))
    chains = []
    for number, strand in enumerate(kept):
        sigma_m, views = point_uncertainty(strand, clouds, parameters)
        ends = classify_ends(strand, unaveraged, scene, parameters)
        chains.append(Chain(number, strand.closed, parameters.r, strand.points, sigma_m, views, ends))
    return StrandAssembly(kept, tuple(chains), findings)


def _without_repeats(strand: Strand) -> Strand:
    """Return a strand without points that equal the point before them, as random surfaces may give."""
    is_new = np.append(True, np.linalg.norm(np.diff(strand.points, axis=0), axis=1) > 0)
    return replace(strand, points=strand.points[is_new], bridged=strand.bridged[is_new])


def point_uncertainty(
    strand: Strand, clouds: Sequence[NormalCloud], parameters: ChainParameters
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the standard deviation and the number of views of each point of a strand.

    Each view gives its own estimate of the centre line near a point: the mean of the points c_i (eq. 1) within r. The
    standard deviation is the root mean square distance of these estimates from the point, across the string.

    For a point that no view saw, for example under a crossing, let d be the distance along the strand to the nearest
    seen point. The standard deviation is larger than at the seen point by d^2 / (10 r), as for a bend of radius 5 r.

    Args:
        strand: Strand with N points.
        clouds: Points and normals of each view, after registration.
        parameters: Method parameters; uses the radius r.

    Returns:
        Standard deviations (N,) across the string, metres, and numbers of views (N,). If no view saw any point, all
        standard deviations are r.
    """
    points = strand.points
    tangent = _tangents(points)
    offsets = []
    for cloud in clouds:
        # Any c_i within r of the strand belongs to a surface point within 2 r. A tree of all c_i is slower.
        near = np.unique(np.concatenate(list(cloud.tree.query_ball_point(points, 2 * parameters.r)))).astype(np.intp)
        unaveraged = cloud.points[near] - parameters.r * cloud.normals[near]
        means = neighbourhood_means(points, unaveraged, unaveraged, parameters.r)
        offset = means - points
        offset -= (offset * tangent).sum(axis=1, keepdims=True) * tangent
        offsets.append(np.linalg.norm(offset, axis=1))
    distance = np.array(offsets).reshape(-1, len(points))
    seen = np.isfinite(distance) & ~_find_hidden_points(strand, clouds, parameters)
    views = seen.sum(axis=0)
    variance = (np.where(seen, distance, 0.0) ** 2).sum(axis=0) / np.maximum(views, 1)
    sigma = np.hypot(np.sqrt(variance), MIN_SIGMA_M)
    unseen = views == 0
    if unseen.all():
        return np.full(len(points), parameters.r), views.astype(np.int64)
    s = arc_length(points)
    gap, nearest = KDTree(s[~unseen, None]).query(s[unseen, None])
    # A bend of radius R leaves its tangent by d^2 / (2 R) after a length d.
    sigma[unseen] = sigma[~unseen][nearest] + gap**2 / (2 * UNSEEN_BEND_RADII * parameters.r)
    return sigma, views.astype(np.int64)


def _tangents(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit tangents (N, 3) of a line; zero for a single point."""
    if len(points) < 2:
        return np.zeros_like(points)
    return unit_vectors(np.gradient(points, axis=0))


def _orient(strand: Strand) -> Strand:
    """Return the strand with its points in the canonical order."""
    line = canonical_line(strand.points, strand.closed)
    return replace(strand, points=line.points, bridged=strand.bridged[line.source])


def _find_hidden_points(
    strand: Strand, clouds: Sequence[NormalCloud], parameters: ChainParameters
) -> NDArray[np.bool_]:
    """Return the mask (N,), True for the bridged points that another strand hides from above.

    At an intersection, the points of both strands are bridged, but the views saw the over strand. A bridged point is
    hidden if the top of the surface is at least 1.5 r above the point, or if no surface was measured there.
    """
    hidden = strand.bridged.copy()
    if not hidden.any():
        return hidden
    surface = np.vstack([np.empty((0, 3)), *(cloud.points for cloud in clouds)])
    bridged_xy = strand.points[hidden, :2]
    low = bridged_xy.min(axis=0)
    high = bridged_xy.max(axis=0)
    is_beside = (surface[:, :2] > low - parameters.r) & (surface[:, :2] < high + parameters.r)
    surface = surface[is_beside.all(axis=1)]
    tree_xy = KDTree(surface[:, :2])
    for i in np.flatnonzero(strand.bridged):
        near = tree_xy.query_ball_point(strand.points[i, :2], parameters.r / 2)
        if not near:
            continue
        top = np.percentile(surface[near, 2], TOP_PERCENTILE)
        hidden[i] = top >= strand.points[i, 2] + MIN_ABOVE_RADII * parameters.r
    return hidden
