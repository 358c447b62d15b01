"""Messages at the start of the service: lines on a terminal, documents in a JSON log."""

import json
import re
from pathlib import Path

import pytest

from service.security.auth.tokens import add_token
from tests.service.service_process import process


def start_lines(tmp_path: Path, **variables: str) -> list[str]:
    """Start a service, check that it answers, and return its lines on stderr."""
    log, data = tmp_path / "log", tmp_path / "data"
    token = add_token(data, "a", "viewer")
    variables = {f"POINTCHAIN_{name}": value for name, value in variables.items()}
    with process(data, log, **variables) as (_, client):
        lines = log.read_text().splitlines()
        answer = client.get("/api/scans", headers={"Authorization": f"Bearer {token}"})
        assert answer.status_code == 200
    return lines


def test_text_log_has_plain_start_lines(tmp_path: Path) -> None:
    note, address, *_ = start_lines(tmp_path, HOST="0.0.0.0", LOG__FORMAT="text")
    assert note.startswith("pointchain serve: listening on 0.0.0.0")
    where = re.escape(str(tmp_path))
    assert re.fullmatch(rf"pointchain: http://127\.0\.0\.1:\d+ \(API: /docs\), data in {where}/data", address)


def test_json_log_has_start_documents_at_any_level(tmp_path: Path) -> None:
    note, address = map(json.loads, start_lines(tmp_path, HOST="0.0.0.0", LOG__FORMAT="json", LOG__LEVEL="error"))
    assert note["message"].startswith("pointchain serve: listening on 0.0.0.0")
    assert re.fullmatch(r"pointchain: http://127\.0\.0\.1:\d+ \(API: /docs\), data in .*/data", address["message"])


@pytest.mark.parametrize("host", ["::1", "::"])
def test_an_ipv6_address_is_printed_as_a_url(tmp_path: Path, host: str) -> None:
    lines = start_lines(tmp_path, HOST=host, LOG__FORMAT="text")
    assert any(line.startswith("pointchain: http://[::1]:") for line in lines)
