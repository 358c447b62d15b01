"""The one place: who gets it, who is told what, and that nothing is lost when it closes."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from calibration.target.board import Board
from cell.errors import CameraUnreachableError
from service.errors import JobKind, JobReference, ServiceError
from service.jobs.cell_lock import Place
from service.jobs.job import Running
from service.jobs.new_rows import NOBODY, new_calibration, new_scan


def scan() -> Running:
    return Running(new_scan("replay", "graph", None, NOBODY, recording="r1"), None)


def calibration() -> Running:
    return Running(new_calibration("calibration", Board(), 15), None)


def refusal(place: Place) -> ServiceError:
    with pytest.raises(ServiceError) as refused, place.taken():
        pass
    return refused.value


@pytest.mark.parametrize(("running", "kind"), [(scan(), "scan"), (calibration(), "calibration")])
def test_whoever_comes_second_is_told_of_the_first(
    running: Running, kind: JobKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.jobs.cell_lock.SOON_S", 0.01)
    place, done = Place(), []
    with place.taken():
        told = refusal(place)
        assert (told.slug, told.retry_after_s, told.job) == ("cell-busy", 2.0, None)
        place.accept(running, lambda: done.append("written"), lambda: done.append("begun"))
    assert done == ["written", "begun"]
    assert place.running is running
    told = refusal(place)
    assert (told.retry_after_s, told.job) == (None, JobReference(kind, running.row.id))
    assert running.words in str(told)
    assert running.ask_to_stop("aborted", "it was stopped")
    told = refusal(place)
    assert (told.retry_after_s, told.job) == (1.0, running.reference)
    assert f"{running.words} was stopped and is just ending" in str(told)
    with place.leaving(running):
        assert place.running is running
    assert place.running is None
    with place.taken():
        pass


def test_whoever_comes_while_it_is_decided_on_waits_to_be_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.jobs.cell_lock.SOON_S", 60.0)
    place, running = Place(), scan()
    with ThreadPoolExecutor(1) as pool:
        with place.taken():
            second = pool.submit(refusal, place)
            place.accept(running, lambda: None, lambda: None)
        assert second.result().job == running.reference


def test_what_cannot_be_written_leaves_the_place_free() -> None:
    place, begun = Place(), []

    def full() -> None:
        raise OSError("no space")

    with pytest.raises(OSError, match="no space"), place.taken():
        place.accept(scan(), full, lambda: begun.append(1))
    assert (place.running, begun) == (None, [])
    with place.taken():
        pass


def test_a_closed_place_takes_nothing_more() -> None:
    place = Place()

    def prepare() -> None:
        with place.taken():
            assert place.close() is None
            place.accept(scan(), lambda: None, lambda: None)

    with pytest.raises(ServiceError) as refused:
        prepare()
    assert refused.value.slug == "not-ready"
    assert (place.running, place.closed, refusal(place).slug) == (None, True, "not-ready")


def test_arm_and_camera_that_are_given_up_at_the_end_are_no_fault_of_theirs() -> None:
    place = Place()

    def prepare() -> None:
        place.close()
        raise CameraUnreachableError("connecting the camera was given up")

    with pytest.raises(ServiceError) as told, place.taken():
        prepare()
    assert told.value.slug == "not-ready"
    open_place = Place()
    with pytest.raises(CameraUnreachableError), open_place.taken():
        raise CameraUnreachableError("there is none")
    with open_place.taken():
        pass


def test_one_under_way_is_told_to_who_closes_and_leaves_only_its_own_place() -> None:
    place, first, second = Place(), scan(), calibration()
    with place.taken():
        place.accept(first, lambda: None, lambda: None)
    with place.leaving(second):
        pass
    assert place.close() is first
