"""A stop cancels what was requested before it, and only that."""

import time

import pytest

from cell.control.status import SharedStatus
from cell.control.stop_requests import StopRequests
from cell.errors import StoppedError


def test_without_a_stop_every_request_is_valid() -> None:
    stops = StopRequests(SharedStatus())
    stops.raise_if_stopped_since(0.0)
    assert not stops.is_stopped_since(0.0)


def test_only_requests_before_the_stop_are_rejected() -> None:
    stops = StopRequests(SharedStatus())
    before = time.monotonic()
    stops.record()
    after = time.monotonic() + 1e-6
    with pytest.raises(StoppedError, match="check where the arm stands, then request again"):
        stops.raise_if_stopped_since(before)
    stops.raise_if_stopped_since(after)


def test_a_stop_at_the_time_of_the_request_rejects_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "monotonic", lambda: 5.0)
    stops = StopRequests(SharedStatus())
    stops.record()
    with pytest.raises(StoppedError):
        stops.raise_if_stopped_since(5.0)


def test_a_cell_connected_before_the_stop_is_not_ready() -> None:
    status = SharedStatus()
    stops, requested_at = StopRequests(status), time.monotonic()
    status.set_connected(time.monotonic())
    stops.record()
    with pytest.raises(StoppedError):
        stops.raise_if_stopped_since(requested_at)
    assert (status.now.state, status.now.slug) == ("not_ready", "stopped")


def test_a_cell_connected_after_the_stop_stays_ready() -> None:
    status = SharedStatus()
    stops, requested_at = StopRequests(status), time.monotonic()
    stops.record()
    status.set_connected(time.monotonic() + 1e-6)
    with pytest.raises(StoppedError):
        stops.raise_if_stopped_since(requested_at)
    assert status.now.state == "ready"


def test_no_cell_is_ready_after_the_arm_was_stopped() -> None:
    status = SharedStatus()
    stops = StopRequests(status)
    stops.record()
    status.set_connected(time.monotonic() + 1.0)
    stops.mark_not_ready()
    assert status.now.state == "not_ready"
