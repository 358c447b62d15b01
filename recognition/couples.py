"""Which of many couples of ends to take: each end in one at most, and the largest gain in sum."""

import time

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from recognition.errors import TooCrowdedError

SOLVE_S = 8.0
"""Longest search for the best couples of a scene; real ones take milliseconds, and a told radius of a quarter of the
true one 2 s."""
MARGINS_S = 3.0
"""From when on no more margins are looked for."""


def best_couples(
    count: int, a: NDArray[np.int64], b: NDArray[np.int64], gain: NDArray[np.float64], margins: bool = True
) -> tuple[list[tuple[int, int]], list[float]]:
    """The couples, each end in one at most, of the largest gain in sum, and what each is ahead of doing without it.

    Ends that no couple links directly or through others don't compete: each such group is solved by itself. Margins
    that there is no time for are 0; nor are there any without `margins`, each of which is a programme of its own.

    Args:
        count: number of ends.
        a, b: (M,) and (M,) the ends of each couple there may be.
        gain: (M,) of each.

    Raises:
        TooCrowdedError: too many ends compete to find the best couples in time.
    """
    start = time.monotonic()
    _, group = connected_components(csr_array((np.ones(len(a)), (a, b)), shape=(count, count)), directed=False)
    chosen: list[tuple[NDArray[np.int64], list[int], float]] = []
    for number in np.unique(group[a]):
        members = np.flatnonzero(group[a] == number)
        solved = _solve(a[members], b[members], gain[members], start + SOLVE_S)
        if solved is None:
            raise TooCrowdedError(
                f"the strands have {count} ends, and which belong together cannot be found within {SOLVE_S:g} s: "
                "check the string's radius and the workspace"
            )
        chosen.append((members, *solved))
    couples: list[tuple[int, int]] = []
    ahead: list[float] = []
    for members, best, total in chosen:
        for k in best:
            couples.append((int(a[members[k]]), int(b[members[k]])))
            if margins:
                others = np.delete(members, k)
                without = _solve(a[others], b[others], gain[others], start + MARGINS_S)
                ahead.append(0.0 if without is None else total - without[1])
    return couples, ahead


def _solve(
    a: NDArray[np.int64], b: NDArray[np.int64], gain: NDArray[np.float64], until: float
) -> tuple[list[int], float] | None:
    """Which couples to take, and their gain in sum: an integer programme, trivial for one couple; None out of time."""
    if len(a) == 0:
        return [], 0.0
    if len(a) == 1:
        return ([0], float(gain[0])) if gain[0] > 0 else ([], 0.0)
    left = until - time.monotonic()
    if left <= 0:
        return None
    ends = np.unique(np.concatenate([a, b]))
    each_once = (ends[:, None] == a) | (ends[:, None] == b)
    found = milp(
        -gain,
        integrality=np.ones(len(gain)),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(each_once.astype(np.float64), ub=1),
        options={"time_limit": left},
    )
    if not found.success:
        return None
    taken = [int(k) for k in np.flatnonzero(found.x > 0.5)]
    return taken, float(gain[taken].sum())
