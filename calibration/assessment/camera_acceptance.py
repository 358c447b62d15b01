"""Acceptance of the camera: whether focal lengths, optical axis and distortion are those that were given."""

import numpy as np

from calibration.assessment.evidence import Evidence
from calibration.result import Finding

MAX_FOCAL_CHANGE = 0.01
"""Maximum change of a focal length, as a share: three times the prior. More is not warm-up but another focus, stream or
resolution."""
MAX_ASPECT_CHANGE = 0.005
"""Maximum change of fx / fy, as a share. Neither warm-up nor focus changes this ratio."""
MAX_CENTRE_SHIFT = 0.0075
"""Maximum shift of cx and cy, in focal lengths: five times the prior, 6 pixels at 800. More is a crop or another
stream."""
MAX_K1 = 0.015
"""Maximum residual radial distortion. A distortion of -0.03 that is ignored makes an error of 1 mm."""
MAX_K1_SIGMAS = 6.0
"""Residual distortion, in sigmas, that noise may cause, with uneven corner noise and a board that is not quite flat."""


def camera_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Return the findings against the given intrinsics.

    Args:
        evidence: The solution and the views that it was solved from.
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
    """Return the finding about a focal length, or the ratio of both."""
    return Finding(
        "focal-length",
        f"by the views, {subject} {100 * change:+.2f} % from the given one, and at most {100 * limit:g} % is accepted: "
        "use K of the same stream and resolution, lock the focus, measure the board",
        blocking=True,
    )
