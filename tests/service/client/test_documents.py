"""The dataclasses of the client against `service/openapi.json` and against documents of the service."""

import copy
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import pointchain_client as client
from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from pointchain_client import Cell, Model, ModelError, Recording, Scan
from pointchain_client.documents.decoding import DecodeError, decode, member_names
from pointchain_client.documents.scans import ScanList
from recognition.model import PointChainModel, Provenance
from recognition.pipeline import recognise
from recognition.preprocessing import Scene
from recognition.request import RecognitionRequest
from tests.service.conftest import ServedClient

SCHEMAS: dict[str, Any] = json.loads((Path(__file__).parents[3] / "service/openapi.json").read_text())["components"][
    "schemas"
]
DOCUMENTS: dict[type, str] = {
    client.CalibrationSummary: "CalibrationSummary",
    client.Camera: "CameraResource",
    client.Cell: "CellResource",
    client.CellWarning: "CellWarning",
    client.Chain: "ChainDocument",
    client.ChainMatch: "ChainMatchDocument",
    client.Changes: "ChangesDocument",
    client.Crossing: "CrossingDocument",
    client.CrossingElement: "CrossingElementDocument",
    client.EndElement: "EndElementDocument",
    client.Finding: "FindingDocument",
    client.Grasp: "ListedGrasp",
    client.GraspList: "GraspsDocument",
    client.GraspMotion: "GraspMotionDocument",
    client.GraspReach: "ReachDocument",
    client.HeightMap: "HeightMapDocument",
    client.Intervention: "InterventionResource",
    client.Model: "ModelDocument",
    client.PData: "PDataDocument",
    client.Problem: "Problem",
    client.Progress: "ScanProgress",
    client.Provenance: "ProvenanceDocument",
    client.Quality: "QualityDocument",
    client.Recording: "RecordingResource",
    client.RecordingLinks: "RecordingLinks",
    client.Robot: "RobotResource",
    client.Scan: "ScanResource",
    client.ScanLinks: "ScanLinks",
    client.ScanSummary: "ScanSummary",
    client.ScanTiming: "ScanTiming",
    client.ScanValidation: "ScanValidation",
    client.SegmentElement: "SegmentElementDocument",
    client.StrandPoint: "StrandPointDocument",
    client.Topology: "TopologyDocument",
    client.UnreachableViewpoint: "UnreachableViewpoint",
    client.ViewDurations: "ViewDurations",
    client.ViewProgress: "ViewProgress",
    client.ViewQuality: "ViewQualityDocument",
    client.Viewpoints: "ViewpointsResource",
    ScanList: "ScanList",
}
"""Schema of each dataclass of the client."""
MODEL_GRASP = "GraspDocument"
"""Schema of a grasp in a model, which has no reach."""


@pytest.mark.parametrize("kind", DOCUMENTS, ids=lambda kind: kind.__name__)
def test_a_dataclass_has_the_members_of_its_schema(kind: type) -> None:
    schema = SCHEMAS[DOCUMENTS[kind]]
    assert member_names(kind) == set(schema["properties"])
    hints = get_type_hints(kind, include_extras=True)
    for name, member in schema["properties"].items():
        assert_same_type(hints[name], member, f"{kind.__name__}.{name}")


def assert_same_type(hint: Any, member: Mapping[str, Any], where: str) -> None:
    """Assert that a type hint accepts what a JSON schema describes."""
    options = member.get("anyOf", [member])
    others = [option for option in options if option.get("type") != "null"]
    is_optional = len(others) < len(options)
    hints = [argument for argument in (get_args(hint) or [hint]) if argument is not NoneType]
    hints = hints if NoneType in get_args(hint) else [hint]
    assert NoneType in get_args(hint) or not is_optional, f"{where} may be null"
    if len(hints) > 1:
        for one, other in zip(hints, others, strict=True):
            assert_same_type(one, other, where)
        return
    (hint,) = hints
    if hint is Any or len(others) > 1 or "oneOf" in others[0]:
        return
    schema = others[0]
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        assert name == DOCUMENTS[hint] or (hint is client.Grasp and name == MODEL_GRASP), where
        return
    match schema["type"]:
        case "array":
            if get_origin(hint) is Annotated:
                return  # an array; documents of the service show its shape
            assert get_origin(hint) is tuple, where
            item = schema.get("items") or schema["prefixItems"][0]
            assert_same_type(get_args(hint)[0], item, where)
        case "object":
            assert get_origin(hint) is Mapping, where
        case name:
            assert hint is {"string": str, "integer": int, "number": float, "boolean": bool}[name], where


def test_a_grasp_in_a_model_has_all_members_but_the_reach() -> None:
    assert member_names(client.Grasp) - set(SCHEMAS[MODEL_GRASP]["properties"]) == {"reach"}


def test_each_dataclass_of_a_document_is_checked() -> None:
    exported = {getattr(client, name) for name in client.__all__}
    documents = {kind for kind in exported if is_dataclass(kind) and ".documents." in kind.__module__}
    assert documents - set(DOCUMENTS) == {client.OtherElement}


@pytest.fixture(scope="module")
def recognised() -> PointChainModel:
    """A model of a simulated scene with crossings, doubts and all grasps."""
    scene = make_scene("overhand-knot", 3)
    scan = simulate(scene, camera_model("ideal"), 3)
    model = recognise(
        scan.views,
        RecognitionRequest(radius_m=1.4 * scene.radius_m, all_grasps=True),
        Scene(workspace_m=scan.header.workspace_m),
    ).model
    assert model.quality.doubts
    assert model.grasps
    return model


@pytest.fixture(scope="module")
def document(recognised: PointChainModel) -> dict[str, Any]:
    return recognised.to_json() | {"provenance": vars(Provenance(scan="20260101t000000-000000-00000000"))}


def test_a_model_has_all_values_of_its_document(document: dict[str, Any]) -> None:
    model = Model.from_json(json.loads(json.dumps(document)))
    assert_equal(model, document, "model")
    assert model.document == document
    chain, grasp = model.chains[0], model.grasps[0]
    assert (chain.points.dtype, chain.points.shape) == (np.float64, (len(chain.views), 3))
    assert (chain.views.dtype, chain.sigma_m.shape) == (np.int64, chain.views.shape)
    assert (grasp.T_base_grasp.dtype, grasp.T_base_grasp.shape) == (np.float64, (4, 4))


def assert_equal(found: Any, expected: Any, where: str) -> None:
    """Assert that a decoded value is equal to the JSON value that it was decoded from."""
    if isinstance(found, np.ndarray):
        assert found.tolist() == expected, where
    elif is_dataclass(found):
        for entry in fields(found):
            if entry.name in expected:
                assert_equal(getattr(found, entry.name), expected[entry.name], f"{where}.{entry.name}")
            elif entry.name in member_names(type(found)):
                assert getattr(found, entry.name) in (None, ()), where
        assert set(expected) <= {entry.name for entry in fields(found)}, where
    elif isinstance(found, tuple):
        assert len(found) == len(expected), where
        for number, (a, b) in enumerate(zip(found, expected, strict=True)):
            assert_equal(a, b, f"{where}[{number}]")
    else:
        assert found == expected, where


def test_the_same_positions_are_trusted_as_in_recognition(
    recognised: PointChainModel, document: dict[str, Any]
) -> None:
    """The service computes trust from findings, and the client reads the result."""
    model = Model.from_json(document)
    for trusts in ([], [(0.05, 0.1)], [(0.0, 0.02), (0.3, 0.4)], [(0.1, 0.1), (0.2, 0.25)]):
        for closed in (False, True):
            findings = [
                {"code": "new", "severity": "doubt", "message": "", "chains": [0], "s_range_m": list(part)}
                for part in trusts
            ]
            changed = copy.deepcopy(document)
            changed["chains"][0]["closed"] = closed
            changed["quality"]["findings"] = findings
            expected = PointChainModel.from_json(changed)
            model = Model.from_json(expected.to_json())
            assert model.trusted(0) == expected.trusted(0)
            assert model.quality.verdict == expected.quality.verdict
            length = expected.chains[0].length_m
            for s in np.linspace(-0.0971, length + 0.0971, 200):
                assert model.trusted(0, s) == expected.trusted(0, s), (trusts, closed, s)
    assert not model.trusted(0, float("nan"))
    with pytest.raises(KeyError, match="no chain with the id 7"):
        model.trusted(7)
    assert recognised.trusted(0) == Model.from_json(document).trusted(0)


def test_members_and_values_of_a_newer_service_are_accepted(document: dict[str, Any]) -> None:
    newer: dict[str, Any] = copy.deepcopy(document) | {"colour": "red"}
    newer["chains"][0] |= {"trust": "perhaps", "ends": ["frayed", "free"], "mass_kg": 0.1}
    newer["quality"]["findings"][0] |= {"code": "new-code", "severity": "warning"}
    newer["topology"]["p_data"]["elements"][0] = {"id": 0, "kind": "knot", "chain": 0}
    model = Model.from_json(newer)
    assert model.chains[0].ends[0] == "frayed"
    assert not model.trusted(0)
    assert model.quality.findings[0] in model.quality.doubts
    assert model.topology.p_data.elements[0] == client.OtherElement(0, "knot")


def test_a_problem_keeps_its_further_members() -> None:
    errors = [{"where": "views", "message": "too few"}]
    document = {"type": "urn:pointchain:new", "title": "New", "status": 422, "detail": "new", "errors": errors}
    problem = decode(client.Problem, document)
    assert (problem.slug, problem.other, problem.parameters) == ("new", {"errors": errors}, {})


Change = Callable[[dict[str, Any]], object]
WRONG: dict[str, Change] = {
    "member chains[0].points must be an array of numbers of shape (N, 3)": lambda m: m["chains"][0]["points"][0].pop(),
    "chain 0 has": lambda m: m["chains"][0]["points"].pop(),
    "member chains[0].sigma_m must": lambda m: m["chains"][0]["sigma_m"].__setitem__(0, None),
    "member chains[0].views must be an array of integers": lambda m: m["chains"][0]["views"].__setitem__(0, 1.5),
    "member chains[0].radius_m must be a finite number, not inf": lambda m: m["chains"][0].update(
        radius_m=float("inf")
    ),
    "member chains[0].closed must be true or false, not 0": lambda m: m["chains"][0].update(closed=0),
    "member chains[0].ends must be an array of 2 items": lambda m: m["chains"][0].update(ends=["free"]),
    "member grasps[1].T_base_grasp is missing": lambda m: m["grasps"][1].pop("T_base_grasp"),
    "member crossings[0].over must be an object": lambda m: m["crossings"][0].update(over=3),
    "member frame must be base": lambda m: m.update(frame="camera"),
    "is of schema 'pointchain/1'; this version of the client reads 'pointchain/2'": lambda m: m.update(
        schema="pointchain/1"
    ),
    "is of schema 'pointchain/3'; this version of the client reads 'pointchain/2'": lambda m: m.update(
        schema="pointchain/3"
    ),
    "member schema is missing": lambda m: m.pop("schema"),
    "member grasps[1].sigma_m is missing": lambda m: m["grasps"][1].pop("sigma_m"),
    "refers to chains that it does not have: [9]": lambda m: m["grasps"][0].update(chain=9),
    "refers to crossings that it does not have: [99]": lambda m: m["quality"]["findings"][0].update(crossing=99),
    "member parameters.r_m must be a finite number, not 'thin'": lambda m: m["parameters"].update(r_m="thin"),
}
"""Changes that make a document no model, by the message."""


@pytest.mark.parametrize("message", WRONG)
def test_the_member_at_fault_is_named(document: dict[str, Any], message: str) -> None:
    wrong = copy.deepcopy(document)
    WRONG[message](wrong)
    with pytest.raises(ModelError, match=re.escape(message)):
        Model.from_json(wrong)


HEIGHTS = {"frame": "base", "x_m": 0.1, "y_m": -0.2, "cell_m": 0.002, "table_z_m": 0.0, "min_object_height_m": 0.0012}


@pytest.mark.parametrize("z_m", [[[0.001, None, 2], [None, 0, 0.5]], [[None, None]], [[0.1, 0.2]], [[1]]])
def test_null_in_a_height_map_is_nan(z_m: list[list[float | None]]) -> None:
    found = decode(client.HeightMap, HEIGHTS | {"z_m": z_m})
    expected = np.array([[np.nan if z is None else z for z in row] for row in z_m])
    np.testing.assert_array_equal(found.z_m, expected)
    assert found.z_m.dtype == np.float64


@pytest.mark.parametrize("z_m", [[[1, None], [2]], [[1, "2"], [None, 3]], [[None, float("inf")]], [[{}, None]], [None]])
def test_other_values_in_a_height_map_are_refused(z_m: list[Any]) -> None:
    with pytest.raises(DecodeError, match="member z_m must be an array of numbers of shape"):
        decode(client.HeightMap, HEIGHTS | {"z_m": z_m})


def test_null_elsewhere_is_refused() -> None:
    with pytest.raises(DecodeError, match=r"member q_grasp_rad must be an array of numbers of shape \(6,\)"):
        decode(client.GraspReach, {"reachable": True, "q_pregrasp_rad": None, "q_grasp_rad": [0, 0, None, 0, 0, 0]})


@pytest.mark.parametrize("wrong", [None, [], "model", 3])
def test_a_document_must_be_an_object(wrong: Any) -> None:
    with pytest.raises(ModelError, match="the document must be an object"):
        Model.from_json(wrong)
    with pytest.raises(DecodeError, match="the document must be an object"):
        decode(Scan, wrong)


def test_documents_of_a_real_service_are_read(served: ServedClient, scan: dict[str, Any]) -> None:
    assert_equal(decode(Scan, scan), scan, "scan")
    cell = served.get("/api/cell").json()
    assert_equal(decode(Cell, cell), cell, "cell")
    recordings = served.get("/api/recordings").json()["recordings"]
    assert_equal(decode(Recording, recordings[0]), recordings[0], "recording")
    model = served.get(scan["links"]["model"]).json()
    assert_equal(Model.from_json(model), model, "model")


@pytest.fixture
def served(client: ServedClient) -> ServedClient:
    return client
