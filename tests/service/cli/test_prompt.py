"""A question is put only where somebody can answer."""

import os
import pty
import sys

import pytest

from service.cli.prompt import agreed


@pytest.mark.parametrize(("answer", "yes"), [("y", True), ("Yes ", True), ("n", False), ("", False), ("yet", False)])
def test_only_a_plain_yes_is_one(monkeypatch: pytest.MonkeyPatch, answer: str, yes: bool) -> None:
    person, program = pty.openpty()
    with os.fdopen(program) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        os.write(person, f"{answer}\n".encode())
        assert agreed("shall it be so?") is yes
    os.close(person)


def test_where_nobody_sits_nobody_is_asked(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    with open(os.devnull) as stdin:  # noqa: PTH123 (a device)
        monkeypatch.setattr(sys, "stdin", stdin)
        assert not agreed("shall it be so?")
    assert capsys.readouterr().err == ""
