"""95 % confidence intervals of shares, by Wilson's score.

SciPy has this interval in `binomtest`, for whole counts only. The effective number of clustered trials is not whole; a
test compares both where SciPy's can be had.
"""

from collections.abc import Sequence
from math import sqrt

import numpy as np

Z = 1.959964
"""Two-sided 95 % quantile of the normal distribution."""

Interval = tuple[float, float]


def wilson_interval(share: float, trials: float) -> Interval | None:
    """Return the 95 % Wilson score interval of a share of independent trials.

    Args:
        share: Share of the trials that succeeded, 0 to 1.
        trials: Number of trials, which need not be whole: `clustered_interval` gives an effective number.

    Returns:
        Lower and upper limit, 0 to 1; None without a trial.
    """
    if trials <= 0:
        return None
    shrink = 1.0 + Z**2 / trials
    centre = (share + Z**2 / (2.0 * trials)) / shrink
    half = Z * sqrt(share * (1.0 - share) / trials + (Z / (2.0 * trials)) ** 2) / shrink
    return round(max(centre - half, 0.0), 4), round(min(centre + half, 1.0), 4)


def clustered_interval(successes: Sequence[int], trials: Sequence[int]) -> Interval | None:
    """Return the 95 % interval of a share whose trials come in clusters.

    The points of one scene share its pose errors, so they are not independent trials. The number of points is divided
    by the design effect: the variance of the share that the scenes show, over that of independent points. Wilson's
    interval is taken with this effective number.

    Args:
        successes: Number of successes in each cluster.
        trials: Number of trials in each cluster, in the same order.

    Returns:
        Lower and upper limit, 0 to 1; None without a trial.

    Source:
        Kish, Survey Sampling (1965): the design effect, and the variance of a ratio.
    """
    k, n = np.asarray(successes, dtype=np.float64), np.asarray(trials, dtype=np.float64)
    k, n = k[n > 0], n[n > 0]
    clusters, total = len(n), float(n.sum())
    if clusters == 0:
        return None
    share = float(k.sum()) / total
    effective = float(clusters)  # one cluster, or clusters that all agree, show no variance: each counts once
    if clusters > 1 and 0.0 < share < 1.0:
        variance = float(np.sum((k - share * n) ** 2)) / total**2 * clusters / (clusters - 1)
        if variance > 0.0:
            effective = float(np.clip(share * (1.0 - share) / variance, 1.0, total))
    return wilson_interval(share, effective)
