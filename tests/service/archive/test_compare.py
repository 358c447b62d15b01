"""`pointchain compare`: what changed between two runs."""

import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.simulation.camera import camera_model
from cell.simulation.scenes import make_scene
from cell.simulation.simulate import simulate
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocess import Scene
from service.archive.changes import change
from service.archive.errors import ArchiveError
from service.cli import main

Document = dict[str, Any]
ERROR: Document = {"schema": "pointchain/1", "error": {"type": "urn:pointchain:no-depth", "detail": "no depth"}}


@pytest.fixture(scope="module")
def knot() -> Document:
    """A model of an overhand knot: one chain, three crossings."""
    scan = simulate(make_scene("overhand-knot", 3), camera_model("ideal", (640, 400)), 3)
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    model = recognise(scan.views, ChainParameters.for_radius(0.0042), scene, "graph").model
    return json.loads(json.dumps(model.to_json()))


def changed(document: Document, how: Callable[[Document], None]) -> Document:
    copy = deepcopy(document)
    how(copy)
    return copy


def shift(document: Document) -> None:
    """Everything 0.2 mm along y."""
    for chain in document["chains"]:
        chain["points"] = (np.array(chain["points"]) + [0.0, 2e-4, 0.0]).tolist()
    for crossing in document["crossings"]:
        crossing["point"][1] += 2e-4


def turn_round(document: Document) -> None:
    """The chain from its other end: the same string."""
    (chain,) = document["chains"]
    chain["points"].reverse()
    for crossing in document["crossings"]:
        for strand in (crossing["over"], crossing["under"]):
            strand["s_m"] = chain["length_m"] - strand["s_m"]


def exchange(document: Document) -> None:
    """Over and under at the first crossing."""
    first = document["crossings"][0]
    first["over"], first["under"] = first["under"], first["over"]


def lose_crossing(document: Document) -> None:
    document["crossings"].pop()


def doubt(document: Document) -> None:
    document["quality"]["ambiguities"].append("which of the two")


@pytest.mark.parametrize(
    ("how", "kind", "said"),
    [
        (shift, "moved", "0.2 mm at most"),
        (turn_round, "same", ""),
        (exchange, "topology", "over and under exchanged at 1"),
        (lose_crossing, "topology", "3 crossings became 2"),
        (doubt, "doubts", "0 ambiguities became 1"),
        (lambda document: document["chains"].clear() or document["crossings"].clear(), "topology", "1 chains became 0"),
    ],
)
def test_each_change_has_its_name(knot: Document, how: Callable[[Document], None], kind: str, said: str):
    found = change("knot", knot, changed(knot, how), 1e-5)
    assert found.kind == kind
    assert said in found.what


def test_distances_are_those_between_the_lines(knot: Document):
    found = change("knot", knot, changed(knot, shift), 1e-5)
    assert found.mean_m is not None
    assert found.worst_m is not None
    # Along the string nothing moves: the mean is less than the shift, the worst, at a strand across it, is the shift.
    assert 0.5e-4 < found.mean_m < 2e-4
    assert found.worst_m == pytest.approx(2e-4, rel=0.02)
    assert change("knot", knot, changed(knot, shift), 3e-4).kind == "same", "within the tolerance"


@pytest.mark.parametrize(
    ("before", "after", "kind"), [("model", "error", "lost"), ("error", "model", "gained"), ("error", "error", "same")]
)
def test_errors_are_compared_too(knot: Document, before: str, after: str, kind: str):
    documents = {"model": knot, "error": ERROR}
    assert change("knot", documents[before], documents[after], 1e-5).kind == kind


def test_another_error_is_a_change():
    other = {"schema": "pointchain/1", "error": {"type": "urn:pointchain:too-crowded", "detail": "crowded"}}
    assert change("knot", ERROR, other, 1e-5).kind == "error"


def test_what_is_no_model_is_refused(knot: Document):
    with pytest.raises(ArchiveError, match="not of schema"):
        change("knot", knot, {"chains": 3}, 1e-5)


def write(path: Path, documents: list[Document]) -> Path:
    path.write_text("".join(f"{json.dumps(document)}\n" for document in documents))
    return path


def named(document: Document, name: str) -> Document:
    return document | {"recording": {"file": f"{name}.mcap", "sha256": name * 8}}


def test_runs_are_compared_by_the_recordings_content(
    knot: Document, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    before = write(tmp_path / "a.jsonl", [named(knot, "a"), named(knot, "b"), named(knot, "c")])
    after = write(
        tmp_path / "b.jsonl", [named(changed(knot, shift), "c"), named(ERROR, "a"), named(knot, "b"), named(knot, "d")]
    )
    assert main(["compare", str(before), str(after)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:4]] == ["1", "1", "1", "1"]
    assert lines[4].split() == ["no", "model", "any", "more", "a.mcap", "no", "depth"]
    assert lines[5].startswith("moved")
    assert "c.mcap" in lines[5]
    assert lines[6].split() == ["only", "after", "d.mcap"]
    assert main(["compare", str(before), str(after), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["counts"]["lost"], document["counts"]["moved"], document["counts"]["same"]) == (1, 1, 1)
    assert document["only_after"] == ["d.mcap"]


def test_nothing_changed_is_said_by_the_exit_code(knot: Document, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    before = write(tmp_path / "a.jsonl", [knot, knot])  # as an older release printed them, without names
    assert main(["compare", str(before), str(before)]) == 0
    assert capsys.readouterr().out.split() == ["2", "the", "same"]


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "cannot be read"), (b"\xff\xfe", "not a file of JSON lines"), (b"[1\n", "line 1"), (b"[1]\n", "line 1")],
)
def test_what_cannot_be_compared_is_told(
    knot: Document, tmp_path: Path, content: bytes | None, said: str, capsys: pytest.CaptureFixture[str]
):
    before, after = write(tmp_path / "a.jsonl", [knot]), tmp_path / "b.jsonl"
    if content is not None:
        after.write_bytes(content)
    assert main(["compare", str(before), str(after)]) == 2
    assert said in capsys.readouterr().err


def test_nothing_in_common_is_told(knot: Document, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    before = write(tmp_path / "a.jsonl", [named(knot, "a")])
    after = write(tmp_path / "b.jsonl", [named(knot, "b")])
    assert main(["compare", str(before), str(after)]) == 2
    assert "no recording in common" in capsys.readouterr().err
