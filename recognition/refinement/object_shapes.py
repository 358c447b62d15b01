"""Shapes of objects that look round but are no strings: posts, pens, bars and folds.

Each test reads one property of the fitted tube that gravity or bending gives to strings only.
"""

import numpy as np
from numpy.typing import NDArray

from recognition.refinement.refinement import FittedStrand

MIN_UPRIGHT_RAD = float(np.deg2rad(60.0))
"""Minimum angle of the main axis of an upright strand from the horizontal, radians.

Strings lie. In simulated scans, the main axis of a string of at least 10 radii had up to 4 degrees, that of a post 89.
"""
MAX_ROD_BEND_SHARE = 0.06
"""Maximum root mean square distance of the points of a rod from its main axis, as a share of its radius.

It was up to 0.035 for pens in simulated scans, which is the error of the fit. No string of them had less than 5.
"""
MAX_BAR_BEND_SHARE = 0.3
"""The same distance for a bar in depth that was matched in windows, whose errors along a strand are larger."""
MIN_RAISED_SHARE = 1.15
"""Minimum height of the top of a fold above the table, in diameters of its tube. It is 1 for a string on the table.

The tube follows the narrow top of a fold, so its diameter is smaller than the height. The share was 1.2 to 1.46 for
folds of cloth in simulated scans that had passed the test of the circle.
"""


def is_upright(points: NDArray[np.float64]) -> bool:
    """Return whether the main axis of a line (N, 3) is nearly vertical, as of a post."""
    return bool(abs(_main_axis(points)[2]) > np.sin(MIN_UPRIGHT_RAD))


def is_other_rod(strand: FittedStrand, r: float) -> bool:
    """Return whether a strand is straight to within the error of its fit, and has another radius than a string.

    A straight strand with the radius of a string may be a string that lies straight.

    Args:
        strand: Fitted strand. Its radius is `r` unless the measured one differs clearly.
        r: Radius of the strings, metres.
    """
    return strand.radius_m != r and _is_straight(strand, MAX_ROD_BEND_SHARE)


def may_be_matched_bar(strand: FittedStrand) -> bool:
    """Return whether a strand in depth that was matched in windows is as straight as a bar.

    The windows round the edges of a bar that is hardly wider than they are. Only its straightness is left to tell.
    """
    return _is_straight(strand, MAX_BAR_BEND_SHARE)


def is_fold(strand: FittedStrand, r: float, table_z_m: float) -> bool:
    """Return whether a strand is thinner than a string and lies higher than a string of its radius would lie.

    Args:
        strand: Fitted strand. Its radius is `r` unless the measured one differs clearly.
        r: Radius of the strings, metres.
        table_z_m: Height of the table, metres.
    """
    top_m = float(np.median(strand.points[:, 2])) + strand.radius_m - table_z_m
    return bool(strand.radius_m < r and top_m > MIN_RAISED_SHARE * 2 * strand.radius_m)


def _is_straight(strand: FittedStrand, max_bend_share: float) -> bool:
    """Return whether a strand deviates from its main axis by at most a share of its radius (root mean square)."""
    if strand.closed:
        return False
    offset = strand.points - strand.points.mean(axis=0)
    axis = _main_axis(strand.points)
    across = offset - np.outer(offset @ axis, axis)
    return bool(np.sqrt((across**2).sum(axis=1).mean()) <= max_bend_share * strand.radius_m)


def _main_axis(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit vector (3,) of the main axis of points (N, 3)."""
    offset = points - points.mean(axis=0)
    return np.asarray(np.linalg.eigh(offset.T @ offset)[1][:, -1], dtype=np.float64)
