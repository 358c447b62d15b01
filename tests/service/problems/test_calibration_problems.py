"""Problems of calibrations: activations that are refused, and runs that fail."""

import json
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx2
import pytest

from calibration.dataset.folder import HAND_EYE_FILE
from calibration.errors import (
    BoardImageError,
    BoardMirroredError,
    BoardNotSeenError,
    CalibrationFolderError,
    HandEyeInputError,
)
from calibration.storage.hand_eye_file import write_hand_eye
from calibration.target.board import Board
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from service.jobs.submission import new_calibration
from service.states import ScanState
from service.storage.data_folder import DataFolder
from service.storage.database import new_id
from service.storage.rows import CalibrationRow
from service.storage.store import Store
from tests.service.api.routes.test_calibration import REFUSED
from tests.service.conftest import Serve, ServedClient
from tests.service.live_cell import LiveCell, live_cell
from tests.service.security.conftest import without_recognition

pytestmark = pytest.mark.xdist_group("service")  # one at a time: a module has a simulated cell

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]

RUNS = "/api/calibration/runs"
ACCEPTED = REFUSED | {"verdict": "accept", "findings": []}


def ended_run(state: ScanState = "succeeded", **values: Any) -> CalibrationRow:
    return replace(new_calibration("calibration", Board(), 12), id=new_id(), state=state, **values)


@pytest.fixture(scope="module")
def runs() -> dict[str, CalibrationRow]:
    """Return the runs of an earlier service, by what is wrong with their results."""
    names = ("missing", "unreadable", "invalid", "future", "good")
    return {name: ended_run(result=ACCEPTED) for name in names} | {
        "refused": ended_run(result=REFUSED),
        "failed": ended_run("failed"),
    }


@pytest.fixture(scope="module")
def stored(
    serve: Serve, runs: dict[str, CalibrationRow], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ServedClient]:
    """Yield a client of a service with these runs."""
    root = tmp_path_factory.mktemp("data")
    with closing(DataFolder(root)) as folder, closing(Store(folder)) as store:
        for row in runs.values():
            store.calibrations.add(row)
    files = {name: root / "calibration" / "runs" / row.id / HAND_EYE_FILE for name, row in runs.items()}
    for file in files.values():
        file.parent.mkdir(parents=True)
    files["unreadable"].mkdir()
    files["invalid"].write_text(json.dumps({"schema_version": 2}))
    write_hand_eye(files["future"], T_FLANGE_CAMERA, created=datetime.now(UTC) + timedelta(days=9))
    write_hand_eye(files["good"], T_FLANGE_CAMERA, created=datetime.now(UTC))
    with without_recognition(serve, root) as client:
        yield client


NOT_ACTIVATED = {
    "missing": "calibration-missing",
    "unreadable": "calibration-unreadable",
    "invalid": "calibration-invalid",
    "future": "calibration-in-future",
    "refused": "calibration-refused",
    "failed": "not-activatable",
}
"""Problem of the activation of each run."""


@pytest.mark.parametrize(
    ("name", "slug"),
    [pytest.param(name, slug, marks=pytest.mark.problem(slug)) for name, slug in NOT_ACTIVATED.items()],
)
def test_a_result_that_cannot_be_used_is_not_activated(
    stored: ServedClient, runs: dict[str, CalibrationRow], assert_problem: AssertProblem, name: str, slug: str
) -> None:
    assert_problem(stored.post(f"{RUNS}/{runs[name].id}/activate"), 409, slug)


@pytest.mark.problem("calibration")
def test_an_active_file_that_cannot_be_replaced_is_named(
    stored: ServedClient, runs: dict[str, CalibrationRow], assert_problem: AssertProblem
) -> None:
    active = stored.app.state.context.cell.settings.hand_eye.active_file
    active.mkdir()
    assert_problem(stored.post(f"{RUNS}/{runs['good'].id}/activate"), 409, "calibration")
    active.rmdir()


@pytest.mark.problem("calibration-not-found")
def test_a_run_that_does_not_exist_is_not_found(stored: ServedClient, assert_problem: AssertProblem) -> None:
    assert_problem(stored.get(f"{RUNS}/none"), 404, "calibration-not-found")


@pytest.mark.problem("calibration-board")
def test_a_board_in_millimetres_is_refused(stored: ServedClient, assert_problem: AssertProblem) -> None:
    assert_problem(stored.post(RUNS, json={"board": {"pitch_m": 25.0}}), 422, "calibration-board")


INPUT_SLUGS = (
    "camera-did-not-move", "corners", "degrees", "duplicate-views", "intrinsics", "millimetres", "mounting",
    "not-finite", "outside-image", "parallel-axes", "pure-translation", "repeated-names", "too-few-corners",
    "too-few-views",
)  # fmt: skip
"""Refusals of the solver. The views that the cell takes are without these faults, so the tests inject them."""
INJECTED: Mapping[str, Exception] = {slug: HandEyeInputError(slug, "the reason") for slug in INPUT_SLUGS} | {
    kind.slug: kind("the reason")
    for kind in (BoardImageError, BoardNotSeenError, BoardMirroredError, CalibrationFolderError)
}


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """Yield a cell that plans the poses of a calibration only once, because that takes longer than a test."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=50.0) as shared:
        service = shared.client.app.state.context
        prepared = service.cell.prepare_calibration(Board(), time.monotonic(), 10)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(service.cell, "prepare_calibration", lambda *_: prepared)
            yield shared


@pytest.mark.parametrize("slug", [pytest.param(slug, marks=pytest.mark.problem(slug)) for slug in INJECTED])
def test_a_failure_of_the_solver_is_the_problem_of_the_run(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch, slug: str
) -> None:
    def fail(*_: object) -> None:
        raise INJECTED[slug]

    monkeypatch.setattr("service.jobs.calibration_job.run_calibration", fail)
    answer = cell.client.post(RUNS, json={"poses": 10})
    assert answer.status_code == 202, answer.text
    run = finished(cell.client, answer.headers["Location"])
    assert (run["state"], run["problem"]["detail"]) == ("failed", "the reason")


@pytest.mark.problem("file")
def test_an_image_that_cannot_be_written_is_the_problem_of_the_run(
    cell: LiveCell, finished: Finished, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise PermissionError(13, "Permission denied", "00_pose00.png")

    monkeypatch.setattr("service.jobs.calibration_job.run_calibration", fail)
    answer = cell.client.post(RUNS, json={"poses": 10})
    run = finished(cell.client, answer.headers["Location"])
    assert (run["state"], run["problem"]["detail"][:13]) == ("failed", "00_pose00.png")
