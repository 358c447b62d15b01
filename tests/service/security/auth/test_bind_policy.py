"""The addresses on which the service may listen."""

from pathlib import Path

import pytest

from service.cli.main import main
from service.security.auth.allowed_hosts import is_loopback
from service.security.auth.bind_policy import check_binding
from service.security.auth.tokens import TOKENS_FILE, add_token


def test_without_a_token_the_service_listens_on_loopback_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tmp_path / "a folder"
    for host in ("0.0.0.0", "::", "192.0.2.1", "cell.local"):
        assert main(["serve", "--unsupervised", "--host", host, "--port", "0", "--data-dir", str(data)]) == 1
        output = capsys.readouterr().err
        assert f"pointchain token add NAME --role maintainer --data-dir '{data}'" in output
    assert not data.exists()
    for host in ("127.0.0.1", "127.3.2.1", "::1", "localhost"):
        assert is_loopback(host)
        assert check_binding(host, data, ()).refusal is None


def test_with_a_token_the_service_listens_anywhere_and_reports_its_allowed_names(tmp_path: Path) -> None:
    add_token(tmp_path, "a", "viewer")
    assert check_binding("192.0.2.1", tmp_path, ()).note is None
    binding = check_binding("0.0.0.0", tmp_path, ())
    assert binding.refusal is None
    assert binding.note is not None
    assert "security.allowed_hosts" in binding.note
    assert check_binding("0.0.0.0", tmp_path, ("cell.local",)).note is None


def test_an_invalid_token_file_is_reported_before_the_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / TOKENS_FILE).write_text("{")
    assert main(["serve", "--unsupervised", "--port", "0", "--data-dir", str(tmp_path)]) == 1
    assert "tokens.json is damaged" in capsys.readouterr().err
