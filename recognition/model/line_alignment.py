"""Alignment of two lines by a rigid motion in the table plane."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, close_polyline, points_at
from recognition.model.chains import Chain

SAMPLES = 96
"""Number of points at equal distances by which lines are compared."""


@dataclass(frozen=True, eq=False)
class LineAlignment:
    """Rigid motion that moves a line onto another one as well as possible."""

    T_now_before: NDArray[np.float64]
    """(4, 4) motion, base frame: a rotation about z and a translation, metres. It maps points before to points now."""
    rms_m: float
    """Root mean square distance of corresponding points after the motion, seen from above, metres.

    A string that now lies over another one has other heights, but the same shape.
    """
    is_reversed: bool
    """Whether the line now runs in the opposite direction."""
    s_offset_m: float
    """Arc length, on the line now, of the first point of the line before, metres. 0 on open lines."""
    displacement_m: float
    """Largest distance of corresponding points without the motion, metres."""


def align_lines(before: Chain, now: Chain, tolerance_m: float) -> LineAlignment:
    """Return the motion that best moves one chain onto another, over both directions and all first points of rings.

    Points correspond if they have the same share of the length. Symmetric lines, for example straight ones, have
    several good motions. Among those whose distance is at most `tolerance_m` above the least one, the smallest motion
    is returned.

    Args:
        before: Chain before the motion.
        now: Chain after the motion. Both chains are open, or both are closed.
        tolerance_m: Accepted increase of the distance after the motion, metres.
    """
    a = _samples(before)
    b = _samples(now)
    shifts = range(SAMPLES) if now.closed else range(1)
    alignments = [_fit(a, np.roll(b, -shift, axis=0), _offset(shift, now)) for shift in shifts]
    backwards = _reversed(b, now.closed)
    for shift in shifts:
        alignment = _fit(a, np.roll(backwards, -shift, axis=0), _offset(-shift, now))
        alignments.append(replace(alignment, is_reversed=True))
    limit = min(alignment.rms_m for alignment in alignments) + tolerance_m
    return min(
        (alignment for alignment in alignments if alignment.rms_m <= limit),
        key=lambda alignment: alignment.displacement_m,
    )


def _offset(shift: int, now: Chain) -> float:
    """Return the arc length of the sample that corresponds to the first sample, metres. `shift` is 0 on open chains."""
    return shift / SAMPLES % 1.0 * now.length_m


def _samples(chain: Chain) -> NDArray[np.float64]:
    """Return `SAMPLES` points (N, 3) at equal distances. A closed chain has no point twice."""
    line = close_polyline(chain.points, chain.closed)
    return points_at(line, np.linspace(0.0, arc_length(line)[-1], SAMPLES, endpoint=not chain.closed))


def _reversed(points: NDArray[np.float64], closed: bool) -> NDArray[np.float64]:
    """Return the points in reverse order. A closed line keeps its first point."""
    return np.roll(points[::-1], 1, axis=0) if closed else points[::-1]


def _fit(a: NDArray[np.float64], b: NDArray[np.float64], s_offset_m: float) -> LineAlignment:
    """Return the motion with the least squared distances of samples `a` (N, 3) from samples `b` (N, 3)."""
    mean_a = a.mean(axis=0)
    mean_b = b.mean(axis=0)
    p = (a - mean_a)[:, :2]
    q = (b - mean_b)[:, :2]
    angle = np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum())
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:3, 3] = mean_b - T[:3, :3] @ mean_a
    residual = (a @ T[:3, :3].T + T[:3, 3] - b)[:, :2]
    return LineAlignment(
        T_now_before=T,
        rms_m=float(np.sqrt((residual**2).sum(axis=1).mean())),
        is_reversed=False,
        s_offset_m=s_offset_m,
        displacement_m=float(np.linalg.norm(a - b, axis=1).max()),
    )
