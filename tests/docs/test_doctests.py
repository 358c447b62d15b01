"""The examples in the docstrings of the main entry points run and print what they show."""

import doctest
import sys
from typing import Any

import pytest

from calibration.hand_eye import solve_hand_eye
from cell.devices import View
from cell.recording import RecordingWriter
from pointchain_client import AsyncClient, Client
from recognition.pipeline import recognise

THINGS = [recognise, Client, AsyncClient, View, RecordingWriter, solve_hand_eye]


@pytest.mark.parametrize("thing", THINGS, ids=lambda x: x.__name__)
def test_the_example_runs(thing: Any) -> None:
    module = sys.modules[thing.__module__]
    finder = doctest.DocTestFinder(recurse=False)
    (example,) = finder.find(thing, thing.__name__, module=module, globs=dict(vars(module)))
    assert len(example.examples) >= 2
    report: list[str] = []
    result = doctest.DocTestRunner(verbose=False).run(example, out=report.append)
    assert result.failed == 0, "".join(report)
