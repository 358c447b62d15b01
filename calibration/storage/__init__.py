"""The hand-eye calibration as a JSON document and as a file.

A solved calibration, or a transform alone, is written to a hand-eye file. The file is read back as a `HandEye` that may
be used: not refused, not too old, of the right camera and robot. Activation replaces the file in use in one step.
"""

from calibration.storage.document import result_document
from calibration.storage.hand_eye_file import HandEye, activate, load_hand_eye, require_match
from calibration.storage.writer import write_hand_eye, write_result

__all__ = [
    "HandEye",
    "activate",
    "load_hand_eye",
    "require_match",
    "result_document",
    "write_hand_eye",
    "write_result",
]
