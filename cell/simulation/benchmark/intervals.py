"""Compute 95 % Wilson score intervals of shares, for independent and for clustered trials.

`scipy.stats.binomtest` computes the same interval, but only for an integer number of trials. The effective number of
clustered trials is not an integer.
"""

from collections.abc import Sequence
from math import sqrt

import numpy as np

Z = 1.959964
"""Quantile of the standard normal distribution for a two-sided interval of 95 %."""

Interval = tuple[float, float]
"""Lower and upper limit of a share, 0 to 1."""


def wilson_interval(share: float, trials: float) -> Interval | None:
    """Return the 95 % Wilson score interval of a share of independent trials.

    Args:
        share: Share of the trials that succeeded, 0 to 1.
        trials: Number of trials. It need not be an integer.

    Returns:
        Lower and upper limit, rounded to 4 digits, or None without trials.

    Source:
        Wilson, Probable inference, the law of succession, and statistical inference (1927).
    """
    if trials <= 0:
        return None
    shrink = 1.0 + Z**2 / trials
    centre = (share + Z**2 / (2.0 * trials)) / shrink
    half = Z * sqrt(share * (1.0 - share) / trials + (Z / (2.0 * trials)) ** 2) / shrink
    return round(max(centre - half, 0.0), 4), round(min(centre + half, 1.0), 4)


def clustered_interval(successes: Sequence[int], trials: Sequence[int]) -> Interval | None:
    """Return the 95 % interval of a share whose trials come in clusters.

    The points of one scene share the pose errors of the scene, so they are not independent trials. The effective number
    of trials is the number of trials divided by the design effect. The design effect is the variance of the share
    between clusters, divided by the variance for independent trials. If the clusters show no variance, the effective
    number is the number of clusters.

    Args:
        successes: Number of successes in each cluster.
        trials: Number of trials in each cluster, in the same order.

    Returns:
        Lower and upper limit, rounded to 4 digits, or None without trials.

    Source:
        Kish, Survey Sampling (1965), for the design effect and the variance of a ratio.
    """
    k, n = np.asarray(successes, dtype=np.float64), np.asarray(trials, dtype=np.float64)
    k, n = k[n > 0], n[n > 0]
    clusters, total = len(n), float(n.sum())
    if clusters == 0:
        return None
    share = float(k.sum()) / total
    # A single cluster, or clusters with equal shares, show no variance. Each cluster then counts as one trial.
    effective_trials = float(clusters)
    if clusters > 1 and 0.0 < share < 1.0:
        variance = float(np.sum((k - share * n) ** 2)) / total**2 * clusters / (clusters - 1)
        if variance > 0.0:
            effective_trials = float(np.clip(share * (1.0 - share) / variance, 1.0, total))
    return wilson_interval(share, effective_trials)
