"""What follows when a person has looked at the cell and acknowledged a fault: the only place that unlocks a robot."""

import time

from cell.arm.dashboard import Dashboard, no_program_left
from cell.arm.preflight import robot_mode, safety_mode
from cell.arm.robot_modes import UNLOCK_S, mode_error
from cell.errors import CellError, RobotNotReadyError, TooEarlyError

ANSWERS_S = 2.5
"""The dashboard's answers have come in this time, or it is not reachable."""
SEEN_LATER_S = 0.2
"""A stop is seen so long after it happened at the most."""
RELEASE_S = 3.0
"""After unlocking, the robot is back to normal in this time."""


def acknowledge_protective_stop(address: str, seen_s: float | None, program_ours: bool) -> None:
    """Ends the program, then unlocks a protective stop. Without one, only a program of ours is ended. No motion.

    A protective stop only pauses the program: played on, it would finish its old motion. So it is ended first, whether
    or not the robot lets itself be unlocked yet; while it is there nothing is unlocked. `seen_s`: when the stop was
    first seen, of `time.monotonic()`.

    Raises: TooEarlyError, RobotNotReadyError, EmergencyStopError, RobotUnreachableError; ProtectiveStopError when the
    robot has let itself be unlocked and is stopped all the same.
    """
    with Dashboard(address, time.monotonic() + ANSWERS_S) as dashboard:
        mode = safety_mode(dashboard)
        locked = mode == "protective_stop"
        # Asked before the program is ended: in local mode the robot refuses that.
        if locked and dashboard.ask("is in remote control").lower() != "true":
            raise RobotNotReadyError("the robot is in local mode: unlock it at its pendant")
        answer = dashboard.ask("stop") if program_ours or locked else None
        error = None if locked else mode_error(robot_mode(dashboard), mode)
        if error is not None:
            raise error
        if answer is not None and not no_program_left(answer) and not _stopped(dashboard):
            raise RobotNotReadyError(
                f"the robot does not end the program that is still on it ({answer}): stop it at the pendant, then "
                "acknowledge again"
            )
        if not locked:
            return
        wait_s = 0.0 if seen_s is None else seen_s + UNLOCK_S - time.monotonic()
        # Towards the end of the wait the robot knows better: it was stopped a moment before that was seen.
        if wait_s > SEEN_LATER_S:
            raise TooEarlyError(
                f"the robot cannot be unlocked earlier than {UNLOCK_S:g} s after its stop: try again in {wait_s:.1f} s",
                wait_s,
            )
        if "releasing" not in dashboard.ask("unlock protective stop").lower():
            again_s = UNLOCK_S if seen_s is None else max(wait_s, SEEN_LATER_S)
            raise TooEarlyError(f"the robot does not let itself be unlocked yet: try again in {again_s:.1f} s", again_s)
    with Dashboard(address, time.monotonic() + RELEASE_S) as dashboard:
        dashboard.ask("close safety popup")
        error = _after_release(dashboard)
    if error is not None:
        raise error


def _stopped(dashboard: Dashboard) -> bool:
    return dashboard.ask("programState").startswith("STOPPED")


def _after_release(dashboard: Dashboard) -> CellError | None:
    """What still keeps the robot from being driven once its release has had its time."""
    limit_s = time.monotonic() + RELEASE_S - 0.5
    while True:
        error = mode_error(robot_mode(dashboard), safety_mode(dashboard))
        if error is None or time.monotonic() > limit_s:
            return error
        time.sleep(0.05)
