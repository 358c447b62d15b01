"""Check of the depth: whether the camera measures its table as well as a simulated camera of the same kind."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.camera_profile.comparison import Compared, compare
from cell.camera_profile.depth_profile import DepthProfile, ProfileError, format_quantity, to_document
from cell.camera_profile.measure import PoseImages, SeenTable, TablePose, measure_profile
from cell.devices import Burst
from cell.self_test.check_result import CheckContext, CheckResult, ok

NAME = "depth quality"
EXPOSURES = 5
"""Number of exposures that are compared. As many are simulated."""
MOVE_NEARER = "move the arm by hand (freedrive) until the camera is within camera.working_m of the table"


def depth_quality(context: CheckContext) -> CheckResult:
    """Compare the table with that of a simulated camera of the same kind, at the same distance and with its optics."""
    frame, burst = context.frame, context.burst
    assert frame is not None
    assert burst is not None
    images = PoseImages(burst.depth[:EXPOSURES], burst.depth_unit_m, frame.K)
    try:
        first = measure_profile([images])
    except ProfileError as error:
        reason, _, advice = str(error).partition(": ")
        return CheckResult(NAME, "skipped", reason, advice or None)
    expected = context.equipment.expected_profiles(_seen(burst, frame.K, first.tables[0]))
    if not expected:
        return CheckResult(NAME, "skipped", "no simulated camera of this kind sees a table from there", MOVE_NEARER)
    # with the known focal length and baseline, errors have a size in disparities too
    measured = measure_profile([images], expected[0].focal_baseline_px_m).profile
    return quality_found(measured, expected, context.settings.camera.optics.working_m[1])


def quality_found(measured: DepthProfile, expected: Sequence[DepthProfile], farthest_m: float) -> CheckResult:
    """Return the result for a measured profile.

    Args:
        measured: Profile of the camera of the cell.
        expected: Profiles of simulated cameras of its kind on textured tables.
        farthest_m: Largest distance from which strings are seen well.
    """
    compared = compare(measured, expected)
    lines = [f"{'':<22}{'measured':<12}expected"]
    for one in compared:
        name = one.quantity.field
        low, high = format_quantity(name, one.low), format_quantity(name, one.high)
        span = low if low == high else f"{low} to {high}"
        lines.append(f"{one.quantity.name:<22}{format_quantity(name, one.measured):<12}{span}")
    worse = [one for one in compared if not one.is_good]
    if any(one.quantity.field == "ripple_m" for one in worse):
        # wrong matches over wide parts of the image look like a warp
        worse = [one for one in worse if one.quantity.field != "warp_m"]
    warnings = [_warning(one) for one in worse]
    if worse and measured.distance_m > farthest_m:
        warnings.append(f"the table is {measured.distance_m:.2f} m away, beyond camera.working_m: {MOVE_NEARER}")
    figures: dict[str, Any] = {
        "as_expected": not worse,
        "measured": to_document(measured),
        "expected": [to_document(profile) for profile in expected],
        "above_limit": [one.quantity.field for one in worse],
    }
    verdict = "the stated accuracy may not be expected" if worse else "the stated accuracy may be expected"
    lines.append(f"for a table {measured.distance_m:.2f} m away: {verdict}")
    return ok(NAME, "\n".join(lines), warnings, figures)


def _warning(one: Compared) -> str:
    """Return what is wrong with a quantity and, after a colon, what to do."""
    quantity = one.quantity
    return f"{quantity.name} above {format_quantity(quantity.field, one.limit)}: {quantity.advice}"


def _seen(burst: Burst, K: NDArray[np.float64], pose: TablePose) -> SeenTable:
    """Return the table and the images of a burst."""
    count, height, width = burst.depth.shape
    return SeenTable(pose, K, (width, height), burst.depth_unit_m, min(count, EXPOSURES))
