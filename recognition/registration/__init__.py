"""Registration of all views (section II.E of the paper).

The normal clouds of the views with their given camera poses go in. One merged cloud, the corrected clouds with the
covariance of their poses, the reasons of excluded views and an estimate of the hand-eye error come out. The paper
registers one cloud after the other by ICP; the joint least squares with a pose prior and both checks are ours.
"""

from recognition.registration.correspondences import Correspondences
from recognition.registration.hand_eye_error import HandEyeErrorEstimate
from recognition.registration.pose_prior import PoseSigmas
from recognition.registration.registration import Registration, register

__all__ = ["Correspondences", "HandEyeErrorEstimate", "PoseSigmas", "Registration", "register"]
