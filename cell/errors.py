"""What can go wrong in the cell, each with a slug that the service and the command line pass on.

The words say what happened and what a person at the cell can do about it. All can be pickled: they cross from the
device's process to ours.
"""


class CellError(RuntimeError):
    """Something in the cell that keeps a scan from being done."""

    slug = "cell"


class RobotUnreachableError(CellError):
    """No controller answers at the configured address."""

    slug = "robot-unreachable"


class RobotNotReadyError(CellError):
    """The controller answers, but must not or cannot be driven now: local mode, a foreign program, power off ..."""

    slug = "robot-not-ready"


class RobotLostError(CellError):
    """The link to the controller, or the process that holds it, was lost."""

    slug = "robot-lost"


class ProtectiveStopError(CellError):
    """The robot's safety system stopped it; a person must look and acknowledge."""

    slug = "protective-stop"


class EmergencyStopError(CellError):
    """The emergency stop is pressed."""

    slug = "emergency-stop"


class MotionError(CellError):
    """A move was refused by the controller, or did not end where it should."""

    slug = "motion-failed"


STOPPED = "the arm was stopped by request: connect, or start a live scan"


class StoppedError(CellError):
    """Somebody asked for a stop."""

    slug = "stopped"


class TooEarlyError(CellError):
    """A protective stop cannot be acknowledged yet: the robot itself refuses for some seconds."""

    slug = "too-early"

    def __init__(self, message: str, wait_s: float) -> None:
        super().__init__(message, wait_s)
        self.wait_s = wait_s
        """Then it is worth another try."""

    def __str__(self) -> str:
        return self.args[0]


class CameraUnreachableError(CellError):
    """No camera answers, or not the configured one."""

    slug = "camera-unreachable"


class CameraLostError(CellError):
    """The camera, or the process that holds it, was lost while at work."""

    slug = "camera-lost"


class BadFrameError(CellError):
    """The camera gave frames that show nothing: all zero, constant, or never settled."""

    slug = "bad-frame"


class ViewpointsError(CellError):
    """Too few of the viewpoints can be reached."""

    slug = "viewpoints-unreachable"


class MissingViewsError(CellError):
    """Too few views were taken."""

    slug = "insufficient-views"


class CalibrationError(CellError):
    """The hand-eye calibration is missing, too old, of another camera, or changed during the scan."""

    slug = "calibration"


class CellSettingsError(CellError):
    """Settings that contradict one another or cannot be, with the key's name."""

    slug = "config"


class CellBusyError(CellError):
    """The arm is in use."""

    slug = "cell-busy"


class AcknowledgeRequiredError(CellError):
    """There was a fault; a person must look at the cell and acknowledge it first."""

    slug = "acknowledge-required"


class NothingToAcknowledgeError(CellError):
    """There is no fault."""

    slug = "no-fault"
