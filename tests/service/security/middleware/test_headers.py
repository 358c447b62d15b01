"""The security headers of answers."""

import httpx2
import pytest

from service.storage.scan_store import ScanStore
from tests.service.conftest import ServedClient


def assert_headers(answer: httpx2.Response) -> None:
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["x-frame-options"] == "DENY"
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert answer.headers["cross-origin-opener-policy"] == "same-origin"
    assert answer.headers["cross-origin-resource-policy"] == "same-origin"
    assert answer.headers["content-security-policy"].startswith("default-src 'self'; ")
    assert "server" not in answer.headers


def test_every_answer_has_the_headers(client: ServedClient, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in ("/api/cell", "/healthz", "/docs", "/api/none", "/api/scans/x", "/api/scans?token=x"):
        answer = client.get(path)
        assert_headers(answer)
        assert answer.headers["cache-control"] == "no-store"
    assert_headers(client.get("/healthz", headers={"Host": "evil.example"}))

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("on purpose")

    monkeypatch.setattr(ScanStore, "get", fail)
    unexpected = client.get("/api/scans/x")
    assert unexpected.status_code == 500
    assert_headers(unexpected)
    assert unexpected.headers["cache-control"] == "no-store"
    assert unexpected.headers["connection"] == "close"  # uvicorn closes the connection


def test_a_cache_must_revalidate_a_file(client: ServedClient, recording: str) -> None:
    answer = client.get(f"/api/recordings/{recording}/file")
    assert answer.headers["cache-control"] == "no-cache"
    assert answer.headers["etag"]
    assert_headers(answer)


def test_inline_scripts_are_forbidden(client: ServedClient) -> None:
    for path in ("/docs", "/api/cell"):
        policy = client.get(path).headers["content-security-policy"]
        assert "script-src" not in policy
        assert "unsafe-eval" not in policy
    assert "style-src 'self' 'unsafe-inline'" in client.get("/docs").headers["content-security-policy"]
