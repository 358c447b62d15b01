import pytest

from cell.simulation.ur_controller.robot.watchdog import Watchdog


def test_it_expires_without_a_kick_in_time_and_never_while_off():
    watchdog = Watchdog()
    assert not watchdog.expired(1e9)
    watchdog.arm(5.0, 100.0)
    watchdog.kick(100.1)
    assert not watchdog.expired(100.29)
    assert watchdog.expired(100.31)


def test_time_in_which_the_controller_did_not_run_does_not_count():
    watchdog = Watchdog()
    watchdog.arm(5.0, 100.0)
    watchdog.excuse(100.1, 100.5)
    assert watchdog.silence_s(100.5) == pytest.approx(0.1)
    assert not watchdog.expired(100.59)
    assert watchdog.expired(100.61)


def test_what_came_in_that_time_was_fed_at_its_end():
    """No meal is worth more than one that comes in time."""
    watchdog = Watchdog()
    watchdog.arm(5.0, 100.0)
    watchdog.kick(100.5)
    watchdog.excuse(100.1, 100.5)
    assert not watchdog.expired(100.69)
    assert watchdog.expired(100.71)
