"""Acceptance of the camera: compare focal lengths, optical axis and distortion with the given intrinsics."""

import numpy as np

from calibration.assessment.evidence import Evidence
from calibration.result import Finding

MAX_FOCAL_CHANGE = 0.01
"""Maximum relative change of a focal length, about three times the prior sigma. A larger change is not due to warm-up:
the focus, the stream or the resolution differs."""
MAX_ASPECT_CHANGE = 0.005
"""Maximum relative change of fx / fy. Warm-up and focus do not change this ratio."""
MAX_CENTRE_SHIFT = 0.0075
"""Maximum shift of cx and cy, in focal lengths. It is five times the prior sigma, and 6 pixels for a focal length of
800 pixels. A larger shift means a crop or another stream."""
MAX_K1 = 0.015
"""Maximum residual radial distortion k1. An uncorrected k1 of -0.03 causes an error of 1 mm."""
MAX_K1_SIGMAS = 6.0
"""Maximum residual distortion that noise may cause, in standard deviations of k1. The limit allows for uneven corner
noise and a slightly bent board."""


def camera_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Return the findings against the given intrinsics.

    Args:
        evidence: Solution and views of the calibration.
    """
    findings = []
    given = evidence.K_nominal.diagonal()[:2]
    change = evidence.K.diagonal()[:2] / given - 1.0
    worst = float(change[np.argmax(np.abs(change))])
    aspect = float((1.0 + change[0]) / (1.0 + change[1]) - 1.0)
    if not abs(worst) <= MAX_FOCAL_CHANGE:
        findings.append(_focal_length("the focal length is", worst, MAX_FOCAL_CHANGE))
    elif not abs(aspect) <= MAX_ASPECT_CHANGE:
        findings.append(_focal_length("the ratio of the focal lengths fx and fy is", aspect, MAX_ASPECT_CHANGE))
    shift_px = (evidence.K - evidence.K_nominal)[:2, 2]
    if not np.abs(shift_px / given).max() <= MAX_CENTRE_SHIFT:
        findings.append(
            Finding(
                "optical-axis",
                f"by the views, the optical axis (cx, cy) is ({shift_px[0]:+.1f}, {shift_px[1]:+.1f}) pixels from the "
                f"given one, and at most {MAX_CENTRE_SHIFT * given.min():.1f} is accepted: use K of the "
                "same camera, stream, crop and resolution as the images",
                blocking=True,
            )
        )
    limit = max(MAX_K1, MAX_K1_SIGMAS * evidence.k1_sigma)
    if not abs(evidence.k1) <= limit:
        findings.append(
            Finding(
                "lens-distortion",
                f"by the views, the images still have radial distortion (k1 = {evidence.k1:+.3f}), and at most "
                f"{limit:.3f} is accepted: give the distortion coefficients of these images, or "
                "rectified images with their own K; if those are right, the board is bent: lay it flat",
                blocking=True,
            )
        )
    return tuple(findings)


def _focal_length(subject: str, change: float, limit: float) -> Finding:
    """Return the finding about a focal length or about fx / fy. `change` and `limit` are relative."""
    return Finding(
        "focal-length",
        f"by the views, {subject} {100 * change:+.2f} % from the given one, and at most {100 * limit:g} % is accepted: "
        "use K of the same stream and resolution, lock the focus, measure the board",
        blocking=True,
    )
