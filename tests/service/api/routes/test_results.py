"""Results over HTTP: their ETags, their hashes, and that a damaged one is not taken for a model."""

import hashlib
import time
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from service.api.etags import matches
from service.api.response_cache import FRESH_S
from service.storage.data_folder import CLOUD, MODEL
from service.storage.store import Store
from tests.service.conftest import ServedClient

AssertProblem = Callable[[httpx.Response, int, str], str]
Finished = Callable[[httpx.Client, str], dict[str, Any]]


@pytest.mark.parametrize("name", ["model", "grasps", "cloud", "preview", "thumbnail", "recording"])
def test_who_has_it_already_is_told_so(client: ServedClient, scan: dict[str, Any], name: str) -> None:
    address = scan["links"][name]
    first = client.get(address)
    etag = first.headers["ETag"]
    assert etag[0] == etag[-1] == '"'  # a strong one
    for has in (etag, f"W/{etag}", f'"other", {etag}', "*"):
        again = client.get(address, headers={"If-None-Match": has})
        assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", etag), has
    several = client.get(address, headers=[("If-None-Match", '"a"'), ("If-None-Match", etag)])
    assert several.status_code == 304
    for has in ('"other"', etag.strip('"'), "nonsense", ""):
        again = client.get(address, headers={"If-None-Match": has})
        assert (again.status_code, again.content) == (200, first.content), has


def test_the_tag_of_a_file_is_its_hash(client: ServedClient, scan: dict[str, Any]) -> None:
    tags = set()
    for name in ("model", "cloud", "recording"):
        answer = client.get(scan["links"][name])
        assert answer.headers["ETag"] == f'"{hashlib.sha256(answer.content).hexdigest()}"'
        tags.add(answer.headers["ETag"])
    tags |= {client.get(scan["links"][name]).headers["ETag"] for name in ("grasps", "preview")}
    assert len(tags) == 5


def test_the_row_tells_what_it_was_made_from_and_what_it_gave(client: ServedClient, scan: dict[str, Any]) -> None:
    store: Store = client.app.state.context.store
    row = store.scan(scan["id"])
    assert row is not None
    assert row.files is not None
    for name in (MODEL, CLOUD):
        content = (store.folder.results(row.id) / name).read_bytes()
        assert row.files[name] == {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}
    recording = client.get(f"/api/recordings/{scan['recording']}").json()
    assert row.inputs is not None
    assert row.inputs["recording_sha256"] == recording["sha256"]
    assert (row.inputs["method"], row.inputs["string_radius_m"]) == ("graph", 0.0042)
    assert row.inputs["gripper"]["stroke_m"] == 0.085
    assert row.inputs["software"]


@pytest.mark.parametrize(("name", "link"), [(MODEL, "model"), (MODEL, "grasps"), (CLOUD, "cloud")])
def test_a_damaged_file_is_no_result(
    client: ServedClient, scan: dict[str, Any], assert_problem: AssertProblem, name: str, link: str
) -> None:
    path = client.app.state.context.store.folder.results(scan["id"]) / name
    whole = path.read_bytes()
    try:
        for harm in (lambda: path.write_bytes(whole[:-1]), path.unlink):
            harm()
            time.sleep(FRESH_S)  # so long an answer from before is given again: that of the whole file
            detail = assert_problem(client.get(scan["links"][link]), 500, "damaged")
            assert "pointchain doctor" in detail
            assert_problem(client.get(scan["links"][link], headers={"If-None-Match": "*"}), 500, "damaged")
    finally:
        path.write_bytes(whole)
    assert client.get(scan["links"][link]).status_code == 200  # what went wrong is given to nobody else


def test_of_a_file_nothing_but_the_whole_is_given(client: ServedClient, scan: dict[str, Any]) -> None:
    assert client.head(scan["links"]["model"]).status_code == 405
    assert client.get(scan["links"]["model"], headers={"Range": "bytes=0-9"}).status_code == 200


def test_tags_are_told_apart() -> None:
    assert matches('"a,b", "c"', '"a,b"')
    assert matches(" * ", '"x"')
    assert not matches('"a,b"', '"a"')
    assert not matches('"*"', '"x"')
    assert not matches(None, '"x"')
