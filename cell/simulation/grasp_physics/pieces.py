"""Pieces of the strings near a grasp, as chains of rigid segments."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.simulation.grasp_physics.settings import PhysicsSettings
from cell.simulation.scenes.clutter import Box, distance_to_box
from cell.simulation.scenes.scenes import StringScene
from recognition.geometry.polyline import arc_length, points_at

MIN_PIECE_M = 0.012
"""Minimum length of a piece. Shorter ones, at the edge of the region, are omitted."""
RAISED_M = 0.0003
"""Height above the table, or above the box below, from which a string is raised."""
SAME_STRAND_RADII = 4.0
"""Arc length, in radii, within which two parts of a string belong to one strand, so that they do not collide."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a string, as N straight segments."""

    string: int
    """Index of the string."""
    radius_m: float
    """Radius of the string."""
    points: NDArray[np.float64]
    """(N + 1, 3) ends of the segments, metres."""
    s_m: NDArray[np.float64]
    """(N,) arc length of the middle of each segment along the string."""
    ring: bool
    """Whether the piece is a whole closed string, so that its last point is its first."""
    carried: NDArray[np.bool_]
    """(N,) whether the segment belongs to an arch that is cut, so that the rest of the string carries its weight."""

    @property
    def lengths_m(self) -> NDArray[np.float64]:
        """(N,) lengths of the segments."""
        return np.linalg.norm(np.diff(self.points, axis=0), axis=1)


def distance_along(s_m: NDArray[np.float64], t_m: float, length_m: float, closed: bool) -> NDArray[np.float64]:
    """Return the distances along a string between the arc lengths `s_m` (N,) and `t_m`, metres."""
    distance = np.abs(s_m - t_m)
    return np.minimum(distance, length_m - distance) if closed else distance


def cut_pieces(scene: StringScene, centre_m: NDArray[np.float64], settings: PhysicsSettings) -> list[Piece]:
    """Return the pieces of the strings within `settings.region_m` of `centre_m` (3,) in the table plane.

    A closed string begins at its point farthest from the centre, so that no cut is near the grasp.
    """
    pieces = []
    for string, (curve, closed, radius_m) in enumerate(zip(scene.curves, scene.closed, scene.radii_m, strict=True)):
        s = arc_length(curve)
        length_m, start_m = float(s[-1]), 0.0
        away = np.linalg.norm(curve[:, :2] - centre_m[:2], axis=1)
        ring = closed and bool((away <= settings.region_m).all())
        points = curve
        if closed:
            first = int(away[:-1].argmax())
            start_m = float(s[first])
            points = np.vstack([curve[first:-1], curve[: first + 1]])
            s = arc_length(points)
            away = np.linalg.norm(points[:, :2] - centre_m[:2], axis=1)
        for begin, end in _runs(away <= settings.region_m):
            if s[end] - s[begin] < MIN_PIECE_M:
                continue
            count = max(round(float(s[end] - s[begin]) / settings.segment_m), 2)
            ends = np.linspace(s[begin], s[end], count + 1)
            middles = (ends[1:] + ends[:-1]) / 2 + start_m
            cut = (not ring and (closed or begin > 0), not ring and (closed or end < len(s) - 1))
            joints = points_at(points, ends)
            pieces.append(
                Piece(
                    string,
                    radius_m,
                    joints,
                    middles % length_m if closed else middles,
                    ring,
                    _carried(joints, radius_m, cut, scene.boxes),
                )
            )
    return pieces


def _runs(inside: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first and the last index of each run of true values."""
    edges = np.flatnonzero(np.diff(inside.astype(int), prepend=0, append=0))
    return [(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2] - 1, strict=True)]


def _carried(
    points: NDArray[np.float64], radius_m: float, cut: tuple[bool, bool], boxes: Sequence[Box]
) -> NDArray[np.bool_]:
    """Return which segments (N,) belong to an arch that is cut at the beginning or at the end of a piece."""
    middle = (points[1:] + points[:-1]) / 2
    floor = np.zeros(len(middle))
    for box in boxes:
        above = (distance_to_box(middle[:, :2], box) == 0) & (middle[:, 2] > box.size_m[2])
        floor[above] = np.maximum(floor[above], box.size_m[2])
    raised = middle[:, 2] > floor + radius_m + RAISED_M
    from_begin, from_end = np.logical_and.accumulate(raised), np.logical_and.accumulate(raised[::-1])[::-1]
    return (from_begin & cut[0]) | (from_end & cut[1])


def core_share(pieces: Sequence[Piece], closed: Sequence[bool], lengths_m: Sequence[float]) -> float:
    """Return the share of the radius, at most 1, with which strands touch where they lie in the scene.

    Strands of a soft string are pressed together at a crossing, and straight segments cut corners. With this share of
    the radius in contacts between strands, no two strands overlap at the start.

    Args:
        pieces: Pieces of the strings.
        closed: Whether each string of the scene is closed.
        lengths_m: Length of each string of the scene.
    """
    if not pieces:
        return 1.0
    start, end = np.vstack([p.points[:-1] for p in pieces]), np.vstack([p.points[1:] for p in pieces])
    radius = np.concatenate([np.full(len(p.s_m), p.radius_m) for p in pieces])
    string = np.concatenate([np.full(len(p.s_m), p.string) for p in pieces])
    s = np.concatenate([p.s_m for p in pieces])
    i, j = np.triu_indices(len(s), 1)
    along = np.abs(s[i] - s[j])
    wrapped = np.asarray(lengths_m)[string[i]] - along
    along = np.where(np.asarray(closed)[string[i]], np.minimum(along, wrapped), along)
    apart = (string[i] != string[j]) | (
        along > SAME_STRAND_RADII * radius[i] + np.linalg.norm((end - start)[i], axis=1)
    )
    i, j = i[apart], j[apart]
    distance = segment_distance(start[i], end[i], start[j], end[j])
    return float(np.min(distance / (radius[i] + radius[j]), initial=1.0))


def segment_distance(
    a0: NDArray[np.float64], a1: NDArray[np.float64], b0: NDArray[np.float64], b1: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances (N,) between the segments from `a0` to `a1` and from `b0` to `b1`, all (N, 3), metres."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, uv, vv, uw, vw = ((x * y).sum(axis=1) for x, y in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    inside = np.clip((uv * vw - vv * uw) / np.maximum(uu * vv - uv**2, 1e-18), 0.0, 1.0)
    best = np.full(len(a0), np.inf)
    # The nearest points are inside both segments, or one of them is an end of a segment.
    for share in (inside, np.zeros_like(uu), np.ones_like(uu)):
        on_b = np.clip((uv * share + vw) / vv, 0.0, 1.0)
        on_a = np.clip((uv * on_b - uw) / uu, 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(w + on_a[:, None] * u - on_b[:, None] * v, axis=1))
    for on_b in (np.zeros_like(uu), np.ones_like(uu)):
        on_a = np.clip((uv * on_b - uw) / uu, 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(w + on_a[:, None] * u - on_b[:, None] * v, axis=1))
    return best
