"""Check of frame rate and number of exposures: what the median of several exposures is worth with this camera."""

import time
from typing import Any

from cell.config.camera_config import CameraSettings
from cell.self_test.camera_checks import AT_THIS_POSE, TURN_IT, looks_elsewhere
from cell.self_test.check_result import CheckContext, CheckResult, ok
from cell.self_test.exposure_noise import ExposureNoise, measure_noise, recommended_exposures

NAME = "exposures"
BURST = 25
"""Number of exposures that are measured. The noise of a median of five then comes from five medians."""
MIN_RATE_SHARE = 0.9
"""Smallest measured frame rate relative to the configured one."""
SHOW_EDGES = "no number is recommended, because few edges are in view: lay a string on the table and check again"


def exposures(context: CheckContext) -> CheckResult:
    """Check the frame rate, and recommend a number of exposures. Nothing moves."""
    if looks_elsewhere(context):
        return CheckResult(NAME, "skipped", f"{AT_THIS_POSE}, the camera does not look at the workspace", TURN_IT)
    burst = context.equipment.camera.burst(BURST, time.monotonic())
    rate = (len(burst.began_s) - 1) / float(burst.began_s[-1] - burst.began_s[0])
    return noise_found(measure_noise(burst.depth, burst.depth_unit_m), rate, context.settings.camera)


def noise_found(noise: ExposureNoise | None, rate: float, settings: CameraSettings) -> CheckResult:
    """Return the result for a measured noise and frame rate.

    Args:
        noise: Measured noise, or None if no table was found.
        rate: Measured frame rate, images/s.
        settings: Configured frame rate and number of exposures.
    """
    configured, fps = settings.exposures, settings.frame_rate
    period_s = 1 / min(rate, fps)
    warnings = []
    renders = settings.rendering_s > 0
    if rate < MIN_RATE_SHARE * fps and not renders:
        warnings.append(
            f"the camera sends {rate:.1f} instead of {fps:g} images/s: connect it directly by USB 3, end other load on "
            f"this computer, add light, or set camera.fps to {max(rate, 1.0):.0f}"
        )
    figures: dict[str, Any] = {
        "frame_rate": rate,
        "configured_frame_rate": fps,
        "configured_exposures": configured,
        "recommended_exposures": None,
    }
    message = f"{rate:.1f} images/s"
    if renders:
        message += ", as fast as this computer matches the rendered images"
    if noise is None:
        return ok(NAME, f"{message}; no table is in view, so that no noise was measured", warnings, figures)
    wanted = recommended_exposures(noise)
    figures |= {
        "recommended_exposures": wanted,
        "fixed_noise_m": noise.fixed_m,
        "table_pixels": noise.table_pixels,
        "edge_pixels": noise.edge_pixels,
        "medians": [
            {
                "exposures": one.exposures,
                "time_s": one.exposures * period_s,
                "noise_m": one.total_m,
                "temporal_noise_m": one.temporal_m,
                "flicker_share": one.flicker_share,
            }
            for one in noise.medians
        ],
    }
    lines = [
        f"{message}; noise on the table that is the same in every exposure: {1000 * noise.fixed_m:.2f} mm",
        "exposures  time a view  noise on the table  changing part  flicker at edges",
    ]
    for one in noise.medians:
        flicker = "unknown" if one.flicker_share is None else f"{100 * one.flicker_share:.1f} %"
        total, changing = (f"{1000 * value_m:.2f} mm" for value_m in (one.total_m, one.temporal_m))
        lines.append(f"{one.exposures:<11}{f'{one.exposures * period_s:.2f} s':<13}{total:<20}{changing:<15}{flicker}")
    if wanted is None:
        lines.append(SHOW_EDGES)
    elif wanted < configured:
        saved_s = (configured - wanted) * period_s
        lines.append(f"{wanted} would do, {configured} are configured: {wanted} would save {saved_s:.2f} s a view")
    else:
        lines.append(f"{wanted} recommended, {configured} configured")
        if wanted > configured:
            warnings.append(f"camera.exposures is too small: set it to {wanted}")
    return ok(NAME, "\n".join(lines), warnings, figures)
