"""`pointchain export` writes files from which other programs read the values of the model."""

import copy
import csv
import io
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from cell.recording import RecordingWriter, read_recording, read_result
from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.cli.main import main
from service.interchange.point_files import VERTEX
from service.processing.results import recognise_recording


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "several.mcap"
    write_simulation(simulate(make_scene("several", 1), camera_model("exact", (320, 200)), 1, views=4), path)
    return path


@pytest.fixture(scope="module")
def document(recording: Path) -> dict[str, Any]:
    """Return a model of several strings. The first is marked as closed."""
    model = json.loads(json.dumps(recognise_recording(recording).model.to_json()))
    assert len(model["chains"]) >= 2
    assert model["crossings"]
    model["chains"][0]["closed"] = True
    return model


@pytest.fixture
def model_file(document: dict[str, Any], tmp_path: Path) -> Path:
    path = tmp_path / "model.json"
    path.write_text(json.dumps(document) + "\n")
    return path


def points_of(document: dict[str, Any]) -> np.ndarray:
    return np.concatenate([chain["points"] for chain in document["chains"]])


def edges_of(document: dict[str, Any]) -> list[tuple[int, int]]:
    edges, first = [], 0
    for chain in document["chains"]:
        count = len(chain["points"])
        edges += [(first + k, first + k + 1) for k in range(count - 1)]
        edges += [(first + count - 1, first)] if chain["closed"] else []
        first += count
    return edges


def test_a_ply_file_has_points_edges_and_properties(document: dict[str, Any], model_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "model.ply"
    assert main(["export", str(model_file), str(out)]) == 0
    cloud = o3d.io.read_point_cloud(out)
    np.testing.assert_allclose(np.asarray(cloud.points), points_of(document), rtol=0, atol=1e-7)
    lines = o3d.io.read_line_set(out)
    np.testing.assert_allclose(np.asarray(lines.points), points_of(document), rtol=0, atol=1e-7)
    assert [tuple(edge) for edge in np.asarray(lines.lines).tolist()] == edges_of(document)
    # only the tensor reader of Open3D keeps all properties
    attributes = o3d.t.io.read_point_cloud(out).point
    for name in ("arc_length_m", "sigma_m", "views"):
        wanted = np.concatenate([chain[name] for chain in document["chains"]])
        np.testing.assert_allclose(attributes[name].numpy().ravel(), wanted, rtol=1e-6, atol=1e-9)
    for name, key in (("chain", "id"), ("radius_m", "radius_m")):
        wanted = np.concatenate([[chain[key]] * len(chain["points"]) for chain in document["chains"]])
        np.testing.assert_allclose(attributes[name].numpy().ravel(), wanted, rtol=1e-6)


def test_a_ply_file_matches_its_header(document: dict[str, Any], model_file: Path, tmp_path: Path) -> None:
    """Read the file by its header alone, as any other program does."""
    out = tmp_path / "model.ply"
    main(["export", str(model_file), str(out)])
    head, _, body = out.read_bytes().partition(b"end_header\n")
    assert f"comment {document['schema']}" in head.decode("ascii").splitlines()
    kinds = {"float": "<f4", "int": "<i4"}
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for line in head.decode("ascii").splitlines():
        match line.split():
            case ["element", name, count]:
                elements.append((name, int(count), []))
            case ["property", kind, name]:
                elements[-1][2].append((name, kinds[kind]))
    assert [name for name, _, _ in elements] == ["vertex", "edge"]
    offset = 0
    blocks = {}
    for name, count, fields in elements:
        kind = np.dtype(fields)
        blocks[name] = np.frombuffer(body, kind, count, offset)
        offset += count * kind.itemsize
    assert offset == len(body)
    assert blocks["vertex"].dtype == VERTEX
    ids = np.concatenate([[chain["id"]] * len(chain["points"]) for chain in document["chains"]])
    np.testing.assert_array_equal(blocks["vertex"]["chain"], ids)
    assert [tuple(edge) for edge in blocks["edge"].tolist()] == edges_of(document)


def test_a_csv_file_has_one_row_per_point(document: dict[str, Any], model_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "model.csv"
    assert main(["export", str(model_file), str(out)]) == 0
    rows = list(csv.DictReader(io.StringIO(out.read_text())))
    assert list(rows[0]) == ["chain", "point", "x_m", "y_m", "z_m", "arc_length_m", "sigma_m", "views", "radius_m"]
    expected = [
        (chain["id"], k, *point, chain["arc_length_m"][k], chain["sigma_m"][k], chain["views"][k], chain["radius_m"])
        for chain in document["chains"]
        for k, point in enumerate(chain["points"])
    ]
    assert [tuple(float(value) for value in row.values()) for row in rows] == expected


def test_an_mcap_file_has_the_model_and_its_scene(document: dict[str, Any], model_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "model.mcap"
    assert main(["export", str(model_file), str(out)]) == 0
    assert read_result(out) == document
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        ((_, channel, _, scene),) = reader.iter_decoded_messages(["/result/scene"])
        assert channel.topic == "/result/scene"
    assert len(scene.entities) == len(document["chains"]) + len(document["crossings"])
    drawn = np.concatenate([[(p.x, p.y, p.z) for p in e.lines[0].points] for e in scene.entities if e.lines])
    np.testing.assert_array_equal(drawn, points_of(document))
    # a second export from the first file gives the same bytes
    assert main(["export", str(out), str(tmp_path / "again.mcap")]) == 0
    assert (tmp_path / "again.mcap").read_bytes() == out.read_bytes()


def test_the_recording_of_a_live_scan_gives_its_model(
    document: dict[str, Any], recording: Path, tmp_path: Path
) -> None:
    source = read_recording(recording)
    with RecordingWriter(tmp_path / "live.mcap", source.header) as writer:
        writer.write_view(source.views[0])
        writer.write_result(document)
    assert main(["export", str(tmp_path / "live.mcap"), str(tmp_path / "a.csv")]) == 0
    (tmp_path / "model.json").write_text(json.dumps(document))
    assert main(["export", str(tmp_path / "model.json"), str(tmp_path / "b.csv")]) == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_stdin_gives_the_model(document: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(json.dumps(document).encode())))
    assert main(["export", "-", str(tmp_path / "a.csv")]) == 0
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 1 + len(points_of(document))


def test_a_model_without_strings_is_exported(document: dict[str, Any], tmp_path: Path) -> None:
    empty = {**document, "chains": [], "crossings": [], "grasps": []}
    (tmp_path / "model.json").write_text(json.dumps(empty))
    for kind in ("ply", "csv", "mcap"):
        assert main(["export", str(tmp_path / "model.json"), str(tmp_path / f"a.{kind}")]) == 0
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 1
    assert b"element vertex 0\n" in (tmp_path / "a.ply").read_bytes()


def changed(document: dict[str, Any], path: str, value: Any) -> str:
    """Return the document with another value at a path, as JSON."""
    document = copy.deepcopy(document)
    *keys, last = [int(key) if key.isdigit() else key for key in path.split(".")]
    parent: Any = document
    for key in keys:
        parent = parent[key]
    parent[last] = value
    return json.dumps(document)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("schema", "pointchain/3", "is of schema 'pointchain/3'; this version of Pointchain reads 'pointchain/2'"),
        ("schema", None, "a JSON object with schema 'pointchain/2' is needed"),
        (
            "error",
            {"type": "urn:pointchain:no-depth", "detail": "nothing seen"},
            "holds an error, not a model: nothing seen",
        ),
        ("chains", None, "chains: Input should be a valid list"),
        ("chains.0.points.3", [1.0, 2.0], "chains.0.points.3.2: Field required"),
        ("chains.1.views", [1], "chain 1 has a different number of values and points"),
        ("chains.1.id", 0, "two chains have the same id"),
        ("crossings.0.over.chain", 77, "a crossing has an unknown chain"),
        ("chains.0.radius_m", float("nan"), "it holds NaN"),
    ],
)
def test_a_document_that_is_not_a_model_is_rejected(
    document: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], path: str, value: Any, message: str
) -> None:
    (tmp_path / "model.json").write_text(changed(document, path, value))
    assert main(["export", str(tmp_path / "model.json"), str(tmp_path / "a.ply")]) == 1
    assert message in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["model.json"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "there is no"),
        (b"", "not JSON"),
        (b"solid", "not JSON"),
        (b"\xff\xfe", "not JSON"),
        (b"[1, 2]", "a JSON object"),
        (b"[" * 100_000, "not JSON"),
        (
            b'{"schema": 1}\n{"schema": 2}\n',
            "model.json has 2 documents: give one, for example by `sed -n 1p model.json",
        ),
    ],
)
def test_a_file_that_is_not_a_model_is_rejected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None, message: str
) -> None:
    if content is not None:
        (tmp_path / "model.json").write_bytes(content)
    assert main(["export", str(tmp_path / "model.json"), str(tmp_path / "a.ply")]) == 1
    assert message in capsys.readouterr().err.replace("no " + str(tmp_path), "there is no")
    assert not (tmp_path / "a.ply").exists()


def test_a_recording_without_a_model_is_rejected(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(recording), str(tmp_path / "a.ply")]) == 1
    assert "several.mcap holds no model" in capsys.readouterr().err
    (tmp_path / "cut.mcap").write_bytes(recording.read_bytes()[:100])
    assert main(["export", str(tmp_path / "cut.mcap"), str(tmp_path / "a.ply")]) == 1
    assert "holds no model" in capsys.readouterr().err


def test_an_unwritable_output_is_an_error(model_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(model_file), str(tmp_path / "a.obj")]) == 1
    assert "a.obj has no known format: choose a name that ends in one of .ply, .csv, .mcap" in capsys.readouterr().err
    assert main(["export", str(model_file), str(tmp_path / "none" / "a.ply")]) == 1
    assert "a.ply cannot be written: No such file or directory" in capsys.readouterr().err
    (tmp_path / "a.ply").write_text("mine")
    assert main(["export", str(model_file), str(tmp_path / "a.ply")]) == 1
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "a.ply").read_text() == "mine"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.ply", "model.json"]
