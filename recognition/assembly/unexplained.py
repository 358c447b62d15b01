"""Unexplained surface: measured points above the table that belong to no chain, and what they may be."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from recognition.geometry.neighbours import neighbour_matrix
from recognition.geometry.polyline import close_polyline, resample
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.parameters import ChainParameters

MAX_LISTED_PIECES = 5
"""Maximum number of pieces with their own note. One more note gives the number of further pieces."""

BESIDE_RADII = 3.0
"""Maximum distance of unexplained surface that lies beside a chain from its centre line, in radii."""
MAX_BESIDE_SHARE = 0.5
"""Maximum share of a string with unexplained surface beside it. A chain with a larger share may be part of an object.

In simulated scans, strings between boxes had up to 0.07. Edges and folds of objects that were recognised as chains had
0.93 and more.
"""
MIN_STRING_RADII = 20.0
"""Minimum size of a piece of surface that may be a string, in radii. Shorter ones are mostly parts of objects."""
MAX_SCATTER_RADII = 1.1
"""Maximum standard deviation of the surface across a piece, in radii, as its median. That of a string is 0.58, or 0.9
if windows widen it, and that of a wide object 1.5."""
SCATTER_RADIUS_RADII = 3.0
"""Radius of the neighbourhood in which it is measured, in radii."""
SAMPLE_COUNT = 200
"""Maximum number of points at which it is measured."""
MAX_HEIGHT_RADII = 2.2
"""Maximum median height of the surface above the table, in radii. That of a resting string is below 2."""
FOLLOWED_RADII = 2.0
"""Distance up to which a strand follows the surface, in radii."""
DOUBTED_RADII = 4.0
"""Distance from the surface of a piece up to which an excluded string belongs to it, in radii."""
MAX_FOLLOWED_SHARE = 0.3
"""Maximum share of a piece that a strand follows. A followed piece was a strand and has a finding of its own."""


def find_unexplained_surface(
    surface: NDArray[np.float64], chains: Sequence[Chain], parameters: ChainParameters
) -> list[NDArray[np.float64]]:
    """Return the connected pieces of the surface that belong to no chain, the largest first.

    A surface point belongs to the nearest chain if its distance is at most 2 r, or at most twice the radius of the
    chain if the chain is thicker than r. Pieces smaller than r_cn are noise and are dropped.

    Args:
        surface: (N, 3) measured points above the table, metres, base frame.
        chains: Chains of the model. Without chains, the whole surface is unexplained.
        parameters: Method parameters; uses the radius r and the minimum size r_cn of a piece.

    Returns:
        (M, 3) points of each piece, metres, base frame.
    """
    rest = surface
    if chains:
        rest = surface[_is_far(surface, chains, parameters)]
    if len(rest) == 0:
        return []
    _, label = connected_components(neighbour_matrix(rest, rest, parameters.r), directed=False)
    order = np.argsort(label, kind="stable")
    # Each piece begins where the sorted label changes.
    first = np.flatnonzero(np.diff(label[order], prepend=-1))
    pieces = np.split(rest[order], first[1:])
    sizes = np.array([_size(piece) for piece in pieces])
    return [pieces[k] for k in np.argsort(-sizes, kind="stable") if sizes[k] >= parameters.r_cn]


def unexplained_findings(pieces: Sequence[NDArray[np.float64]], parameters: ChainParameters) -> list[Finding]:
    """Return the notes on pieces of unexplained surface.

    A piece may be string that the model misses, or an object with which a gripper can collide.

    Args:
        pieces: (M, 3) points of each piece, metres, base frame, the largest piece first.
        parameters: Method parameters; uses the minimum size r_cn of a piece.

    Returns:
        One note on each of the first `MAX_LISTED_PIECES` pieces, and one note with the number of further pieces.
    """
    findings = []
    for piece in pieces[:MAX_LISTED_PIECES]:
        size = _size(piece)
        centre = piece.mean(axis=0)
        message = f"something of {size * 1000:.0f} mm at {format_position(centre)} is above the table and in no chain"
        findings.append(finding("unexplained-surface", message, point=centre, value=size, limit=parameters.r_cn))
    further = pieces[MAX_LISTED_PIECES:]
    if further:
        centre = further[0].mean(axis=0)
        message = (
            f"{len(further)} more things of {_size(further[-1]) * 1000:.0f} to {_size(further[0]) * 1000:.0f} mm are "
            f"above the table and in no chain, the largest at {format_position(centre)}"
        )
        findings.append(finding("more-unexplained-surface", message, point=centre, value=len(further)))
    return findings


def possible_object_findings(
    pieces: Sequence[NDArray[np.float64]], chains: Sequence[Chain], parameters: ChainParameters
) -> list[Finding]:
    """Return a doubt about each chain along which unexplained surface lies. It may be an edge or a fold of an object.

    The surface around a string is the table or the surface of another string. An edge or a fold continues on at least
    one side as a surface that belongs to no chain.

    Args:
        pieces: (M, 3) points of each piece of unexplained surface, metres, base frame.
        chains: Chains of the model.
        parameters: Method parameters; uses the radius r. A chain thicker than r uses its own radius.
    """
    if not pieces:
        return []
    tree = KDTree(np.vstack(pieces))
    findings = []
    for chain in chains:
        reach = BESIDE_RADII * max(chain.radius_m, parameters.r)
        distance, _ = tree.query(chain.points, distance_upper_bound=reach)
        share = float(np.isfinite(distance).mean())
        if share > MAX_BESIDE_SHARE:
            centre = chain.points.mean(axis=0)
            message = (
                f"chain {chain.id} at {format_position(centre)} may be the edge or a fold of an object: surface in no "
                f"chain lies beside {share:.0%} of it"
            )
            findings.append(
                finding(
                    "possible-object",
                    message,
                    chains=(chain.id,),
                    point=centre,
                    value=share,
                    limit=MAX_BESIDE_SHARE,
                )
            )
    return findings


def missed_string_findings(
    pieces: Sequence[NDArray[np.float64]],
    lines: Sequence[NDArray[np.float64]],
    doubted: Sequence[NDArray[np.float64]],
    parameters: ChainParameters,
    table_z_m: float,
) -> list[Finding]:
    """Return a doubt about each piece of unexplained surface that is as long, narrow and low as a string.

    Args:
        pieces: (M, 3) points of each piece of surface that belongs to no chain, metres, base frame.
        lines: (N, 3) points of all fitted strands, also of the excluded ones, metres, base frame.
        doubted: (3,) positions of excluded pieces that have the doubt already, metres, base frame.
        parameters: Method parameters; uses the radius r.
        table_z_m: Height of the table, metres, base frame.
    """
    findings: list[Finding] = []
    for piece in pieces:
        length_m = _size(piece)
        if length_m < MIN_STRING_RADII * parameters.r or not _is_like_string(piece, parameters.r, table_z_m):
            continue
        if _followed_share(piece, lines, parameters.r) > MAX_FOLLOWED_SHARE:
            continue
        if doubted and KDTree(piece).query(np.array(doubted))[0].min() < DOUBTED_RADII * parameters.r:
            continue
        centre = piece.mean(axis=0)
        message = (
            f"something of {length_m * 1000:.0f} mm at {format_position(centre)} is as narrow and as low as a string "
            "and in no chain: look at it, or scan again with viewpoints that are nearer"
        )
        findings.append(finding("possible-string", message, point=centre, value=length_m))
    return findings


def _is_far(surface: NDArray[np.float64], chains: Sequence[Chain], parameters: ChainParameters) -> NDArray[np.bool_]:
    """Return the mask (N,), True where a surface point is too far from the nearest chain to belong to it."""
    lines = [resample(close_polyline(chain.points, chain.closed), parameters.r) for chain in chains]
    reach = np.repeat([2 * max(chain.radius_m, parameters.r) for chain in chains], [len(line) for line in lines])
    distance, nearest = KDTree(np.vstack(lines)).query(surface, distance_upper_bound=float(reach.max()))
    # Within the largest reach, the reach of the nearest chain decides.
    is_near = np.isfinite(distance)
    is_far = ~is_near
    is_far[is_near] = np.asarray(distance)[is_near] > reach[np.asarray(nearest)[is_near]]
    return is_far


def _is_like_string(piece: NDArray[np.float64], r: float, table_z_m: float) -> bool:
    """Return whether a piece (N, 3) is as narrow and as low as strings of radius r, seen from above."""
    if np.median(piece[:, 2]) - table_z_m > MAX_HEIGHT_RADII * r:
        return False
    xy = piece[:, :2]
    sample = xy[:: -(-len(xy) // SAMPLE_COUNT)]
    neighbours = KDTree(xy).query_ball_point(sample, SCATTER_RADIUS_RADII * r)
    scatter = [np.linalg.eigvalsh(np.cov(xy[near].T))[0] for near in neighbours if len(near) > 2]
    return len(scatter) > 0 and float(np.sqrt(max(np.median(scatter), 0.0))) <= MAX_SCATTER_RADII * r


def _followed_share(piece: NDArray[np.float64], lines: Sequence[NDArray[np.float64]], r: float) -> float:
    """Return the share of the points (N, 3) of a piece that are near one of the lines."""
    if not lines:
        return 0.0
    distance, _ = KDTree(np.vstack(lines)).query(piece, distance_upper_bound=FOLLOWED_RADII * r)
    return float(np.isfinite(distance).mean())


def _size(piece: NDArray[np.float64]) -> float:
    """Return the diagonal of the piece's bounding box, metres."""
    return float(np.linalg.norm(np.ptp(piece, axis=0)))
