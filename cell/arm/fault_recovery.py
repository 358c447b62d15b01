"""Recovery after a fault that a person has acknowledged. Only this file unlocks a robot."""

import time

from cell.arm.dashboard import Dashboard, no_program_left
from cell.arm.preflight import robot_mode, safety_mode
from cell.arm.robot_modes import UNLOCK_S, mode_error
from cell.errors import CellError, RobotNotReadyError, TooEarlyError

ANSWERS_S = 2.5
"""Timeout for the answers of the dashboard server."""
SEEN_LATER_S = 0.2
"""Longest time from a protective stop until it is noticed."""
RELEASE_S = 3.0
"""Longest time from unlocking until the robot is back to normal."""


def acknowledge_protective_stop(address: str, seen_s: float | None, program_ours: bool) -> None:
    """End the program, then unlock a protective stop. The arm does not move.

    A protective stop only pauses the program, which would finish its old motion when it continues. The program is
    therefore ended first, and nothing is unlocked while it is there. Without a protective stop, only our own program is
    ended.

    Args:
        address: IP address of the controller.
        seen_s: Time at which the stop was first noticed, seconds of `time.monotonic()`, or None.
        program_ours: Whether our program may be on the controller.

    Raises:
        TooEarlyError: The robot cannot be unlocked yet.
        RobotNotReadyError: The robot is in local mode, keeps its program, or is not ready for another reason.
        EmergencyStopError: An emergency stop is pressed.
        ProtectiveStopError: The robot was unlocked and is in a protective stop again.
        RobotUnreachableError: The dashboard server does not answer.
    """
    with Dashboard(address, time.monotonic() + ANSWERS_S) as dashboard:
        mode = safety_mode(dashboard)
        locked = mode == "protective_stop"
        # queried before the program is ended, which a robot in local mode rejects
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
        # at the end of the wait the robot decides: it was stopped a moment before that was noticed
        if wait_s > SEEN_LATER_S:
            raise TooEarlyError(
                f"the robot cannot be unlocked earlier than {UNLOCK_S:g} s after its stop: try again in {wait_s:.1f} s",
                wait_s,
            )
        if "releasing" not in dashboard.ask("unlock protective stop").lower():
            # after the end of the wait, the robot was stopped a second time, which nobody noticed
            unnoticed = seen_s is None or wait_s < -SEEN_LATER_S
            again_s = UNLOCK_S if unnoticed else max(wait_s, SEEN_LATER_S)
            raise TooEarlyError(f"the robot cannot be unlocked yet: try again in {again_s:.1f} s", again_s)
    with Dashboard(address, time.monotonic() + RELEASE_S) as dashboard:
        dashboard.ask("close safety popup")
        error = _after_release(dashboard)
    if error is not None:
        raise error


def _stopped(dashboard: Dashboard) -> bool:
    return dashboard.ask("programState").startswith("STOPPED")


def _after_release(dashboard: Dashboard) -> CellError | None:
    """Return why the robot cannot be driven after its release, or None."""
    limit_s = time.monotonic() + RELEASE_S - 0.5
    while True:
        error = mode_error(robot_mode(dashboard), safety_mode(dashboard))
        if error is None or time.monotonic() > limit_s:
            return error
        time.sleep(0.05)
