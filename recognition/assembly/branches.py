"""Detection of possible branches: ends that may be joined to the side of another strand."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.assembly.chain_ends import DIRECTION_LENGTH_RADII, END_PART_RADII, ChainEnd, open_ends, with_ends
from recognition.assembly.crossings import MAX_FLAT_GAP_SHARE
from recognition.geometry.polyline import close_polyline, end_direction, points_at, resampled_lengths
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.preprocessing.lines_of_sight import count_views
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.visible_gaps import STEP_RADII

MAX_GAP_RADII = 3.0
"""Maximum distance along the axis between an end and the side of a joined strand, in radii of the chain.

The surface of a branch is measured up to its joint, except for some pixels at the edge of the hidden part.
"""
OWN_END_RADII = 6.0
"""Length of a chain that belongs to its end, in radii. The rest of the chain counts as another strand."""


@dataclass(frozen=True, eq=False)
class _Contact:
    """An end whose extension meets the side of a strand."""

    end: ChainEnd
    """The end."""
    trunk: Chain
    """Chain whose side the end meets. It may be the chain of the end."""
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
    kinds = [list(chain.ends) for chain in chains]
    findings: list[Finding] = []
    low = np.array([chain.points.min(axis=0) - chain.radius_m for chain in chains]).reshape(-1, 3)
    high = np.array([chain.points.max(axis=0) + chain.radius_m for chain in chains]).reshape(-1, 3)
    for end in open_ends(chains):
        if end.chain.ends[end.at] == "touching":
            continue
        reach = MAX_GAP_RADII * end.chain.radius_m
        is_near = ((end.point > low - reach) & (end.point < high + reach)).all(axis=1)
        contact = _find_contact(end, [chains[k] for k in np.flatnonzero(is_near).tolist()], views)
        if contact is None:
            continue
        if kinds[end.number][end.at] == "free":
            kinds[end.number][end.at] = "touching"
        findings += _branch_findings(contact)
    return with_ends(chains, kinds), findings


def _find_contact(end: ChainEnd, near: Sequence[Chain], views: Sequence[NormalCloud]) -> _Contact | None:
    """Return the contact of an end with the nearest side ahead of it, or None if there is none or a gap is visible.

    Args:
        end: The end.
        near: Chains that may be within reach of the end.
        views: Registered views.
    """
    r = end.chain.radius_m
    direction = end_direction(end.line, DIRECTION_LENGTH_RADII * r)
    s = np.arange(0.0, MAX_GAP_RADII + STEP_RADII / 2, STEP_RADII) * r
    ahead = end.point + s[:, None] * direction
    contacts = []
    for trunk in near:
        points, trunk_s = _sample_trunk(trunk, end)
        if len(points) == 0:
            continue
        distances, indices = KDTree(points).query(ahead)
        distance = np.asarray(distances)
        hits = np.flatnonzero(distance <= trunk.radius_m)
        if len(hits) == 0:
            continue
        first_hit = int(hits[0])
        side = int(np.asarray(indices)[first_hit])
        is_level = abs(ahead[first_hit, 2] - points[side, 2]) < MAX_FLAT_GAP_SHARE * (r + trunk.radius_m)
        if is_level:
            contacts.append(
                _Contact(
                    end=end,
                    trunk=trunk,
                    s_m=float(trunk_s[side]),
                    point=ahead[first_hit],
                    gap_m=float(s[first_hit]),
                    distance_m=float(distance[0]),
                )
            )
    if not contacts:
        return None
    contact = min(contacts, key=lambda found: found.gap_m)
    between = ahead[s <= contact.gap_m]
    if count_views(between, r, views).is_free.any():
        return None
    return contact


def _sample_trunk(trunk: Chain, end: ChainEnd) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (N, 3) along a chain and their arc lengths (N,), metres, without the part that belongs to `end`."""
    r = end.chain.radius_m
    line = close_polyline(trunk.points, trunk.closed)
    s = resampled_lengths(line, STEP_RADII * r)
    points = points_at(line, s)
    if trunk is not end.chain:
        return points, s
    from_end = s[-1] - s if end.at else s
    is_other = from_end > OWN_END_RADII * r
    return points[is_other], s[is_other]


def _branch_findings(contact: _Contact) -> list[Finding]:
    """Return the doubts about a possible branch: about its end, and about the part of the trunk."""
    end = contact.end
    chain = end.chain
    trunk = contact.trunk
    side = "its own side" if trunk is chain else f"the side of chain {trunk.id}"
    message = (
        f"the {end.name} end of chain {chain.id} meets {side} at {format_position(contact.point)}, "
        f"{contact.s_m * 1000:.0f} mm along chain {trunk.id}: they may be joined; pulling one may move the other"
    )
    part_m = END_PART_RADII * max(chain.radius_m, trunk.radius_m)
    at_side = (max(contact.s_m - part_m, 0.0), min(contact.s_m + part_m, trunk.length_m))
    about_trunk = finding(
        "possible-branch",
        message,
        chains=(trunk.id,),
        s_range_m=at_side,
        point=contact.point,
        value=contact.distance_m,
        limit=trunk.radius_m + MAX_GAP_RADII * chain.radius_m,
    )
    about_end = replace(about_trunk, chains=(chain.id,), end=end.name, s_range_m=end.part_m(part_m))
    return [about_end, about_trunk]
