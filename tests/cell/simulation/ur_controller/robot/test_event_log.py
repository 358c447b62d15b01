import time

from cell.simulation.ur_controller.robot.event_log import KEPT, EventLog


def test_events_have_a_number_and_a_monotonic_stamp():
    log, before_s = EventLog(), time.monotonic()
    log.add("first", robot="a")
    log.add("second", stamp_s=7.5)
    first, second = log.since(0)
    assert before_s <= first["stamp_s"] <= time.monotonic()
    assert first == {"index": 0, "stamp_s": first["stamp_s"], "kind": "first", "details": {"robot": "a"}}
    assert (second["index"], second["stamp_s"]) == (1, 7.5)
    assert log.since(1) == [second]
    assert log.since(log.count) == []


def test_the_oldest_events_are_removed_and_the_numbers_continue():
    log = EventLog()
    for _ in range(KEPT + 10):
        log.add("event")
    assert log.count == KEPT + 10
    assert len(log.since(0)) == KEPT
    assert log.since(0)[0]["index"] == 10
    assert [event["index"] for event in log.since(KEPT + 8)] == [KEPT + 8, KEPT + 9]
