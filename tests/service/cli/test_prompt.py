"""Questions are asked only at a terminal."""

import os
import pty
import sys

import pytest

from service.cli.prompt import confirm


@pytest.mark.parametrize(("answer", "yes"), [("y", True), ("Yes ", True), ("n", False), ("", False), ("yet", False)])
def test_only_y_and_yes_confirm(monkeypatch: pytest.MonkeyPatch, answer: str, yes: bool) -> None:
    terminal, program = pty.openpty()
    with os.fdopen(program) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        os.write(terminal, f"{answer}\n".encode())
        assert confirm("continue?") is yes
    os.close(terminal)


def test_without_a_terminal_nothing_is_asked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with open(os.devnull) as stdin:  # noqa: PTH123 (a device)
        monkeypatch.setattr(sys, "stdin", stdin)
        assert not confirm("continue?")
    assert capsys.readouterr().err == ""
