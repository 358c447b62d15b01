"""Routes of recordings: accepted and refused uploads. A refused upload leaves no file."""

import hashlib
import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from types import SimpleNamespace

import httpx2
import numpy as np
import pytest
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from cell.recording import RecordingHeader, RecordingWriter, read_recording
from service.api.dependencies import Context
from service.api.routes.recordings import MAX_UPLOADS
from tests.cell.recording.test_foreign_recording import Foreign
from tests.service.conftest import PATIENCE_S, ServedClient, wait_until
from tests.service.intensity_images import with_intensity
from tests.service.security.conftest import without_recognition

Serve = Callable[..., AbstractContextManager[ServedClient]]
AssertProblem = Callable[[httpx2.Response, int, str], str]


def test_an_uploaded_recording_is_returned_unchanged(client: httpx2.Client, recording_file: Path) -> None:
    content = recording_file.read_bytes()
    answer = client.post("/api/recordings", content=content)
    assert answer.status_code == 201
    found = client.get(answer.headers["location"]).json()
    assert found == answer.json()
    assert found["sha256"] == hashlib.sha256(content).hexdigest()
    assert found["size_bytes"] == len(content)
    assert (found["views"], found["missing"], found["string_radius_m"]) == (4, [], 0.0042)
    assert found["provenance"]["robot"] == "simulated"
    download = client.get(found["links"]["file"])
    assert download.content == content
    assert found["id"] in download.headers["content-disposition"]
    assert client.get("/api/recordings").json()["recordings"][0] == found


def test_an_uploaded_recording_keeps_its_intensity_images(
    client: httpx2.Client, recording_file: Path, tmp_path: Path
) -> None:
    recording = read_recording(recording_file)
    with RecordingWriter(tmp_path / "upload.mcap", recording.header) as writer:
        for view in recording.views:
            writer.write_view(with_intensity(view))
    found = client.post("/api/recordings", content=(tmp_path / "upload.mcap").read_bytes()).json()
    (tmp_path / "download.mcap").write_bytes(client.get(found["links"]["file"]).content)
    views = read_recording(tmp_path / "download.mcap").views
    for view, uploaded in zip(views, recording.views, strict=True):
        np.testing.assert_array_equal(view.intensity, with_intensity(uploaded).intensity)


def test_an_upload_whose_intensity_image_does_not_fit_is_refused(
    client: httpx2.Client, assert_problem: AssertProblem
) -> None:
    foreign = Foreign()
    image = RawImage(width=32, height=40, encoding="mono8", step=32, data=bytes(32 * 40))
    foreign.messages.append((1, "/camera/intensity", image))
    answer = client.post("/api/recordings", content=foreign.bytes())
    message = assert_problem(answer, 422, "recording-content")
    assert "view 1: the intensity image is uint8 (40, 32); uint8 of 64x40 pixels is needed" in message


@pytest.mark.parametrize(
    ("given", "stored"),
    [
        ("knot.mcap", "knot.mcap"),
        ("C:\\cell 2\\Seil % \u00e4.mcap", "Seil % \u00e4.mcap"),
        ("../../etc/passwd", "passwd"),
        ("a\r\nSet-Cookie: b\x00.mcap", "aSet-Cookie: b.mcap"),
        ("/", None),
        ("", None),
    ],
)
def test_a_name_is_stored_without_folders_and_control_characters(
    client: httpx2.Client, recording_file: Path, given: str, stored: str | None
) -> None:
    answer = client.post("/api/recordings", params={"name": given}, content=recording_file.read_bytes())
    assert (answer.status_code, answer.json()["name"]) == (201, stored)
    assert client.get(answer.headers["location"]).json()["name"] == stored


def test_a_refusal_has_the_name_that_the_sender_gave(client: httpx2.Client, assert_problem: AssertProblem) -> None:
    def refused(**params: str) -> str:
        return assert_problem(client.post("/api/recordings", params=params, content=b"no"), 422, "not-mcap")

    assert refused(name="my {0} %s.mcap").startswith("my {0} %s.mcap is not an MCAP file")
    assert refused().startswith("the recording is not an MCAP file")
    assert_problem(client.post("/api/recordings", params={"name": "x" * 256}, content=b"no"), 422, "invalid-request")


def test_a_download_ignores_ranges(client: httpx2.Client, recording: str) -> None:
    address = f"/api/recordings/{recording}/file"
    whole = client.get(address).content
    for wanted in ("bytes=0-9", "bytes=999999999-", "nonsense"):
        answer = client.get(address, headers={"Range": wanted})
        assert (answer.status_code, answer.content == whole) == (200, True)


def test_a_truncated_recording_keeps_its_complete_views(client: httpx2.Client, recording_file: Path) -> None:
    content = recording_file.read_bytes()
    answer = client.post("/api/recordings", content=content[: len(content) * 3 // 4])
    assert answer.status_code == 201
    assert 0 < answer.json()["views"] < 4
    assert answer.json()["missing"]


def test_a_page_begins_before_an_id(client: httpx2.Client, recording: str) -> None:
    newest = client.get("/api/recordings", params={"limit": 1}).json()["recordings"]
    assert [found["id"] for found in newest] == [recording]
    older = client.get("/api/recordings", params={"before": recording}).json()["recordings"]
    assert recording not in [found["id"] for found in older]


@pytest.fixture
def clean_service(serve: Serve, tmp_path: Path) -> Iterator[ServedClient]:
    """Start a service whose data folder must hold no recording at the end."""
    with without_recognition(serve, tmp_path, limits={"upload_bytes": 50_000}) as client:
        yield client
        assert client.get("/api/recordings").json() == {"recordings": [], "next": None}
    files = [path.relative_to(tmp_path).parts[0] for path in tmp_path.rglob("*") if path.is_file()]
    assert set(files) <= {"lock", "pointchain.sqlite3"}


@pytest.mark.problem("not-mcap", "recording-empty", "recording-header", "too-large")
def test_an_unusable_upload_is_refused_and_leaves_no_file(
    clean_service: httpx2.Client,
    recording_file: Path,
    tmp_path_factory: pytest.TempPathFactory,
    assert_problem: AssertProblem,
) -> None:
    content = recording_file.read_bytes()
    assert len(content) > 50_000
    client = clean_service

    def post(body: bytes | Iterator[bytes]) -> httpx2.Response:
        return client.post("/api/recordings", content=body)

    assert "is empty" in assert_problem(post(b""), 422, "not-mcap")
    assert_problem(post(b"GIF89a" * 100), 422, "not-mcap")
    assert_problem(post(content[:2000]), 422, "recording-empty")
    assert_problem(post(content[:20]), 422, "recording-header")
    # too large by the declared length, and by the received length if none is declared
    assert "50000 bytes" in assert_problem(post(content), 413, "too-large")
    pieces = iter([content[at : at + 9000] for at in range(0, len(content), 9000)])
    assert_problem(post(pieces), 413, "too-large")

    header = RecordingHeader(depth_unit_m=1e-4, string_radius_m=0.004, T_flange_camera=np.eye(4))
    path = tmp_path_factory.mktemp("empty") / "no-views.mcap"
    RecordingWriter(path, header).close()
    assert_problem(post(path.read_bytes()), 422, "recording-empty")


def test_an_aborted_upload_leaves_no_file(clean_service: httpx2.Client, recording_file: Path) -> None:
    address = clean_service.base_url
    with socket.create_connection((address.host, address.port or 80)) as connection:
        head = "POST /api/recordings HTTP/1.1\r\nHost: localhost\r\nContent-Length: 40000\r\n\r\n"
        connection.sendall(head.encode() + recording_file.read_bytes()[:20_000])
    # the service still works
    assert clean_service.get("/healthz").status_code == 200


def test_free_space_is_checked_during_an_upload(
    clean_service: ServedClient, monkeypatch: pytest.MonkeyPatch, assert_problem: AssertProblem
) -> None:
    context: Context = clean_service.app.state.context
    usage = SimpleNamespace(free=2 * context.config.limits.min_free_bytes)

    def body() -> Iterator[bytes]:
        for number in range(40):  # without a declared length
            if number == 20:  # another program takes the remaining space
                wait_until(lambda: any(context.store.folder.incoming("x").parent.iterdir()))
                usage.free = context.config.limits.min_free_bytes
            yield b"a" * 1000

    monkeypatch.setattr("service.storage.disk_space.shutil.disk_usage", lambda _: usage)
    monkeypatch.setattr("service.api.routes.recordings.SPACE_CHECK_BYTES", 3000)
    assert_problem(clean_service.post("/api/recordings", content=body()), 507, "storage-full")


def test_concurrent_uploads_are_limited(
    clean_service: ServedClient, recording_file: Path, assert_problem: AssertProblem
) -> None:
    address, slots = clean_service.base_url, clean_service.app.state.context.uploads
    head = "POST /api/recordings HTTP/1.1\r\nHost: localhost\r\nContent-Length: 40000\r\n\r\n"
    with ExitStack() as connections:
        for _ in range(MAX_UPLOADS):
            one = connections.enter_context(socket.create_connection((address.host, address.port or 80)))
            one.sendall(head.encode() + recording_file.read_bytes()[:20_000])
        wait_until(lambda: slots.available_tokens == 0)
        # refused before its body has come
        another = connections.enter_context(socket.create_connection((address.host, address.port or 80), PATIENCE_S))
        another.sendall(head.encode())
        assert another.recv(64).startswith(b"HTTP/1.1 503 ")
        answer = clean_service.post("/api/recordings", content=b"a" * 1000)
        assert "try again" in assert_problem(answer, 503, "busy")
        assert int(answer.headers["retry-after"]) > 0
    wait_until(lambda: slots.available_tokens == MAX_UPLOADS)
    assert_problem(clean_service.post("/api/recordings", content=b"a" * 1000), 422, "not-mcap")


@pytest.mark.parametrize("path", ["/api/recordings/none", "/api/recordings/none/file"])
@pytest.mark.problem("recording-not-found")
def test_an_unknown_recording_is_not_found(client: httpx2.Client, path: str, assert_problem: AssertProblem) -> None:
    assert_problem(client.get(path), 404, "recording-not-found")


@pytest.mark.parametrize("bad", ["..", "%2e%2e", "..%2f..%2fpointchain.sqlite3", "A", "a" * 65, "a.mcap", "a%00b"])
@pytest.mark.parametrize("kind", ["recordings", "scans"])
def test_no_id_is_a_path(client: httpx2.Client, kind: str, bad: str) -> None:
    for path in (f"/api/{kind}/{bad}", f"/api/{kind}/{bad}/file", f"/api/{kind}/{bad}/model"):
        answer = client.get(path)
        assert answer.status_code in (404, 422)
        assert answer.headers["content-type"] == "application/problem+json"
