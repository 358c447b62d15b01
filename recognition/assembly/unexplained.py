"""Unexplained surface: measured points above the table that belong to no chain."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from recognition.geometry.neighbours import neighbour_matrix
from recognition.geometry.polyline import close_polyline, resample
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.parameters import ChainParameters

MAX_LISTED_PIECES = 5
"""Number of pieces that get a message of their own; one more message counts the rest."""


def find_unexplained_surface(
    surface: NDArray[np.float64], chains: Sequence[Chain], parameters: ChainParameters
) -> list[NDArray[np.float64]]:
    """Return the connected pieces of the surface that are far from every chain, the largest first.

    A point is far from a chain if its distance is more than 2 r, or more than twice the chain's own radius if the
    chain is thicker than r. Pieces smaller than r_cn are noise and are dropped.

    Args:
        surface: (N, 3) measured points above the table, metres, base frame.
        chains: Chains of the model. Without chains, the whole surface is unexplained.
        parameters: Radius r and minimum size r_cn of a piece.

    Returns:
        (M, 3) points of each piece, metres, base frame.

    Source:
        Ours.
    """
    rest = surface[_is_far(surface, chains, parameters)] if chains else surface
    if len(rest) == 0:
        return []
    _, label = connected_components(neighbour_matrix(rest, rest, parameters.r), directed=False)
    order = np.argsort(label, kind="stable")
    rest, first = rest[order], np.flatnonzero(np.diff(label[order], prepend=-1))
    pieces = np.split(rest, first[1:])
    sizes = np.array([_size(piece) for piece in pieces])
    return [pieces[k] for k in np.argsort(-sizes, kind="stable") if sizes[k] >= parameters.r_cn]


def unexplained_messages(pieces: Sequence[NDArray[np.float64]]) -> list[str]:
    """Return the warnings for pieces of unexplained surface.

    A piece may be string that the model misses, or an object that a gripper can collide with. The user must know
    about both.

    Args:
        pieces: (M, 3) points of each piece, metres, base frame, the largest piece first.

    Returns:
        One message for each of the first `MAX_LISTED_PIECES` pieces, and one with the number of the others.
    """
    messages = [
        f"something of {_size(piece) * 1000:.0f} mm at {format_position(piece.mean(axis=0))} is above the table and in "
        "no chain"
        for piece in pieces[:MAX_LISTED_PIECES]
    ]
    if len(pieces) > MAX_LISTED_PIECES:
        messages.append(f"and {len(pieces) - MAX_LISTED_PIECES} more such objects")
    return messages


def _is_far(surface: NDArray[np.float64], chains: Sequence[Chain], parameters: ChainParameters) -> NDArray[np.bool_]:
    """Return (N,) whether each point is farther from every chain than that chain explains."""
    lines = [resample(close_polyline(chain.points, chain.closed), parameters.r) for chain in chains]
    reach = np.repeat([2 * max(chain.radius_m, parameters.r) for chain in chains], [len(line) for line in lines])
    distance, nearest = KDTree(np.vstack(lines)).query(surface, distance_upper_bound=float(reach.max()))
    far = ~np.isfinite(distance)
    far[~far] = np.asarray(distance)[~far] > reach[np.asarray(nearest)[~far]]
    return far


def _size(piece: NDArray[np.float64]) -> float:
    """Return the diagonal of the piece's bounding box, metres."""
    return float(np.linalg.norm(np.ptp(piece, axis=0)))
