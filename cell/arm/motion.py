"""One joint move, watched from its start until the arm is at rest at its target."""

import time

import numpy as np
from numpy.typing import NDArray

from cell.arm.arm_reading import STEADY_RAD_S
from cell.arm.connection import POLL_S, ArmLink
from cell.arm.speed_cap import capped_speed
from cell.config.arm_config import ArmSettings
from cell.errors import MotionError

START_S = 1.0
"""A move that was taken begins in this time."""
STALL_S = 5.0
"""An arm that should move and stands still for so long never will."""
LINE_RAD = 0.05
"""A joint move is a straight line of joint angles. An arm further off it is not on our move."""
ARRIVED_RAD = 2e-3
"""Greatest joint error at the end of a move; 2 mm at a metre. Real arms end within a tenth of it."""
NEWS_S = 0.05
"""By the controller's clock: what it said so much later, it said knowing of the answer that came before."""
STEADY_S = 0.05
"""At rest is an arm that is steady for so long by the controller's clock."""
SETTLE_S = 1.0
"""After a move the arm comes to rest in this time."""


def watched_move(link: ArmLink, settings: ArmSettings, q_to: NDArray[np.float64]) -> None:
    """Moves the arm to the joint angles (6,); returns when it is at rest there.

    Raises: MotionError, and what `ArmLink.good_poll` does. Only after angles that the controller refuses, with which
    nothing moves, does the link still stand.
    """
    q_from = np.array(link.ready().q_rad)
    speed = capped_speed(settings.model, q_from, q_to, settings.speed_rad_s, settings.flange_speed_m_s)
    target = tuple(q_to.tolist())
    if not link.call("allows", target):
        _still_well(link)
        raise MotionError(
            f"the robot refuses the joint angles {np.round(np.degrees(q_to), 1).tolist()} degrees: they are outside "
            "the safety limits of its installation"
        )
    link.move_sent = True
    before = link.call("start_move", target, float(speed), settings.acceleration_rad_s2, unless_stopped=True)
    _until_ended(link, before, q_from, q_to)
    _until_at_rest(link, q_to)
    link.move_sent = False


def _still_well(link: ArmLink) -> None:
    """Returns if the controller is well by what it has said since: a program that has just ended allows nothing."""
    asked_s = link.good_poll().controller_s
    while link.good_poll().controller_s < asked_s + NEWS_S:
        link.stopped.wait(POLL_S)


def _until_ended(link: ArmLink, before: int, q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> None:
    """Until the move has ended on the controller."""
    started_s = moved_s = time.monotonic()
    moved_from = q_from
    while True:
        reading = link.good_poll()
        now_s, q = time.monotonic(), np.array(reading.q_rad)
        if off_line(q, q_from, q_to) > LINE_RAD:
            link.fail(MotionError("the arm is not on the way that it was sent: something else moves it"))
        begun = reading.operation != before
        if begun and not reading.operating:
            return
        if not begun and now_s - started_s > START_S:
            link.fail(MotionError("the robot took a move and did not begin it: see the pendant's log"))
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


def _until_at_rest(link: ArmLink, q_to: NDArray[np.float64]) -> None:
    """Until the arm is steady, and at its target."""
    limit_s = time.monotonic() + SETTLE_S
    steady_since: float | None = None
    while True:
        reading = link.good_poll()
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
                f"the arm did not get to where it was sent: joint {int(error.argmax()) + 1} is "
                f"{np.degrees(error.max()):.2f} degrees off"
            )
        )


def off_line(q: NDArray[np.float64], q_from: NDArray[np.float64], q_to: NDArray[np.float64]) -> float:
    """How far, in its furthest joint, joint angles (6,) are from the straight line between two others."""
    turn = q_to - q_from
    share = np.clip((q - q_from) @ turn / max(float(turn @ turn), 1e-12), 0.0, 1.0)
    return float(np.abs(q - (q_from + share * turn)).max())
