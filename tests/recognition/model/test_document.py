"""A model that is written as JSON and read again is the same model. Documents that are not a model are refused."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.errors import ModelError
from recognition.model.document import ModelDocument
from recognition.model.findings import finding
from recognition.model.model import PointChainModel
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def model() -> PointChainModel:
    scan = simulate(make_scene("loop", 2901), camera_model("ideal-sr"), 2901)
    scene = Scene(scan.header.table_z_m or 0.0, scan.header.workspace_m)
    return recognise(scan.views, RecognitionRequest(radius_m=0.0042), scene).model


@pytest.fixture
def document(model: PointChainModel) -> dict[str, Any]:
    return json.loads(json.dumps(model.to_json()))


def test_a_document_gives_the_model_that_wrote_it(model: PointChainModel, document: dict[str, Any]) -> None:
    again = PointChainModel.from_json(document | {"member of a later version": 1})
    assert (len(again.chains), len(again.crossings)) == (len(model.chains), len(model.crossings)) == (1, 1)
    # Positions are written to a micrometre; rounding moves them by up to half of it.
    np.testing.assert_allclose(again.chains[0].points, model.chains[0].points, atol=5.1e-7)
    np.testing.assert_array_equal(again.chains[0].views, model.chains[0].views)
    np.testing.assert_allclose(again.crossings[0].point, model.crossings[0].point, atol=5.1e-7)
    np.testing.assert_allclose(again.grasps[0].T_base_grasp, model.grasps[0].T_base_grasp, atol=5.1e-7)
    assert again.parameters == model.parameters
    assert again.to_json() == document


def test_rounded_numbers_are_not_changed_by_reading(document: dict[str, Any]) -> None:
    assert ModelDocument.model_validate(document).model_dump(mode="json", by_alias=True) == document


def test_a_document_with_doubts_that_was_read_is_written_again(
    model: PointChainModel, document: dict[str, Any]
) -> None:
    # A doubt about the last end, as the assembly makes it, and one about the crossing.
    length = model.chains[0].length_m
    doubts = (
        finding("end-unobserved", "m", chains=(0,), end="last", s_range_m=(length - 0.021, length), value=1 / 3),
        finding("crossing-undecided", "m", chains=(0,), crossing=0, point=model.crossings[0].point),
    )
    for findings in ((), doubts, (finding("sharp-bend", "m", chains=(0,)),)):
        first = replace(model, quality=replace(model.quality, findings=findings)).to_json()
        read_again = PointChainModel.from_json(json.loads(json.dumps(first)))
        assert read_again.to_json() == first
        last = read_again.chains[0].length_m
        assert read_again.trusted(0, last) == (findings == ())
    assert document["quality"]["verdict"] == model.quality.verdict


def test_a_finding_of_a_later_version_counts_by_its_severity(document: dict[str, Any]) -> None:
    new = {"code": "new-code", "message": "m", "chains": [0]}
    for severity, verdict in (("note", "accept"), ("doubt", "review"), ("blocking", "refuse")):
        quality = document["quality"] | {"findings": [new | {"severity": severity}]}
        model = PointChainModel.from_json(document | {"quality": quality})
        assert model.chain_trust(0).verdict == verdict
    quality = document["quality"] | {"findings": [new | {"severity": "worse"}]}
    with pytest.raises(ModelError, match=r"quality\.findings\.0\.severity"):
        PointChainModel.from_json(document | {"quality": quality})


def test_findings_on_unknown_chains_and_crossings_are_refused(document: dict[str, Any]) -> None:
    for member, message in (({"chains": [4]}, r"chains that .* \[4\]"), ({"crossing": 4}, r"crossings that .* \[4\]")):
        found = {"code": "crossing-undecided", "severity": "doubt", "message": "m"} | member
        quality = document["quality"] | {"findings": [found]}
        with pytest.raises(ModelError, match=message):
            PointChainModel.from_json(document | {"quality": quality})


def test_a_document_that_contradicts_itself_is_refused(document: dict[str, Any]) -> None:
    with pytest.raises(ModelError, match=r"does not have: \[0\]"):
        PointChainModel.from_json(document | {"chains": []})
    document["chains"][0]["sigma_m"].pop()
    with pytest.raises(ModelError, match="the numbers must be equal"):
        PointChainModel.from_json(document)


@pytest.mark.parametrize("schema", ["pointchain/1", "pointchain/3"])
def test_a_document_of_another_schema_is_refused(document: dict[str, Any], schema: str) -> None:
    with pytest.raises(ModelError, match=f"is of schema '{schema}'; this version of Pointchain reads 'pointchain/2'"):
        PointChainModel.from_json(document | {"schema": schema})


def test_a_document_that_is_not_a_model_is_refused(document: dict[str, Any]) -> None:
    with pytest.raises(ModelError, match="not a point chain model: schema: Field required"):
        PointChainModel.from_json({name: value for name, value in document.items() if name != "schema"})
    grasp = {name: value for name, value in document["grasps"][0].items() if name != "sigma_m"}
    with pytest.raises(ModelError, match=r"grasps\.0\.sigma_m: Field required"):
        PointChainModel.from_json(document | {"grasps": [grasp]})
    chain = document["chains"][0]
    with pytest.raises(ModelError, match=r"chains\.0\.sigma_m\.0: .*finite"):
        PointChainModel.from_json(document | {"chains": [chain | {"sigma_m": [float("nan"), *chain["sigma_m"][1:]]}]})
    with pytest.raises(ModelError, match=r"parameters: .*missing"):
        PointChainModel.from_json(document | {"parameters": {"r_m": 0.0042}})
    with pytest.raises(ModelError, match="0 < z_t"):
        PointChainModel.from_json(document | {"parameters": document["parameters"] | {"z_t_m": 0.1}})


def test_a_model_with_a_number_that_is_not_finite_is_not_written(model: PointChainModel) -> None:
    chain = replace(model.chains[0], sigma_m=np.full_like(model.chains[0].sigma_m, np.nan))
    with pytest.raises(ValueError, match="finite"):
        replace(model, chains=(chain,)).to_json()
