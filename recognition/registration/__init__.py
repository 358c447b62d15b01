"""Registration of all views (section II.E of the paper).

The input is the points with normals of each view, and the camera poses. The output is one merged cloud, the corrected
view clouds with the covariance of their poses, the reasons of excluded views, and an estimate of the hand-eye error.
The paper registers one cloud after the other by ICP. The joint least squares with a pose prior, the free-space check
and the check of the robot errors are not in the paper.
"""

from recognition.registration.correspondences import Correspondences
from recognition.registration.hand_eye_error import HandEyeErrorEstimate
from recognition.registration.pose_prior import PoseSigmas
from recognition.registration.registration import Registration, register

__all__ = ["Correspondences", "HandEyeErrorEstimate", "PoseSigmas", "Registration", "register"]
