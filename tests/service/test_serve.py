"""What is said where the service begins: for people as lines, for programs in the log."""

import json
import logging
import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from service import serve as module
from service.config import ServiceConfig
from service.observing.json_log import JsonFormatter
from service.security.tokens import add_token

Begun = Callable[[str, str], list[str]]


class Nothing:
    """Serves nothing, and has done so in order."""

    started = True

    def __init__(self, *_: object, **__: object) -> None: ...

    def run(self, **_: object) -> None:
        """Returns at once."""


@pytest.fixture
def begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Begun:
    """`begun(form, host)`: the lines on stderr of a service that begins."""
    add_token(tmp_path, "a", "viewer")
    monkeypatch.setattr(module, "Server", Nothing)
    monkeypatch.setattr(module, "raise_open_files", lambda: None)
    monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)

    def run(form: str, host: str) -> list[str]:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(JsonFormatter())

        def start(*_: object) -> str:
            module.log.addHandler(handler)
            return form

        monkeypatch.setattr(module, "start_log", start)
        try:
            assert module.serve(ServiceConfig(data_dir=tmp_path, host=host, port=0)) == 0
        finally:
            module.log.removeHandler(handler)
            module.log.setLevel(logging.NOTSET)
        return capsys.readouterr().err.splitlines()

    return run


def test_at_a_terminal_they_are_lines(begun: Begun, tmp_path: Path) -> None:
    note, address = begun("text", "0.0.0.0")
    assert note.startswith("pointchain serve: listening on 0.0.0.0")
    assert re.fullmatch(rf"pointchain: http://127\.0\.0\.1:\d+/docs, data in {re.escape(str(tmp_path))}", address)


def test_in_a_log_for_programs_they_are_documents(begun: Begun, tmp_path: Path) -> None:
    logging.getLogger().setLevel(logging.ERROR)  # whatever else is told; pytest sets it anew for each test
    note, address = map(json.loads, begun("json", "0.0.0.0"))
    assert note["message"].startswith("pointchain serve: listening on 0.0.0.0")
    assert re.fullmatch(r"pointchain: http://127\.0\.0\.1:\d+/docs, data in .*", address["message"])
    assert address["message"].endswith(str(tmp_path))


def test_an_address_of_version_6_is_one_that_can_be_called(begun: Begun) -> None:
    assert begun("text", "::1")[0].startswith("pointchain: http://[::1]:")
    assert begun("text", "::")[-1].startswith("pointchain: http://[::1]:")
