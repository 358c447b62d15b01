"""Detection of sharp bends, at which a chain may have changed to the wrong strand."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, unit_vectors
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.model.finding_types import FindingCode
from recognition.model.findings import Finding, finding

MAX_LOOSE_BEND_RAD = np.radians(75)
"""Maximum bend angle at a point of a string that is not pulled tight, radians. Its bend radius is about 1.5 radii."""
MAX_BEND_RAD = 2.0
"""Maximum bend angle at a point of any string, radians. The bend radius is then the radius of the string: in a sharper
bend, the inner side of a round string would run backwards."""
DIRECTION_RADII = 2.0
"""Length before and after a point over which the directions are measured, in radii."""
MIN_SPACING_M = 1e-9
"""Lower limit of the distance between two points of a chain, metres. It prevents division by zero."""


def sharp_bend_findings(chains: Sequence[Chain]) -> list[Finding]:
    """Return a finding on each bend that is sharper than a loose string, or than any string, can have.

    The bend angle at a point is the angle between two directions: over two radii before and two radii after the point.
    At a bend above `MAX_LOOSE_BEND_RAD`, a chain may have taken the wrong strand, or the string is pulled tight around
    another one. Above `MAX_BEND_RAD`, it has probably taken the wrong strand.

    Args:
        chains: Chains of the model. Chains shorter than four radii are not checked.

    Returns:
        For each bend, a finding with its position. It concerns the part of the chain from two radii before to two radii
        after the point.
    """
    findings = []
    for chain in chains:
        spacing = chain.length_m / max(len(chain.points) - 1, 1)
        step = max(round(DIRECTION_RADII * chain.radius_m / max(spacing, MIN_SPACING_M)), 1)
        if len(chain.points) <= 2 * step:
            continue
        line = chain.points
        if chain.closed:
            # The bends of a closed chain include the bends at its first and its last points.
            line = np.vstack([line, line[: 2 * step]])
        directions = unit_vectors(line[step:] - line[:-step])
        angles = np.arccos(np.clip((directions[step:] * directions[:-step]).sum(axis=1), -1, 1))
        s = arc_length(line)
        # Angle k is that at the point k + step.
        for k in _separate_maxima(angles, 2 * step, chain.closed):
            s_range_m = (float(s[k]), float(s[k + 2 * step]))
            findings.append(_bend_finding(chain.id, line[k + step], float(angles[k]), s_range_m))
    return findings


def _separate_maxima(angles: NDArray[np.float64], apart: int, closed: bool) -> Iterator[int]:
    """Yield the indices of the angles (N,) above the limit of loose strings, the largest first.

    Of angles whose indices differ by at most `apart`, only the largest counts. On a closed chain, the last index is
    beside the first.
    """
    rest = angles.copy()
    while rest.max() > MAX_LOOSE_BEND_RAD:
        k = int(rest.argmax())
        yield k
        distance = np.abs(np.arange(len(angles)) - k)
        if closed:
            distance = np.minimum(distance, len(angles) - distance)
        rest[distance <= apart] = 0.0


def _bend_finding(chain: int, point: NDArray[np.float64], angle: float, s_range_m: tuple[float, float]) -> Finding:
    """Return the finding on a bend: a doubt if only a string that is pulled tight bends so, else a blocking finding."""
    if angle <= MAX_BEND_RAD:
        code: FindingCode = "tight-bend"
        reason = "it may have taken the wrong strand at a crossing, unless it is pulled tight there"
        limit = MAX_LOOSE_BEND_RAD
    else:
        code = "sharp-bend"
        reason = "no string bends so, and it has probably taken the wrong strand at a crossing"
        limit = MAX_BEND_RAD
    return finding(
        code,
        f"chain {chain} bends sharply at {format_position(point)}: {reason}",
        chains=(chain,),
        s_range_m=s_range_m,
        point=point,
        value=angle,
        limit=limit,
    )
