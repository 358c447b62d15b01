"""Whether the camera is the one told: its focal lengths, its optical axis and how straight its pictures are."""

import numpy as np

from calibration.assessment.evidence import Evidence
from calibration.result import Finding

LARGEST_FOCAL_CHANGE = 0.01
"""Three times the prior: more is no warming up but another lens position, stream or resolution."""
LARGEST_ASPECT_CHANGE = 0.005
"""Of fx / fy, which neither warming up nor focus changes."""
LARGEST_CENTRE_SHIFT = 0.0075
"""Of cx and cy, in focal lengths: five times the prior, 6 pixels at 800. More is a crop or another stream."""
LARGEST_K1 = 0.015
"""Of radial distortion left in the pictures: a camera that is taken for straight with -0.03 is 1 mm off."""
LARGEST_K1_SIGMAS = 6.0
"""So many standard deviations may it be off by chance, by corner noise that is not quite even, by a board not quite
flat."""


def camera_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """What speaks against the camera as told; empty: nothing, or poses alone."""
    findings = []
    if evidence.K is not None and evidence.K_told is not None:
        told = evidence.K_told.diagonal()[:2]
        change = evidence.K.diagonal()[:2] / told - 1.0
        worst = float(change[np.argmax(np.abs(change))])
        aspect = float((1.0 + change[0]) / (1.0 + change[1]) - 1.0)
        if not abs(worst) <= LARGEST_FOCAL_CHANGE:
            findings.append(_focal_length("the focal length is", worst, LARGEST_FOCAL_CHANGE))
        elif not abs(aspect) <= LARGEST_ASPECT_CHANGE:
            findings.append(_focal_length("the ratio of the focal lengths fx and fy is", aspect, LARGEST_ASPECT_CHANGE))
        shift_px = (evidence.K - evidence.K_told)[:2, 2]
        if not np.abs(shift_px / told).max() <= LARGEST_CENTRE_SHIFT:
            findings.append(
                Finding(
                    "optical-axis",
                    f"by the views the optical axis (cx, cy) is ({shift_px[0]:+.1f}, {shift_px[1]:+.1f}) pixels off "
                    f"what the camera tells, and up to {LARGEST_CENTRE_SHIFT * told.min():.1f} is taken: take K of the "
                    "same camera, stream, crop and resolution as the pictures",
                    refuses=True,
                )
            )
    if evidence.k1 is not None and evidence.k1_sigma is not None:
        limit = max(LARGEST_K1, LARGEST_K1_SIGMAS * evidence.k1_sigma)
        if not abs(evidence.k1) <= limit:
            findings.append(
                Finding(
                    "lens-distortion",
                    f"by the views the pictures are still bent by the lens (k1 = {evidence.k1:+.3f}), and up to "
                    f"{limit:.3f} is taken: give the distortion coefficients that belong to these pictures, or "
                    "rectified pictures with their own K; where those are right the board is bent, lay it flat",
                    refuses=True,
                )
            )
    return tuple(findings)


def _focal_length(what: str, off: float, limit: float) -> Finding:
    return Finding(
        "focal-length",
        f"by the views {what} {100 * off:+.2f} % off what the camera tells, and up to {100 * limit:g} % is taken: take "
        "K of the same stream and resolution, lock the focus, measure the board",
        refuses=True,
    )
