"""One joint move, monitored from its start until the arm is at rest at the target."""

import time

import numpy as np
from numpy.typing import NDArray

from cell.arm.arm_state import STEADY_RAD_S
from cell.arm.connection import POLL_S, ArmConnection
from cell.config.arm_config import ArmSettings
from cell.errors import MotionError
from cell.kinematics.speed_cap import capped_speed

START_S = 1.0
"""Longest time from the acceptance of a move to its start."""
STALL_S = 5.0
"""Longest standstill of the arm during a move."""
MAX_DEVIATION_RAD = 0.05
"""Largest distance of a joint from the straight line of a joint move. Beyond it, something else moves the arm."""
ARRIVED_RAD = 2e-3
"""Largest joint error at the end of a move, which is 2 mm at a distance of 1 m. Real arms have a tenth of it."""
NEW_DATA_S = 0.05
"""Time of the controller's clock after which its data are newer than its last answer."""
STEADY_S = 0.05
"""Time without motion, by the controller's clock, after which the arm is at rest."""
SETTLE_S = 1.0
"""Longest time from the end of a move to rest."""


def execute_move(link: ArmConnection, settings: ArmSettings, q_to: NDArray[np.float64]) -> None:
    """Move the arm to the joint angles (6,) and wait until it is at rest there.

    Args:
        link: Connection to the controller.
        settings: Speeds, acceleration and model of the arm.
        q_to: Target joint angles (6,), rad.

    Raises:
        MotionError: The controller rejects the angles, or the arm does not move as sent. After rejected angles, nothing
            has moved and the connection stays usable.
        CellError: As `ArmConnection.poll_checked`.
    """
    q_from = np.array(link.require_ready().q_rad)
    speed = capped_speed(settings.model, q_from, q_to, settings.speed_rad_s, settings.flange_speed_m_s)
    target = tuple(q_to.tolist())
    if not link.call("allows", target):
        _recheck_state(link)
        raise MotionError(
            f"the robot refuses the joint angles {np.round(np.degrees(q_to), 1).tolist()} degrees: they are outside "
            "the safety limits of its installation"
        )
    link.move_sent = True
    before = link.call("start_move", target, float(speed), settings.acceleration_rad_s2, unless_stopped=True)
    _wait_for_end(link, before, q_from, q_to)
    _wait_for_rest(link, q_to)
    link.move_sent = False


def _recheck_state(link: ArmConnection) -> None:
    """Check newer data of the controller: a program that has just ended rejects all angles."""
    asked_s = link.poll_checked().controller_s
    while link.poll_checked().controller_s < asked_s + NEW_DATA_S:
        link.stopped.wait(POLL_S)


def _wait_for_end(link: ArmConnection, before: int, q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> None:
    """Wait for the end of the move on the controller."""
    started_s = moved_s = time.monotonic()
    moved_from = q_from
    while True:
        reading = link.poll_checked()
        now_s, q = time.monotonic(), np.array(reading.q_rad)
        if distance_from_line(q, q_from, q_to) > MAX_DEVIATION_RAD:
            link.fail(MotionError("the arm left the commanded path: something else moves it"))
        begun = reading.operation != before
        if begun and not reading.operating:
            return
        if not begun and now_s - started_s > START_S:
            link.fail(MotionError("the robot accepted a move but did not start it: see the pendant's log"))
        if np.abs(q - moved_from).max() > 1e-3:
            moved_from, moved_s = q, now_s
        if now_s - moved_s > STALL_S:
            link.fail(
                MotionError(
                    f"the arm has not moved for {STALL_S:g} s in the middle of a move; the pendant's speed slider is "
                    f"at {reading.speed_fraction:.0%}"
                )
            )
        link.stopped.wait(POLL_S)


def _wait_for_rest(link: ArmConnection, q_to: NDArray[np.float64]) -> None:
    """Wait until the arm is at rest, and check that it is at the target."""
    limit_s = time.monotonic() + SETTLE_S
    steady_since: float | None = None
    while True:
        reading = link.poll_checked()
        if np.abs(reading.qd_rad_s).max() > STEADY_RAD_S:
            steady_since = None
        elif steady_since is None:
            steady_since = reading.controller_s
        elif reading.controller_s - steady_since >= STEADY_S:
            break
        if time.monotonic() > limit_s:
            link.fail(MotionError(f"the arm does not come to rest within {SETTLE_S:g} s: something moves it"))
        link.stopped.wait(POLL_S)
    error = np.abs(np.array(reading.q_rad) - q_to)
    if error.max() > ARRIVED_RAD:
        link.fail(
            MotionError(
                f"the arm did not reach its target: joint {int(error.argmax()) + 1} is "
                f"{np.degrees(error.max()):.2f} degrees off"
            )
        )


def distance_from_line(q: NDArray[np.float64], q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> float:
    """Return the distance of joint angles (6,) from the straight line between two others, in the farthest joint."""
    turn = q_to - q_from
    share = np.clip((q - q_from) @ turn / max(float(turn @ turn), 1e-12), 0.0, 1.0)
    return float(np.abs(q - (q_from + share * turn)).max())
