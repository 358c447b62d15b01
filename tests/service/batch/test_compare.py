"""`pointchain compare` lists what changed between two runs."""

import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest
from service.batch.errors import BatchError
from service.batch.model_diff import compare_models
from service.cli.main import main

Document = dict[str, Any]
ERROR: Document = {"schema": "pointchain/2", "error": {"type": "urn:pointchain:no-depth", "detail": "no depth"}}


@pytest.fixture(scope="module")
def knot() -> Document:
    """Return the model of an overhand knot: one chain, three crossings."""
    scan = simulate(make_scene("overhand-knot", 3), camera_model("exact", (640, 400)), 3)
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    model = recognise(scan.views, RecognitionRequest(radius_m=0.0042), scene).model
    return json.loads(json.dumps(model.to_json()))


def changed(document: Document, edit: Callable[[Document], None]) -> Document:
    copy = deepcopy(document)
    edit(copy)
    return copy


def shift(document: Document) -> None:
    """Move everything by 0.2 mm along y."""
    for chain in document["chains"]:
        chain["points"] = (np.array(chain["points"]) + [0.0, 2e-4, 0.0]).tolist()
    for crossing in document["crossings"]:
        crossing["point"][1] += 2e-4


def reverse(document: Document) -> None:
    """Begin the chain at its other end, which is the same string."""
    (chain,) = document["chains"]
    chain["points"].reverse()
    for crossing in document["crossings"]:
        for strand in (crossing["over"], crossing["under"]):
            strand["s_m"] = chain["length_m"] - strand["s_m"]


def exchange(document: Document) -> None:
    """Exchange over and under at the first crossing."""
    first = document["crossings"][0]
    first["over"], first["under"] = first["under"], first["over"]


def lose_crossing(document: Document) -> None:
    document["crossings"].pop()


def add_doubt(document: Document) -> None:
    document["quality"]["findings"].insert(0, undecided(0, 92, 0.61))


def undecided(crossing: int, s_mm: int, confidence: float) -> Document:
    """Return the doubt about over and under at a crossing."""
    return {
        "code": "crossing-undecided",
        "severity": "doubt",
        "message": f"chain 0 at {s_mm} mm: over or under? ({confidence})",
        "chains": [0],
        "crossing": crossing,
        "value": confidence,
    }


def thicken(document: Document) -> None:
    document["chains"][0]["radius_m"] = 0.006


@pytest.mark.parametrize(
    ("edit", "kind", "message"),
    [
        (shift, "moved", "0.2 mm at most"),
        (reverse, "same", ""),
        (exchange, "topology", "over and under exchanged at 1"),
        (lose_crossing, "topology", "3 crossings became 2"),
        (add_doubt, "findings", "0 crossing-undecided became 1"),
        (thicken, "radius", "radius 4.2 mm became 6 mm"),
        (lambda document: document["chains"].clear() or document["crossings"].clear(), "topology", "1 chains became 0"),
    ],
)
def test_each_change_has_its_kind(knot: Document, edit: Callable[[Document], None], kind: str, message: str):
    change = compare_models("knot", knot, changed(knot, edit), 1e-5)
    assert change.kind == kind
    assert message in change.what


def with_findings(document: Document, *findings: Document) -> Document:
    return changed(document, lambda copy: copy["quality"].update(findings=list(findings)))


def test_another_code_is_a_change_but_other_numbers_are_not(knot: Document):
    before = with_findings(knot, undecided(0, 92, 0.61))
    assert compare_models("knot", before, with_findings(knot, undecided(0, 93, 0.58)), 1e-5).kind == "same"
    bar = {"code": "possible-bar", "severity": "doubt", "message": "chain 0 at 92 mm: a bar?", "chains": [0]}
    change = compare_models("knot", before, with_findings(knot, bar), 1e-5)
    assert (change.kind, change.what) == ("findings", "1 crossing-undecided became 0, 0 possible-bar became 1")
    twice = with_findings(knot, undecided(0, 92, 0.61), undecided(1, 130, 0.7))
    assert compare_models("knot", before, twice, 1e-5).what == "1 crossing-undecided became 2"


def test_a_blocking_finding_is_a_change_but_a_note_is_not(knot: Document):
    bend = {"code": "sharp-bend", "severity": "blocking", "message": "it bends", "chains": [0], "s_range_m": [0.1, 0.2]}
    change = compare_models("knot", with_findings(knot), with_findings(knot, bend), 1e-5)
    assert (change.kind, change.what) == ("findings", "0 sharp-bend became 1")
    note = {"code": "piece-too-short", "severity": "note", "message": "a piece of 9 mm", "value": 0.009}
    assert compare_models("knot", with_findings(knot), with_findings(knot, note), 1e-5).kind == "same"


@pytest.mark.parametrize("radius_m", [0.03, 0.06, 0.1])
def test_a_ring_with_another_start_or_direction_is_the_same(knot: Document, radius_m: float):
    """Check rings with 1 micrometre of error: a chord of half a millimetre is off an arc of 30 mm radius by that."""
    turn = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    points = np.column_stack([radius_m * np.cos(turn), radius_m * np.sin(turn), np.full(100, 0.004)])

    def ring(points: Any) -> Document:
        chain = knot["chains"][0] | {"closed": True, "points": points.tolist(), "length_m": 2 * np.pi * radius_m}
        return knot | {"chains": [chain], "crossings": []}

    for other in (np.roll(points, 37, axis=0), points[::-1]):
        assert compare_models("ring", ring(points), ring(other), 1e-5).kind == "same"


def test_distances_are_measured_between_the_lines(knot: Document):
    change = compare_models("knot", knot, changed(knot, shift), 1e-5)
    assert change.mean_m is not None
    assert change.max_deviation_m is not None
    # a shift along a strand is no distance, so the mean is below the shift; across a strand the distance is the shift
    assert 0.5e-4 < change.mean_m < 2e-4
    assert change.max_deviation_m == pytest.approx(2e-4, rel=0.02)
    assert compare_models("knot", knot, changed(knot, shift), 3e-4).kind == "same", "within the tolerance"


@pytest.mark.parametrize(
    ("before", "after", "kind"), [("model", "error", "lost"), ("error", "model", "gained"), ("error", "error", "same")]
)
def test_errors_are_compared_too(knot: Document, before: str, after: str, kind: str):
    documents = {"model": knot, "error": ERROR}
    assert compare_models("knot", documents[before], documents[after], 1e-5).kind == kind


def test_another_error_is_a_change():
    other = {"schema": "pointchain/2", "error": {"type": "urn:pointchain:too-crowded", "detail": "crowded"}}
    assert compare_models("knot", ERROR, other, 1e-5).kind == "error"


def test_a_document_of_another_schema_is_rejected(knot: Document):
    with pytest.raises(BatchError, match="not of schema"):
        compare_models("knot", knot, {"chains": 3}, 1e-5)
    other = knot | {"schema": "pointchain/1"}
    for before, after in ((other, knot), (knot, other)):
        with pytest.raises(BatchError, match="knot: the document is of schema 'pointchain/1'; this version"):
            compare_models("knot", before, after, 1e-5)


def write(path: Path, documents: list[Document]) -> Path:
    path.write_text("".join(f"{json.dumps(document)}\n" for document in documents))
    return path


def named(document: Document, name: str) -> Document:
    return document | {"recording": {"file": f"{name}.mcap", "sha256": name * 8}}


def test_recordings_are_matched_by_content(knot: Document, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    before = write(tmp_path / "a.jsonl", [named(knot, "a"), named(knot, "b"), named(knot, "c")])
    after = write(
        tmp_path / "b.jsonl", [named(changed(knot, shift), "c"), named(ERROR, "a"), named(knot, "b"), named(knot, "d")]
    )
    assert main(["compare", str(before), str(after)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:4]] == ["1", "1", "1", "1"]
    assert lines[4].split() == ["model", "lost", "a.mcap", "no", "depth"]
    assert lines[5].startswith("lines moved")
    assert "c.mcap" in lines[5]
    assert lines[6].split() == ["only", "after", "d.mcap"]
    assert main(["compare", str(before), str(after), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["counts"]["lost"], document["counts"]["moved"], document["counts"]["same"]) == (1, 1, 1)
    assert document["only_after"] == ["d.mcap"]


def test_an_unreadable_recording_is_a_lost_model_and_copies_are_distinguished(
    knot: Document, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    unreadable = ERROR | {"recording": {"file": "a.mcap", "sha256": None}}
    copy = named(knot, "b") | {"recording": {"file": "copy of b.mcap", "sha256": "b" * 8}}
    lost = ERROR | {"recording": copy["recording"]}
    before = write(tmp_path / "a.jsonl", [named(knot, "a"), copy, named(knot, "b")])
    after = write(tmp_path / "b.jsonl", [named(knot, "b"), unreadable, lost])
    for first, second, kind in ((before, after, "lost"), (after, before, "gained")):
        assert main(["compare", str(first), str(second), "--json"]) == 1
        document = json.loads(capsys.readouterr().out)
        assert (document["counts"][kind], document["counts"]["same"]) == (2, 1)
        assert {one["recording"] for one in document["changes"] if one["kind"] == kind} == {"a.mcap", "copy of b.mcap"}
        assert document["only_before"] == document["only_after"] == []


def test_the_exit_code_is_0_if_nothing_changed(knot: Document, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    before = write(tmp_path / "a.jsonl", [knot, knot])  # lines without names
    assert main(["compare", str(before), str(before)]) == 0
    assert capsys.readouterr().out.split() == ["2", "unchanged"]


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "cannot be read"), (b"\xff\xfe", "not a file of JSON lines"), (b"[1\n", "line 1"), (b"[1]\n", "line 1")],
)
def test_a_file_that_cannot_be_compared_is_an_error(
    knot: Document, tmp_path: Path, content: bytes | None, message: str, capsys: pytest.CaptureFixture[str]
):
    before, after = write(tmp_path / "a.jsonl", [knot]), tmp_path / "b.jsonl"
    if content is not None:
        after.write_bytes(content)
    assert main(["compare", str(before), str(after)]) == 2
    assert message in capsys.readouterr().err


def test_runs_without_a_common_recording_are_an_error(
    knot: Document, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    before = write(tmp_path / "a.jsonl", [named(knot, "a")])
    after = write(tmp_path / "b.jsonl", [named(knot, "b")])
    assert main(["compare", str(before), str(after)]) == 2
    assert "no recording in common" in capsys.readouterr().err
