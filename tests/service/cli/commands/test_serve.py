"""What a service says where it begins: for people as lines, for programs in the log."""

import json
import re
from pathlib import Path

import pytest

from service.security.auth.tokens import add_token
from tests.service.service_process import process


def begun(tmp_path: Path, **variables: str) -> list[str]:
    """The lines on stderr of a service that has begun, and answers where it says."""
    log, data = tmp_path / "log", tmp_path / "data"
    token = add_token(data, "a", "viewer")
    variables = {f"POINTCHAIN_{name}": value for name, value in variables.items()}
    with process(data, log, **variables) as (_, client):
        said = log.read_text().splitlines()
        answer = client.get("/api/scans", headers={"Authorization": f"Bearer {token}"})
        assert answer.status_code == 200
    return said


def test_at_a_terminal_they_are_lines(tmp_path: Path) -> None:
    note, address, *_ = begun(tmp_path, HOST="0.0.0.0", LOG__FORMAT="text")
    assert note.startswith("pointchain serve: listening on 0.0.0.0")
    where = re.escape(str(tmp_path))
    assert re.fullmatch(rf"pointchain: http://127\.0\.0\.1:\d+ \(API: /docs\), data in {where}/data", address)


def test_in_a_log_for_programs_they_are_documents_whatever_its_level(tmp_path: Path) -> None:
    note, address = map(json.loads, begun(tmp_path, HOST="0.0.0.0", LOG__FORMAT="json", LOG__LEVEL="error"))
    assert note["message"].startswith("pointchain serve: listening on 0.0.0.0")
    assert re.fullmatch(r"pointchain: http://127\.0\.0\.1:\d+ \(API: /docs\), data in .*/data", address["message"])


@pytest.mark.parametrize("host", ["::1", "::"])
def test_an_address_of_version_6_is_one_that_can_be_called(tmp_path: Path, host: str) -> None:
    said = begun(tmp_path, HOST=host, LOG__FORMAT="text")
    assert any(line.startswith("pointchain: http://[::1]:") for line in said)
