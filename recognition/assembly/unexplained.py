"""What was measured above the table and is in no chain: other things, or string that was missed."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from recognition.geometry.neighbours import neighbour_matrix
from recognition.geometry.polyline import close_polyline, resample
from recognition.messages import format_position
from recognition.model.model import Chain
from recognition.parameters import ChainParameters

MOST = 5
"""Pieces told one by one."""


def find_unexplained_surface(
    surface: NDArray[np.float64], chains: Sequence[Chain], parameters: ChainParameters
) -> list[NDArray[np.float64]]:
    """The pieces (M, 3) of `surface` (N, 3) larger than r_cn that lie farther than 2 r from every chain, the largest
    first.

    From a chain thicker than told, twice its own radius. Where there is no chain, all of the surface is left over.
    """
    rest = surface[_far(surface, chains, parameters)] if chains else surface
    if len(rest) == 0:
        return []
    _, piece = connected_components(neighbour_matrix(rest, rest, parameters.r), directed=False)
    order = np.argsort(piece, kind="stable")
    rest, first = rest[order], np.flatnonzero(np.diff(piece[order], prepend=-1))
    pieces = np.split(rest, first[1:])
    sizes = np.array([_size(piece) for piece in pieces])
    return [pieces[k] for k in np.argsort(-sizes, kind="stable") if sizes[k] >= parameters.r_cn]


def _far(surface: NDArray[np.float64], chains: Sequence[Chain], parameters: ChainParameters) -> NDArray[np.bool_]:
    """Which points (N,) are beyond the reach of every chain."""
    lines = [resample(close_polyline(chain.points, chain.closed), parameters.r) for chain in chains]
    reach = np.repeat([2 * max(chain.radius_m, parameters.r) for chain in chains], [len(line) for line in lines])
    distance, nearest = KDTree(np.vstack(lines)).query(surface, distance_upper_bound=float(reach.max()))
    far = ~np.isfinite(distance)
    far[~far] = np.asarray(distance)[~far] > reach[np.asarray(nearest)[~far]]
    return far


def unexplained_messages(pieces: Sequence[NDArray[np.float64]]) -> list[str]:
    """In words, the `pieces` that the chains leave over, the largest first.

    A model that leaves string out is a wrong model, and a grasp beside a thing that the model does not know may
    collide with it: both must be told.
    """
    told = [
        f"something of {_size(piece) * 1000:.0f} mm at {format_position(piece.mean(axis=0))} is above the table and in "
        "no chain"
        for piece in pieces[:MOST]
    ]
    if len(pieces) > MOST:
        told.append(f"and {len(pieces) - MOST} more such things")
    return told


def _size(piece: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.ptp(piece, axis=0)))
