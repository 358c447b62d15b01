"""The cache of images, and the thumbnail of a scan: a small preview, for long lists."""

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import httpx2
import numpy as np
import pytest

from recognition.request import RecognitionRequest
from service.api.images.image_cache import MAX_BYTES, ImageCache, shrink_image
from service.api.response_cache import MAX_AGE_S
from service.errors import Failure
from service.jobs.submission import NOBODY, new_scan
from service.problems.problem_error import ProblemError
from service.states import ScanState
from service.storage.data_folder import PREVIEW
from service.storage.database import new_id
from service.storage.store import Store
from tests.service.conftest import ServedClient

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


FAILURE = Failure("internal", "")


@pytest.fixture(scope="module")
def scan(client: ServedClient, scan: dict[str, Any]) -> dict[str, Any]:
    """Return a succeeded scan whose preview is drawn."""
    assert client.get(scan["links"]["preview"]).status_code == 200  # answers when the preview is drawn
    return scan


def test_the_thumbnail_is_the_preview_scaled_down(client: ServedClient, scan: dict[str, Any]) -> None:
    small, large = (client.get(scan["links"][name]) for name in ("thumbnail", "preview"))
    assert small.headers["content-type"] == "image/png"
    assert len(small.content) < 40_000 < len(large.content)
    shapes = []
    for answer in (small, large):
        picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        shapes.append(picture.shape[:2])
    (height, width), (full_height, full_width) = shapes
    assert width == 240
    assert height == round(240 * full_height / full_width)


def test_a_client_with_the_current_version_gets_304(client: ServedClient, scan: dict[str, Any]) -> None:
    first = client.get(scan["links"]["thumbnail"])
    again = client.get(scan["links"]["thumbnail"], headers={"If-None-Match": first.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert first.headers["ETag"] != client.get(scan["links"]["preview"]).headers["ETag"]


@pytest.mark.parametrize("damage", ["empty", "missing"])
def test_a_damaged_image_is_not_sent(
    client: ServedClient, scan: dict[str, Any], assert_problem: AssertProblem, damage: str
) -> None:
    path = client.app.state.context.store.folder.results(scan["id"]) / PREVIEW
    whole = path.read_bytes()
    try:
        path.unlink() if damage == "missing" else path.write_bytes(b"")
        time.sleep(MAX_AGE_S)  # until the cached value expires
        assert_problem(client.get(scan["links"]["thumbnail"]), 500, "damaged")
    finally:
        path.write_bytes(whole)
        time.sleep(MAX_AGE_S)
    assert client.get(scan["links"]["thumbnail"]).status_code == 200


@pytest.mark.parametrize("content", [b"", bytes(100), b"\x89PNG, or so"])
def test_an_image_that_cannot_be_decoded_is_damaged(content: bytes) -> None:
    with pytest.raises(ProblemError, match="the picture is damaged, the model is not"):
        shrink_image(content, 240)


@pytest.mark.parametrize(
    ("state", "status", "slug"),
    [("scanning", 409, "result-not-ready"), ("failed", 404, "no-result"), (None, 404, "scan-not-found")],
)
def test_without_an_image_the_thumbnail_fails_like_the_preview(
    client: ServedClient, assert_problem: AssertProblem, state: ScanState | None, status: int, slug: str
) -> None:
    store: Store = client.app.state.context.store
    row = replace(new_scan("live", RecognitionRequest(), NOBODY), id=new_id(), state="scanning")
    if state is not None:
        store.scans.add(row)
    if state == "failed":
        store.scans.end(row.id, state, FAILURE)
    details = [
        assert_problem(client.get(f"/api/scans/{row.id}/{name}.png"), status, slug) for name in ("thumbnail", "preview")
    ]
    assert details[0] == details[1]
    if state == "scanning":
        store.scans.end(row.id, "failed", FAILURE)


def test_the_bytes_of_the_kept_images_are_limited() -> None:
    drawn: list[int] = []
    cache = ImageCache()

    async def request(number: int, size_bytes: int) -> None:
        def draw() -> bytes:
            drawn.append(number)
            return bytes(size_bytes)

        assert len((await cache.respond(number, None, draw)).body) == size_bytes
        assert cache.kept_bytes <= MAX_BYTES

    async def request_all() -> None:
        for number in range(4):
            await request(number, MAX_BYTES // 4)
        await request(0, MAX_BYTES // 4)
        assert drawn == [0, 1, 2, 3]
        await request(4, MAX_BYTES // 4)  # replaces 1, which was not requested for longest
        for number in (0, 1):
            await request(number, MAX_BYTES // 4)
        assert drawn == [0, 1, 2, 3, 4, 1]
        for _ in range(2):
            await request(5, MAX_BYTES + 1)
        await request(1, MAX_BYTES // 4)
        assert drawn == [0, 1, 2, 3, 4, 1, 5, 5]

    asyncio.run(request_all())


def test_small_images_of_a_long_list_are_all_kept() -> None:
    drawn: list[int] = []
    cache = ImageCache()

    async def request_list() -> None:
        for number in range(100):
            await cache.respond(number, None, lambda number=number: drawn.append(number) or bytes(20_000))

    async def request_twice() -> None:
        await request_list()
        await request_list()

    asyncio.run(request_twice())
    assert len(drawn) == 100
