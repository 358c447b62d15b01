"""The direction in which a chain is told, so that the same string in the same place always reads the same."""

import numpy as np
from numpy.typing import NDArray


def canonical_order(points: NDArray[np.float64], closed: bool) -> NDArray[np.intp]:
    """(N,) indices that bring the `points` (N, 3) of a chain into the model's order.

    An open chain begins at its end of smaller x (then y, then z). A closed one begins at its point of smallest x, and
    goes to that of its neighbours first which has the smaller one.
    """
    count = len(points)
    if not closed:
        forwards = tuple(points[0]) <= tuple(points[-1])
        return np.arange(count) if forwards else np.arange(count)[::-1]
    first = int(np.lexsort(points.T[::-1])[0])
    before, behind = points[(first - 1) % count], points[(first + 1) % count]
    return (first + np.arange(count) * (1 if tuple(behind) <= tuple(before) else -1)) % count
