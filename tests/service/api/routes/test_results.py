"""Routes of results: ETags and hashes. A damaged file is never sent as a model."""

import hashlib
import time
from collections.abc import Callable
from typing import Any

import httpx2
import pytest

from recognition.request import RecognitionRequest
from service.api.file_responses import matches
from service.api.response_cache import MAX_AGE_S
from service.storage.data_folder import CLOUD, MODEL
from service.storage.store import Store
from tests.service.conftest import ServedClient

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.mark.parametrize("name", ["model", "grasps", "cloud", "height_map", "preview", "thumbnail", "recording"])
def test_a_client_with_the_current_version_gets_304(client: ServedClient, scan: dict[str, Any], name: str) -> None:
    address = scan["links"][name]
    first = client.get(address)
    etag = first.headers["ETag"]
    assert etag[0] == etag[-1] == '"'  # a strong tag
    for header in (etag, f"W/{etag}", f'"other", {etag}', "*"):
        again = client.get(address, headers={"If-None-Match": header})
        assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", etag), header
    several = client.get(address, headers=[("If-None-Match", '"a"'), ("If-None-Match", etag)])
    assert several.status_code == 304
    for header in ('"other"', etag.strip('"'), "nonsense", ""):
        again = client.get(address, headers={"If-None-Match": header})
        assert (again.status_code, again.content) == (200, first.content), header


def test_the_etag_of_a_file_is_its_hash(client: ServedClient, scan: dict[str, Any]) -> None:
    tags = set()
    for name in ("model", "cloud", "recording"):
        answer = client.get(scan["links"][name])
        assert answer.headers["ETag"] == f'"{hashlib.sha256(answer.content).hexdigest()}"'
        tags.add(answer.headers["ETag"])
    tags |= {client.get(scan["links"][name]).headers["ETag"] for name in ("grasps", "preview")}
    assert len(tags) == 5


def test_the_row_has_the_inputs_and_the_result_files(client: ServedClient, scan: dict[str, Any]) -> None:
    store: Store = client.app.state.context.store
    row = store.scans.get(scan["id"])
    assert row is not None
    assert row.files is not None
    for name in (MODEL, CLOUD):
        content = (store.folder.results(row.id) / name).read_bytes()
        assert row.files[name] == {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}
    recording = client.get(f"/api/recordings/{scan['recording']}").json()
    assert row.inputs is not None
    assert row.inputs["recording_sha256"] == recording["sha256"]
    assert row.request == RecognitionRequest(radius_m=0.0042)
    assert row.request.gripper.stroke_m == 0.085
    assert row.inputs["software"]


@pytest.mark.parametrize(("name", "link"), [(MODEL, "model"), (MODEL, "grasps"), (CLOUD, "cloud")])
def test_a_damaged_file_is_reported(
    client: ServedClient, scan: dict[str, Any], assert_problem: AssertProblem, name: str, link: str
) -> None:
    path = client.app.state.context.store.folder.results(scan["id"]) / name
    whole = path.read_bytes()
    try:
        for harm in (lambda: path.write_bytes(whole[:-1]), path.unlink):
            harm()
            time.sleep(MAX_AGE_S)  # until the cached answer expires
            detail = assert_problem(client.get(scan["links"][link]), 500, "damaged")
            assert "pointchain doctor" in detail
            assert_problem(client.get(scan["links"][link], headers={"If-None-Match": "*"}), 500, "damaged")
    finally:
        path.write_bytes(whole)
    assert client.get(scan["links"][link]).status_code == 200  # errors are not cached


def test_files_are_sent_whole_only(client: ServedClient, scan: dict[str, Any]) -> None:
    assert client.get(scan["links"]["model"], headers={"Range": "bytes=0-9"}).status_code == 200


def test_etags_are_compared_exactly() -> None:
    assert matches('"a,b", "c"', '"a,b"')
    assert matches(" * ", '"x"')
    assert not matches('"a,b"', '"a"')
    assert not matches('"*"', '"x"')
    assert not matches(None, '"x"')
