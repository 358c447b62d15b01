"""Frame tree of /tf and /tf_static in a bag, with poses between any two frames at any time."""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from cell.bag.errors import BagError, listed
from cell.bag.pose_batch import Poses
from cell.recording.errors import shown

MAX_DISTANCE_M = 1e6
"""Largest distance of a frame from its parent. The origin of a map may be far away."""
MAX_SAMPLES = 5_000_000
"""Largest number of samples. Ten minutes of ten joints at 500 Hz are 3 million, which take 60 bytes each."""
GAP_S = 0.2
"""Largest time between samples of a moving arm. Across a longer gap, poses are interpolated only if both ends agree ...
"""
BRIDGED_S = 2.0
"""... and if the gap is not longer than this, because an arm may leave and return within a minute."""
NEAR_S = 0.1
"""Time during which the nearest sample holds beside such a gap, and beyond the first and the last sample."""
LOOSE_M, LOOSE_RAD = 2e-4, 5e-4
"""Largest change of a fixed transform. No hand-eye calibration is more accurate."""
SAME_M, SAME_RAD = 5e-4, 1e-3
"""Largest difference of two poses of an arm at rest, below the noise of depth and above that of joint encoders."""

UNKNOWN, ALONE, KNOWN = 0, 1, 2
"""How well a pose is known: not at all, by one sample beside a gap or at an end, or by samples on both sides."""


@dataclass
class _Samples:
    """Samples of one frame in its parent."""

    stamps_ns: array = field(default_factory=lambda: array("q"))
    values: array = field(default_factory=lambda: array("d"))
    """Seven values for each sample, x, y, z and the quaternion x, y, z, w."""


@dataclass(frozen=True, eq=False)
class Edge:
    """A frame in its parent over time."""

    stamps_ns: NDArray[np.int64]
    """Stamps (N,), strictly increasing, nanoseconds. One stamp alone means a fixed frame."""
    poses: Poses
    """N transforms `T_parent_child`."""

    def at(self, stamps_ns: NDArray[np.int64]) -> tuple[Poses, NDArray[np.int64]]:
        """Return the poses at these times, and how well each is known."""
        if len(self.stamps_ns) == 1:
            first = np.zeros(len(stamps_ns), dtype=np.int64)
            return self.poses[first], np.full(len(stamps_ns), KNOWN)
        after = np.clip(np.searchsorted(self.stamps_ns, stamps_ns), 1, len(self.stamps_ns) - 1)
        before = after - 1
        t0, t1 = self.stamps_ns[before], self.stamps_ns[after]
        a, b = self.poses[before], self.poses[after]
        same = (np.linalg.norm(b.translation - a.translation, axis=1) <= SAME_M) & (
            (a.rotation.inv() * b.rotation).magnitude() <= SAME_RAD
        )
        nearest = np.where(stamps_ns - t0 <= t1 - stamps_ns, before, after)
        away_s = np.abs(stamps_ns - self.stamps_ns[nearest]) / 1e9
        inside = (t0 <= stamps_ns) & (stamps_ns <= t1)
        gap_s = (t1 - t0) / 1e9
        between = inside & ((gap_s <= GAP_S) | (same & (gap_s <= BRIDGED_S)))
        known = np.where(between, KNOWN, np.where(away_s <= NEAR_S, ALONE, UNKNOWN))
        return self._interpolated(stamps_ns, nearest, between & (away_s > 0)), known

    def _interpolated(
        self, stamps_ns: NDArray[np.int64], nearest: NDArray[np.int64], between: NDArray[np.bool_]
    ) -> Poses:
        """Return the nearest sample, or the interpolation between two. A sample at the very time stays unchanged."""
        contents = self.poses[nearest]
        translation, quaternion = contents.translation.copy(), contents.rotation.as_quat()
        if between.any():
            # seconds since the first sample, because a double of seconds since the epoch is rounded to 200 ns
            known_s = (self.stamps_ns - self.stamps_ns[0]) / 1e9
            wanted_s = (stamps_ns[between] - self.stamps_ns[0]) / 1e9
            for axis in range(3):
                translation[between, axis] = np.interp(wanted_s, known_s, self.poses.translation[:, axis])
            quaternion[between] = Slerp(known_s, self.poses.rotation)(wanted_s).as_quat()
        return Poses(translation, Rotation.from_quat(quaternion))


class TransformTree:
    """All frames of a bag. It is filled by `add` and then queried."""

    def __init__(self) -> None:
        self._samples: dict[tuple[str, str, bool], _Samples] = {}
        """Samples by child, parent, and whether they are static."""
        self._edges: dict[tuple[str, str], Edge] = {}
        self._count = 0

    def add(self, message: Any, static: bool) -> None:
        """Add a TFMessage. Raise BagError for too many samples."""
        for transform in message.transforms:
            self._count += 1
            if self._count > MAX_SAMPLES:
                raise BagError(
                    f"the bag has more than {MAX_SAMPLES} transforms: cut it, or exclude those of other robots"
                )
            stamp, pose = transform.header.stamp, transform.transform
            t, q = pose.translation, pose.rotation
            key = (frame_name(transform.child_frame_id), frame_name(transform.header.frame_id), static)
            samples = self._samples.setdefault(key, _Samples())
            samples.stamps_ns.append(nanoseconds(stamp))
            samples.values.extend((t.x, t.y, t.z, q.x, q.y, q.z, q.w))

    @property
    def frames(self) -> set[str]:
        """Return the names of all frames."""
        return {name for child, parent, _ in self._samples for name in (child, parent)}

    def chain(self, target: str, source: str) -> "Chain":
        """Return the transforms from the frame `source` to the frame `target`.

        Raises:
            BagError: A frame is missing, the frames are not connected, or a transform between them is not valid.
        """
        for name in (target, source):
            if name not in self.frames:
                raise BagError(f"/tf does not contain the frame {shown(name)!r}; its frames: {listed(self.frames)}")
        up, down = self._ancestors(target), self._ancestors(source)
        common = next((name for name in up if name in set(down)), None)
        if common is None:
            raise BagError(
                f"/tf does not connect the frames {shown(target)!r} and {shown(source)!r}: the first is below "
                f"{shown(up[-1])!r}, the second below {shown(down[-1])!r}; frames: {listed(self.frames)}"
            )
        rising = [self._edge(child, parent) for child, parent in _pairs(up, common)]
        falling = [self._edge(child, parent) for child, parent in _pairs(down, common)]
        return Chain(tuple(rising), tuple(reversed(falling)))

    def _parent(self, frame: str) -> str | None:
        parents = {parent for child, parent, _ in self._samples if child == frame}
        if len(parents) > 1:
            raise BagError(
                f"/tf has several parents of the frame {shown(frame)!r}: {listed(parents)}; publish only one of them"
            )
        return next(iter(parents), None)

    def _ancestors(self, frame: str) -> list[str]:
        """Return the frame, its parent, and so on."""
        line, parent = [frame], self._parent(frame)
        while parent is not None:
            if parent in line:
                raise BagError(f"/tf has the frame {shown(parent)!r} below itself")
            line.append(parent)
            parent = self._parent(parent)
        return line

    def _edge(self, child: str, parent: str) -> Edge:
        if (child, parent) not in self._edges:
            where = f"{shown(child)!r} in {shown(parent)!r}"
            moving, fixed = (self._samples.get((child, parent, static)) for static in (False, True))
            edge = _edge(moving or self._samples[child, parent, True], moving is None, where)
            if fixed is not None:
                _check_fixed(edge, _poses(fixed, where), where)
            self._edges[child, parent] = edge
        return self._edges[child, parent]


@dataclass(frozen=True)
class Chain:
    """The edges between two frames, through their nearest common ancestor."""

    rising: tuple[Edge, ...]
    """Edges from the target upwards."""
    falling: tuple[Edge, ...]
    """Edges from the ancestor down to the source."""

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Times (N,) at which any moving edge has a sample, nanoseconds. It is empty if no edge moves."""
        moving = [edge.stamps_ns for edge in (*self.rising, *self.falling) if len(edge.stamps_ns) > 1]
        return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *moving]))

    def at(self, stamps_ns: NDArray[np.int64]) -> tuple[Poses, NDArray[np.int64]]:
        """Return `T_target_source` at these times, and how well each is known."""
        known = np.full(len(stamps_ns), KNOWN)
        result: Poses | None = None
        for edge, upwards in [*((edge, True) for edge in self.rising), *((edge, False) for edge in self.falling)]:
            poses, how = edge.at(stamps_ns)
            step = poses.inverse() if upwards else poses
            result = step if result is None else result @ step
            known = np.minimum(known, how)
        if result is None:
            result = Poses(np.zeros((len(stamps_ns), 3)), Rotation.identity(len(stamps_ns)))
        return result, known


def frame_name(name: str) -> str:
    """Return the name as in ROS 2. The oldest ROS 1 has a leading slash."""
    return name.removeprefix("/")


def nanoseconds(stamp: Any) -> int:
    """Return a ROS time in nanoseconds, without rounding."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _pairs(line: Sequence[str], common: str) -> list[tuple[str, str]]:
    """Return (child, parent) pairs from the first name up to `common`."""
    end = line.index(common)
    return list(pairwise(line[: end + 1]))


def _edge(samples: _Samples, static: bool, where: str) -> Edge:
    """Return the samples in the order of their stamps, and of a static frame the last sample."""
    stamps_ns, poses = np.frombuffer(samples.stamps_ns, dtype=np.int64), _poses(samples, where)
    if static:
        return Edge(stamps_ns[-1:], poses[-1:])
    stamps_ns, first = np.unique(stamps_ns, return_index=True)  # duplicates are dropped
    return Edge(stamps_ns, poses[first])


def _poses(samples: _Samples, where: str) -> Poses:
    """Return the transforms in the order of the samples."""
    values = np.frombuffer(samples.values, dtype=np.float64).reshape(-1, 7)
    if not np.abs(values).max() <= MAX_DISTANCE_M:  # also true for NaN
        raise BagError(
            f"/tf: the pose of {where} holds {np.abs(values).max():g}; metres, and unit quaternions, are needed"
        )
    lengths = np.linalg.norm(values[:, 3:], axis=1)
    if np.abs(lengths - 1).max() > 1e-3:
        worst = lengths[np.abs(lengths - 1).argmax()]
        raise BagError(f"/tf: the pose of {where} has a quaternion of length {worst:.4g}; it must be 1")
    return Poses(values[:, :3], Rotation.from_quat(values[:, 3:]))


def _check_fixed(edge: Edge, fixed: Poses, where: str) -> None:
    """Check that a static transform is the same each time, on /tf_static and on /tf."""
    apart = [edge.poses.distance(0, others) for others in (fixed, edge.poses)]
    apart_m, apart_rad = (max(values) for values in zip(*apart, strict=True))
    if apart_m > LOOSE_M or apart_rad > LOOSE_RAD:
        raise BagError(
            f"the pose of {where}, which /tf_static has as fixed, is given with several values, "
            f"{apart_m * 1000:.1f} mm and {np.degrees(apart_rad):.2f} degrees apart: record the bag without the wrong "
            "publisher or, if it is the pose of the camera on the flange, name a file by --hand-eye"
        )
