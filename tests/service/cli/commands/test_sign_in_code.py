"""`pointchain token code`: the code, the address that other devices can open, and its QR code."""

import json
import re
import subprocess
import sys
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from service.cli.commands.sign_in_code import console_address, parse_address, qr_code_lines
from service.cli.commands.tokens import MAX_CODE_MINUTES
from service.cli.main import main
from service.clock import utc_now
from service.config.loader import ServiceConfig
from service.config.sections import SecurityConfig
from service.security.audit.reader import read_audit
from service.security.auth.private_file import TokensError
from service.security.auth.sessions import SESSIONS_FILE, read_sessions, redeem_code
from service.security.auth.sign_in_codes import MAX_MINUTES
from service.security.auth.tokens import TOKENS_FILE, add_token
from service.storage.data_folder import DataFolder
from service.storage.store import Store

Output = pytest.CaptureFixture[str]
MODULE_PX = 6


@pytest.fixture
def data(tmp_path: Path) -> Path:
    add_token(tmp_path, "anna", "operator")
    return tmp_path


def run(data: Path, *arguments: str) -> int:
    return main(["token", "code", "anna", "--data-dir", str(data), *arguments])


def decode(lines: list[str]) -> str:
    """Read a QR code as a camera does, from the colours in which a terminal shows its lines."""
    rows: list[list[bool]] = []
    for line in lines:
        found = re.fullmatch("\x1b\\[30;107m([ ▀▄█]+)\x1b\\[0m", line)
        assert found is not None, line
        rows += [[one in "▀█" for one in found[1]], [one in "▄█" for one in found[1]]]
    assert not any(rows[0] + rows[3]), "a QR code needs a white margin"
    picture = np.where(np.kron(np.array(rows), np.ones((MODULE_PX, MODULE_PX))) > 0, 0, 255).astype(np.uint8)
    return cv2.QRCodeDetector().detectAndDecode(picture)[0]


def test_a_code_is_printed_with_its_address_and_qr_code(
    data: Path, capsys: Output, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POINTCHAIN_HOST", "192.0.2.7")
    assert run(data) == 0
    output = capsys.readouterr()
    code = output.out.strip()
    (stored,) = read_sessions(data / SESSIONS_FILE).codes
    assert f"as anna (operator). It is valid once, until {stored.expires.astimezone():%H:%M:%S} (10 min)" in output.err
    assert "Open http://192.0.2.7:8000 and enter the code" in output.err
    assert decode([line for line in output.err.splitlines() if line.startswith("\x1b")]) == (
        f"http://192.0.2.7:8000/#/sign-in/{code}"
    )
    made = redeem_code(data, code, utc_now())
    assert made is not None
    assert made.token.name == "anna"


@pytest.mark.parametrize("length", [1, 10, 40, 63, 100])
def test_addresses_of_every_length_can_be_scanned(length: int) -> None:
    address = f"https://{'a' * length}.example/#/sign-in/0123-4567"
    assert decode(qr_code_lines(address)) == address


def test_a_code_for_programs_is_one_document(data: Path, capsys: Output) -> None:
    assert run(data, "--json", "--minutes", "3", "--address", "https://cell.example.com/") == 0
    output = capsys.readouterr()
    document = json.loads(output.out)
    code = document.pop("code")
    expires = datetime.fromisoformat(document.pop("expires"))
    assert timedelta(minutes=2) < expires - utc_now() <= timedelta(minutes=3)
    assert document == {
        "name": "anna",
        "role": "operator",
        "address": f"https://cell.example.com/#/sign-in/{code}",
        "message": "The service refuses the name cell.example.com: add it to security.allowed_hosts.",
    }
    assert "\x1b" not in output.err


def test_a_service_that_no_phone_can_reach_has_no_qr_code(data: Path, capsys: Output) -> None:
    assert run(data) == 0
    output = capsys.readouterr().err
    assert "On this machine, open http://127.0.0.1:8000" in output
    assert "which a phone or a tablet cannot reach" in output
    assert "the page Security of the manual" in output
    assert "\x1b" not in output


@pytest.mark.parametrize(
    ("settings", "names", "url", "remote"),
    [
        ({"host": "192.0.2.7"}, (), "http://192.0.2.7:8000", True),
        ({"host": "2001:db8::7", "port": 80}, (), "http://[2001:db8::7]:80", True),
        ({"host": "cell.local"}, ("other",), "http://cell.local:8000", True),
        ({"host": "0.0.0.0"}, ("cell.local", "x"), "http://cell.local:8000", True),
        ({"host": "::"}, ("[2001:db8::7]",), "http://[2001:db8::7]:8000", True),
        ({"host": "0.0.0.0"}, (), "http://127.0.0.1:8000", False),
        ({"host": "::1"}, ("cell.local",), "http://[::1]:8000", False),
        ({"host": "192.0.2.7", "port": 0}, (), None, False),
    ],
)
def test_the_address_is_that_of_the_configuration(
    settings: dict[str, Any], names: tuple[str, ...], url: str | None, remote: bool
) -> None:
    found = console_address(ServiceConfig(security=SecurityConfig(allowed_hosts=names), **settings), None)
    assert (found.url, found.remote) == (url, remote)
    assert (found.note is None) == remote


def test_a_given_address_that_the_service_refuses_is_reported() -> None:
    config = ServiceConfig(host="127.0.0.1", security=SecurityConfig(allowed_hosts=("cell.local",)))
    assert console_address(config, "https://cell.local").note is None
    note = console_address(config, "https://other.local:8443").note
    assert note is not None
    assert "other.local:8443" in note


@pytest.mark.parametrize(
    "text",
    ["", "cell", "ftp://cell", "http://", "http://cell:0", "http://cell:65536", "http://cell/x", "http://cell?x",
     "http://cell#x", "http://me@cell", "http://["],
)  # fmt: skip
def test_another_address_is_refused(text: str, data: Path, capsys: Output) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse_address(text)
    with pytest.raises(SystemExit):
        run(data, "--address", text)
    assert "is not the address of a console" in capsys.readouterr().err
    assert not (data / SESSIONS_FILE).exists()


@pytest.mark.parametrize("minutes", ["0", "61", "-1", "1.5", "x"])
def test_the_lifetime_has_bounds(minutes: str, data: Path, capsys: Output) -> None:
    assert MAX_CODE_MINUTES == MAX_MINUTES
    with pytest.raises(SystemExit):
        run(data, "--minutes", minutes)
    assert "from 1 to 60 minutes are possible" in capsys.readouterr().err


def test_a_code_needs_a_token(tmp_path: Path, capsys: Output) -> None:
    assert run(tmp_path) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith("pointchain token code: there is no token anna")


def test_a_terminal_without_unicode_gets_the_code(data: Path) -> None:
    arguments = ["token", "code", "anna", "--data-dir", str(data), "--address", "http://localhost:8000"]
    done = subprocess.run(
        [sys.executable, "-c", "import sys; from service.cli.main import main; sys.exit(main())", *arguments],
        env={"PYTHONIOENCODING": "latin-1", "PYTHONPATH": str(Path(__file__).parents[4])},
        capture_output=True,
        text=True,
        check=True,
    )
    assert re.fullmatch(r"\w{4}-\w{4}\n", done.stdout)
    assert "this terminal cannot show it" in done.stderr


def test_the_list_counts_browsers_and_a_removal_signs_them_out(data: Path, capsys: Output) -> None:
    for _ in range(2):
        run(data)
        redeem_code(data, capsys.readouterr().out.strip(), utc_now())
    assert main(["token", "list", "--data-dir", str(data)]) == 0
    name, role, _, count = capsys.readouterr().out.strip().split("\t")
    assert (name, role, count) == ("anna", "operator", "2")
    assert main(["token", "remove", "anna", "--data-dir", str(data)]) == 0
    assert "its browsers are signed out" in capsys.readouterr().err
    assert read_sessions(data / SESSIONS_FILE).sessions == ()


def test_a_token_can_be_removed_while_the_sessions_are_damaged(data: Path, capsys: Output) -> None:
    (data / SESSIONS_FILE).write_text("{")
    assert main(["token", "remove", "anna", "--data-dir", str(data)]) == 0
    assert "entries of ended sessions stay on the disk" in capsys.readouterr().err
    assert "anna" not in (data / TOKENS_FILE).read_text()
    with pytest.raises(TokensError):
        read_sessions(data / SESSIONS_FILE)
    add_token(data, "anna", "viewer")
    assert run(data) == 1
    assert main(["token", "list", "--data-dir", str(data)]) == 1


def test_the_audit_log_has_the_command_without_the_code(data: Path, capsys: Output) -> None:
    folder = DataFolder(data)
    Store(folder).close()
    folder.close()
    assert run(data) == 0
    code = capsys.readouterr().out.strip()
    (entry,) = read_audit(data, None, None, None, 10)
    assert (entry.who, entry.what) == ("console", "token code anna")
    assert code not in f"{entry}"
