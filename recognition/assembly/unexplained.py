"""Detection of unexplained surface: measured points above the table that belong to no chain."""

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
"""Maximum number of pieces with their own message. One more message gives the number of further pieces."""


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
    """Return the warnings about pieces of unexplained surface.

    A piece may be string that the model misses, or an object with which a gripper can collide.

    Args:
        pieces: (M, 3) points of each piece, metres, base frame, the largest piece first.

    Returns:
        One message for each of the first `MAX_LISTED_PIECES` pieces, and one message with the number of further pieces.
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
    """Return the mask (N,), True where a surface point is too far from the nearest chain to belong to it."""
    lines = [resample(close_polyline(chain.points, chain.closed), parameters.r) for chain in chains]
    reach = np.repeat([2 * max(chain.radius_m, parameters.r) for chain in chains], [len(line) for line in lines])
    distance, nearest = KDTree(np.vstack(lines)).query(surface, distance_upper_bound=float(reach.max()))
    far = ~np.isfinite(distance)
    far[~far] = np.asarray(distance)[~far] > reach[np.asarray(nearest)[~far]]
    return far


def _size(piece: NDArray[np.float64]) -> float:
    """Return the diagonal of the piece's bounding box, metres."""
    return float(np.linalg.norm(np.ptp(piece, axis=0)))
