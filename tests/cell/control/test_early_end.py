"""The decision to end a scan early, between two threads."""

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from cell.control import early_end
from cell.control.early_end import EarlyEnd


def test_the_decision_may_come_before_or_while_the_arm_waits() -> None:
    before, meanwhile = EarlyEnd(4), EarlyEnd(4)
    before.decide(4, enough=True)
    assert before.wait(4)
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(meanwhile.wait, 4)
        time.sleep(0.05)
        assert not waiting.done()
        meanwhile.decide(4, enough=True)
        assert waiting.result(timeout=2.0)


def test_after_a_doubt_the_arm_waits_again_only_where_the_views_before_sufficed() -> None:
    end = EarlyEnd(4)
    end.decide(4, enough=False)
    assert not end.wait(4)
    assert not end.wait(5)  # at once
    end.decide(5, enough=True)
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(end.wait, 6)
        time.sleep(0.05)
        assert not waiting.done()
        end.decide(6, enough=True)
        assert waiting.result(timeout=2.0)


def test_a_decision_on_fewer_views_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(early_end, "DECISION_TIMEOUT_S", 0.05)
    end = EarlyEnd(4)
    end.decide(4, enough=True)
    assert not end.wait(5)


def test_the_arm_does_not_wait_where_the_scan_cannot_end() -> None:
    for end in (EarlyEnd(None), EarlyEnd(6)):
        end.decide(5, enough=True)
        assert not end.wait(5)


def test_closing_ends_the_wait_and_the_scan_goes_on() -> None:
    end = EarlyEnd(4)
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(end.wait, 4)
        end.close()
        assert not waiting.result(timeout=2.0)
    end.decide(5, enough=True)
    assert not end.wait(5)
