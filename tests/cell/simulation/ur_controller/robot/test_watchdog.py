import pytest

from cell.simulation.ur_controller.robot.watchdog import Watchdog


def test_the_watchdog_expires_without_a_kick_and_never_while_off():
    watchdog = Watchdog()
    assert not watchdog.expired(1e9)
    watchdog.arm(5.0, 100.0)
    watchdog.kick(100.1)
    assert not watchdog.expired(100.29)
    assert watchdog.expired(100.31)


def test_the_time_of_a_suspended_controller_does_not_count():
    watchdog = Watchdog()
    watchdog.arm(5.0, 100.0)
    watchdog.excuse(100.1, 100.5)
    assert watchdog.silence_s(100.5) == pytest.approx(0.1)
    assert not watchdog.expired(100.59)
    assert watchdog.expired(100.61)


def test_a_kick_during_a_suspension_counts_from_its_end():
    """Such a kick extends the time no more than a kick in time."""
    watchdog = Watchdog()
    watchdog.arm(5.0, 100.0)
    watchdog.kick(100.5)
    watchdog.excuse(100.1, 100.5)
    assert not watchdog.expired(100.69)
    assert watchdog.expired(100.71)
