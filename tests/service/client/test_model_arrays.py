"""A model that went through JSON is the same model."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recognition.model.model import PointChainModel
from service.client.model_arrays import ModelError, model_from_json
from service.workflow import recognise_recording


@pytest.fixture(scope="module")
def model(recording_file: Path) -> PointChainModel:
    return recognise_recording(recording_file).model


@pytest.fixture
def document(model: PointChainModel) -> dict[str, Any]:
    return json.loads(json.dumps(model.to_json()))


def test_a_document_comes_back_as_the_model_that_wrote_it(model: PointChainModel, document: dict[str, Any]) -> None:
    again = model_from_json(document | {"of a later version": 1})
    assert len(again.chains) == len(model.chains) == 1
    # Places are written to a micrometre, and lengths follow from them.
    np.testing.assert_allclose(again.chains[0].points, model.chains[0].points, atol=5.1e-7)
    np.testing.assert_array_equal(again.chains[0].views, model.chains[0].views)
    np.testing.assert_allclose(again.grasps[0].T_base_grasp, model.grasps[0].T_base_grasp, atol=5.1e-7)
    assert again.parameters == model.parameters
    assert again.quality == model.quality
    assert again.to_json()["chains"][0]["points"] == document["chains"][0]["points"]
    assert again.to_json()["topology"] == document["topology"]


def test_a_document_that_contradicts_itself_is_refused(document: dict[str, Any]) -> None:
    document["chains"][0]["sigma_m"].pop()
    with pytest.raises(ModelError, match="as many of each"):
        model_from_json(document)


def test_what_is_no_model_is_refused(document: dict[str, Any]) -> None:
    with pytest.raises(ModelError, match="not a point chain model"):
        model_from_json({"schema": "pointchain/2"})
    chain = document["chains"][0]
    with pytest.raises(ModelError, match="not finite"):
        model_from_json(document | {"chains": [chain | {"sigma_m": [float("nan"), *chain["sigma_m"][1:]]}]})
    with pytest.raises(ModelError, match=r"does not have: \[0\]"):
        model_from_json(document | {"chains": []})
    with pytest.raises(ModelError, match="parameters"):
        model_from_json(document | {"parameters": {"r_m": 0.0042}})
