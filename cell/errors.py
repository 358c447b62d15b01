"""Errors of the cell, each with a code that the service and the command line pass on.

A message says what happened and what a person at the cell can do. Every error can be pickled, because errors cross from
a driver's child process to the parent.
"""


class CellError(RuntimeError):
    """The cell cannot do what was requested."""

    slug = "cell"


class RobotUnreachableError(CellError):
    """No controller answers at the configured address."""

    slug = "robot-unreachable"


class RobotNotReadyError(CellError):
    """The controller answers but cannot be driven now: local control, another program, no power."""

    slug = "robot-not-ready"


class RobotLostError(CellError):
    """The link to the controller broke, or the driver's process ended."""

    slug = "robot-lost"


class ProtectiveStopError(CellError):
    """The robot is in a protective stop. A person must inspect the cell and acknowledge it."""

    slug = "protective-stop"


class EmergencyStopError(CellError):
    """The robot is in an emergency stop."""

    slug = "emergency-stop"


class MotionError(CellError):
    """The controller rejected a move, or the move did not end at its target."""

    slug = "motion-failed"


STOPPED = "the arm was stopped by request: connect, or start a live scan"


class StoppedError(CellError):
    """A stop was requested."""

    slug = "stopped"


class TooEarlyError(CellError):
    """The robot does not allow the acknowledgement of a protective stop yet."""

    slug = "too-early"

    def __init__(self, message: str, wait_s: float) -> None:
        super().__init__(message, wait_s)
        self.wait_s = wait_s
        """Time to wait before the next attempt."""

    def __str__(self) -> str:
        return self.args[0]


class CameraUnreachableError(CellError):
    """No camera answers, or not the configured one."""

    slug = "camera-unreachable"


class CameraLostError(CellError):
    """The link to the camera broke, or the driver's process ended."""

    slug = "camera-lost"


class BadFrameError(CellError):
    """The frames of the camera show nothing, for example all zero or constant."""

    slug = "bad-frame"


class ViewpointsError(CellError):
    """Too few viewpoints are reachable."""

    slug = "viewpoints-unreachable"


class MissingViewsError(CellError):
    """Too few views were taken."""

    slug = "insufficient-views"


class CalibrationError(CellError):
    """The hand-eye calibration is missing, too old, of another camera or robot, or changed during the scan."""

    slug = "calibration"


class CellSettingsError(CellError):
    """Settings contradict one another or are impossible. The message names the key."""

    slug = "config"


class CellBusyError(CellError):
    """Another operation uses the arm."""

    slug = "cell-busy"


class AcknowledgeRequiredError(CellError):
    """A fault must be acknowledged first, by a person who has inspected the cell."""

    slug = "acknowledge-required"


class NothingToAcknowledgeError(CellError):
    """There is no fault to acknowledge."""

    slug = "no-fault"
