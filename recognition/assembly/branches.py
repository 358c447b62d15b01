"""Detection of possible branches: ends that may be joined to the side of another strand."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.assembly.chain_ends import DIRECTION_LENGTH_RADII, END_PART_RADII, WHICH
from recognition.assembly.crossings import MAX_FLAT_GAP_SHARE
from recognition.geometry.polyline import close_polyline, end_direction, points_at, resampled_lengths
from recognition.messages import format_position
from recognition.model.chains import Chain, End
from recognition.model.findings import Finding, Which, finding
from recognition.preprocessing.lines_of_sight import count_views
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.visible_gaps import STEP_RADII

MAX_GAP_RADII = 3.0
"""Maximum distance along the axis between an end and the side of a joined strand, in radii of the chain.

The surface of a branch is measured up to its joint, except for some pixels at the edge of the hidden part.
"""
OWN_END_RADII = 6.0
"""Length of a chain that belongs to its end, in radii. The rest of the chain counts as another strand."""


@dataclass(frozen=True)
class _Contact:
    """An end whose extension meets the side of a strand."""

    chain: int
    """Index of the chain with the end."""
    at: int
    """0 for the first end of the chain, 1 for the last."""
    trunk: int
    """Index of the chain whose side the end meets. It may be the same chain."""
    s_m: float
    """Arc length along the trunk, metres."""
    point: NDArray[np.float64]
    """(3,) position on the side of the trunk, metres, base frame."""
    gap_m: float
    """Distance along the axis between the end and the side, metres; 0 if the end lies on the side."""
    distance_m: float
    """Distance between the end and the centre line of the trunk, metres."""


def mark_branches(chains: Sequence[Chain], views: Sequence[NormalCloud]) -> tuple[tuple[Chain, ...], list[Finding]]:
    """Mark an end as `touching` if it may be joined to the side of another strand.

    A string that ends at the side of a strand at the same height may be a branch of it, as in a cable harness, or may
    only lie there. The surfaces of both look alike. The data exclude a joint in two cases: the height differs, or half
    of the views look through a gap between the end and the side.

    Args:
        chains: Chains of the model.
        views: Registered views. Without their depth images, no gap is visible.

    Returns:
        The chains with the marked ends. An `unobserved` end stays `unobserved`. For each possible branch, a doubt about
        its end and a doubt about the part of the other strand.
    """
    kinds: list[list[End]] = [list(chain.ends) for chain in chains]
    findings: list[Finding] = []
    low = np.array([chain.points.min(axis=0) - chain.radius_m for chain in chains]).reshape(-1, 3)
    high = np.array([chain.points.max(axis=0) + chain.radius_m for chain in chains]).reshape(-1, 3)
    for number, chain in enumerate(chains):
        for at in () if chain.closed else (0, 1):
            reach = MAX_GAP_RADII * chain.radius_m
            end = chain.points[-at]
            near = np.flatnonzero(((end > low - reach) & (end < high + reach)).all(axis=1)).tolist()
            contact = None if chain.ends[at] == "touching" else _find_contact(chains, number, at, near, views)
            if contact is None:
                continue
            if kinds[number][at] == "free":
                kinds[number][at] = "touching"
            findings += _branch_findings(contact, chains)
    return tuple(replace(chain, ends=(a, b)) for chain, (a, b) in zip(chains, kinds, strict=True)), findings


def _find_contact(
    chains: Sequence[Chain], number: int, at: int, near: Sequence[int], views: Sequence[NormalCloud]
) -> _Contact | None:
    """Return the contact of an end with the nearest side ahead of it, or None if there is none or a gap is visible.

    Args:
        chains: Chains of the model.
        number: Index of the chain with the end.
        at: 0 for its first end, 1 for its last.
        near: Indices of the chains that may be within reach of the end.
        views: Registered views.
    """
    chain = chains[number]
    r = chain.radius_m
    line = chain.points[:: -1 if at else 1]
    direction = end_direction(line, DIRECTION_LENGTH_RADII * r)
    s = np.arange(0.0, MAX_GAP_RADII + STEP_RADII / 2, STEP_RADII) * r
    ahead = line[0] + s[:, None] * direction
    contacts = []
    for trunk in near:
        other = chains[trunk]
        points, s_trunk = _sampled(other, STEP_RADII * r)
        if trunk == number:
            from_end = s_trunk[-1] - s_trunk if at else s_trunk
            points, s_trunk = points[from_end > OWN_END_RADII * r], s_trunk[from_end > OWN_END_RADII * r]
        if len(points) == 0:
            continue
        distance, nearest = KDTree(points).query(ahead)
        hits = np.flatnonzero(np.asarray(distance) <= other.radius_m)
        if len(hits) == 0:
            continue
        k = int(hits[0])
        side = int(np.asarray(nearest)[k])
        is_level = abs(ahead[k, 2] - points[side, 2]) < MAX_FLAT_GAP_SHARE * (r + other.radius_m)
        if is_level:
            contacts.append(
                _Contact(number, at, trunk, float(s_trunk[side]), ahead[k], float(s[k]), float(np.asarray(distance)[0]))
            )
    if not contacts:
        return None
    contact = min(contacts, key=lambda found: found.gap_m)
    between = ahead[s <= contact.gap_m]
    return None if count_views(between, r, views).is_free.any() else contact


def _sampled(chain: Chain, step: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (N, 3) along a chain and their arc lengths (N,), metres."""
    line = close_polyline(chain.points, chain.closed)
    s = resampled_lengths(line, step)
    return points_at(line, s), s


def _branch_findings(contact: _Contact, chains: Sequence[Chain]) -> list[Finding]:
    """Return the doubts about a possible branch: about its end, and about the part of the trunk."""
    chain, trunk = chains[contact.chain], chains[contact.trunk]
    r = max(chain.radius_m, trunk.radius_m)
    other = "its own side" if trunk is chain else f"the side of chain {trunk.id}"
    message = (
        f"the {WHICH[contact.at]} end of chain {chain.id} meets {other} at {format_position(contact.point)}, "
        f"{contact.s_m * 1000:.0f} mm along chain {trunk.id}: they may be joined; pulling one may move the other"
    )
    length, part = chain.length_m, END_PART_RADII * r
    at_end = (max(length - part, 0.0), length) if contact.at else (0.0, min(part, length))
    at_side = (max(contact.s_m - part, 0.0), min(contact.s_m + part, trunk.length_m))
    parts: tuple[tuple[Chain, Which | None, tuple[float, float]], ...] = (
        (chain, WHICH[contact.at], at_end),
        (trunk, None, at_side),
    )
    return [
        finding(
            "possible-branch",
            message,
            chains=(found.id,),
            end=which,
            s_range_m=s_range_m,
            point=contact.point,
            value=contact.distance_m,
            limit=trunk.radius_m + MAX_GAP_RADII * chain.radius_m,
        )
        for found, which, s_range_m in parts
    ]
