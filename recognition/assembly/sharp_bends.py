"""Detection of sharp bends, at which a chain may have changed to the wrong strand."""

from collections.abc import Sequence

import numpy as np

from recognition.geometry.polyline import arc_length, unit_vectors
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding

MAX_BEND_RAD = np.radians(75)
"""Maximum bend angle at a point of a string, radians. A larger angle needs a bend radius below about 1.5 radii."""


def sharp_bend_findings(chains: Sequence[Chain]) -> list[Finding]:
    """Return a finding on each chain that bends more sharply than a string can.

    The bend angle at a point is the angle between two directions: over two radii before and two radii after the point.
    A chain with a bend above `MAX_BEND_RAD` may have taken the wrong strand there.

    Args:
        chains: Chains of the model. Chains shorter than four radii are not checked.

    Returns:
        At most one finding for each chain, with the position of its sharpest bend. It concerns the part of the chain
        from two radii before to two radii after the point.
    """
    findings = []
    for chain in chains:
        step = max(round(2 * chain.radius_m / max(chain.length_m / max(len(chain.points) - 1, 1), 1e-9)), 1)
        if len(chain.points) <= 2 * step:
            continue
        # The bends of a closed chain include the bends at its first and its last points.
        line = np.vstack([chain.points, chain.points[: 2 * step]]) if chain.closed else chain.points
        directions = unit_vectors(line[step:] - line[:-step])
        cosine = (directions[step:] * directions[:-step]).sum(axis=1)
        sharpest = int(cosine.argmin())
        if cosine[sharpest] < np.cos(MAX_BEND_RAD):
            point, s = line[sharpest + step], arc_length(line)
            message = (
                f"chain {chain.id} bends sharply at {format_position(point)}: it may have taken the wrong strand at a "
                "crossing"
            )
            findings.append(
                finding(
                    "sharp-bend",
                    message,
                    chains=(chain.id,),
                    s_range_m=(s[sharpest], s[sharpest + 2 * step]),
                    point=point,
                    value=np.arccos(np.clip(cosine[sharpest], -1, 1)),
                    limit=MAX_BEND_RAD,
                )
            )
    return findings
