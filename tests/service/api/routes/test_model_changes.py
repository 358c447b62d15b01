"""`GET /api/scans/SCAN/model?since=OTHER`: which chain is which, and refusals."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest

from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.model.model import PointChainModel
from service.api.response_cache import MAX_AGE_S
from service.storage.data_folder import MODEL
from tests.service.api.routes.test_scans import start, upload
from tests.service.conftest import ServedClient

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.fixture(scope="module")
def later(client: ServedClient, tmp_path_factory: pytest.TempPathFactory, finished: Finished) -> dict[str, Any]:
    """A scan of two strings."""
    path: Path = tmp_path_factory.mktemp("several") / "several.mcap"
    write_simulation(simulate(make_scene("several", 4), camera_model("exact", (320, 200)), 4, views=4), path)
    return finished(client, start(client, upload(client, path)))


def since(client: httpx2.Client, scan: dict[str, Any], other: str, **headers: str) -> httpx2.Response:
    return client.get(scan["links"]["model"], params={"since": other}, headers=headers)


def test_a_scan_has_not_changed_since_itself(client: ServedClient, later: dict[str, Any]) -> None:
    model = client.get(later["links"]["model"]).json()
    assert "since" not in model
    changed = since(client, later, later["id"]).json()
    changes = changed.pop("since")
    assert changed == model
    assert (changes["scan"], changes["new"], changes["gone"]) == (later["id"], [], [])
    assert [(match["before"], match["chain"], match["change"]) for match in changes["matches"]] == [
        (0, 0, "unmoved"),
        (1, 1, "unmoved"),
    ]
    assert all(match["displacement_m"] == 0 for match in changes["matches"])


def test_the_changes_are_those_of_the_two_models(
    client: ServedClient, scan: dict[str, Any], later: dict[str, Any]
) -> None:
    now, before = (PointChainModel.from_json(client.get(row["links"]["model"]).json()) for row in (later, scan))
    expected = now.since(before)
    changes = since(client, later, scan["id"]).json()["since"]
    assert (tuple(changes["new"]), tuple(changes["gone"])) == (expected.new, expected.gone)
    assert [match["chain"] for match in changes["matches"]] == [match.chain for match in expected.matches]
    # One string before, two other ones now.
    assert len(changes["new"]) - len(changes["gone"]) == 1


def test_the_etag_depends_on_both_scans(client: ServedClient, scan: dict[str, Any], later: dict[str, Any]) -> None:
    tags = {since(client, later, other).headers["ETag"] for other in (scan["id"], later["id"])}
    tags.add(client.get(later["links"]["model"]).headers["ETag"])
    assert len(tags) == 3
    etag = since(client, later, scan["id"]).headers["ETag"]
    again = since(client, later, scan["id"], **{"If-None-Match": etag})
    assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", etag)


@pytest.mark.problem("scan-not-found")
def test_another_scan_without_a_model_is_refused(
    client: ServedClient, later: dict[str, Any], assert_problem: AssertProblem
) -> None:
    unknown = "20200101t000000-000000-00000000"
    assert unknown in assert_problem(since(client, later, unknown), 404, "scan-not-found")
    assert_problem(since(client, later, "no id!"), 422, "invalid-request")


def test_a_model_that_cannot_be_read_is_reported(
    client: ServedClient, scan: dict[str, Any], later: dict[str, Any], assert_problem: AssertProblem
) -> None:
    path = client.app.state.context.store.folder.results(scan["id"]) / MODEL
    whole = path.read_bytes()
    try:
        path.write_bytes(b"{" * len(whole))
        time.sleep(MAX_AGE_S)  # until the cached answer expires
        detail = assert_problem(since(client, later, scan["id"]), 500, "damaged")
        assert "pointchain doctor" in detail
    finally:
        path.write_bytes(whole)
