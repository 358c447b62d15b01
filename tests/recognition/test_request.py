"""The request for a recognition: which radius is used, what is refused, and its JSON document."""

import json
from dataclasses import replace
from typing import Any

import pytest

from recognition.errors import InvalidParametersError
from recognition.grasping.gripper import Gripper
from recognition.parameters import ChainParameters
from recognition.request import RecognitionRequest


def test_a_requested_radius_takes_precedence_over_the_recorded_one() -> None:
    assert RecognitionRequest(radius_m=0.003).or_radius(0.0042).radius_m == 0.003
    assert RecognitionRequest().or_radius(0.0042).radius_m == 0.0042


def test_an_unknown_radius_is_left_to_be_measured() -> None:
    assert RecognitionRequest().or_radius(None).radius_m is None


@pytest.mark.parametrize(("requested", "recorded"), [(-1.0, 0.0042), (4.2, None), (None, 0.1), (0.0, None)])
def test_an_impossible_radius_is_refused(requested: float | None, recorded: float | None) -> None:
    with pytest.raises(InvalidParametersError):
        RecognitionRequest(radius_m=requested).or_radius(recorded)


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (RecognitionRequest("grpah"), "there is no method 'grpah'"),  # type: ignore[arg-type]  # the name is refused
        (RecognitionRequest("graph", settings={"r_c": 0.004}), "does not use r_c"),
        (RecognitionRequest(radius_m=4.2), "metres, not mm"),
        (RecognitionRequest(radius_m=0.0042, settings={"r_n": 0.02}), "the parameters break r_n < r_f"),
        (RecognitionRequest(settings=None), "settings is None"),  # type: ignore[arg-type]  # of another type
        (RecognitionRequest(gripper=None), "a Gripper is needed"),  # type: ignore[arg-type]  # of another type
        (RecognitionRequest(all_grasps="false"), "True or False is needed"),  # type: ignore[arg-type]  # another type
    ],
)
def test_what_recognition_refuses_is_refused_before_it_begins(request_: RecognitionRequest, message: str) -> None:
    with pytest.raises(InvalidParametersError, match=message):
        request_.check()


def test_settings_replace_the_values_for_any_radius() -> None:
    request = RecognitionRequest(settings={"z_t": 0.004})
    for radius_m in (0.003, 0.0042):
        assert request.parameters_for(radius_m) == replace(ChainParameters.for_radius(radius_m), z_t=0.004)


def test_the_document_names_what_is_set() -> None:
    plain = RecognitionRequest().to_json()
    assert set(plain) == {"method", "radius_m", "gripper"}
    assert plain["gripper"] == json.loads(json.dumps(vars(Gripper()), default=vars))
    full = RecognitionRequest("enhanced", 0.003, {"r_cn": 0.015}, Gripper(stroke_m=0.05), all_grasps=True).to_json()
    assert (full["method"], full["radius_m"], full["settings"]) == ("enhanced", 0.003, {"r_cn": 0.015})
    assert (full["gripper"]["stroke_m"], full["all_grasps"]) == (0.05, True)


def test_a_request_is_read_as_it_was_written() -> None:
    full = RecognitionRequest("enhanced", 0.003, {"r_cn": 0.01}, Gripper(stroke_m=0.05), all_grasps=True)
    for request in (RecognitionRequest(), full):
        assert RecognitionRequest.from_json(json.loads(json.dumps(request.to_json()))) == request


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({"radius": 0.0042}, "no member 'radius'; its members are method, radius_m, settings, gripper, all_grasps"),
        ({"method": "grpah"}, "cannot have method 'grpah'"),
        ({"gripper": {"stroke_m": "wide"}}, "cannot have gripper.stroke_m 'wide'"),
    ],
)
def test_a_document_that_is_no_request_is_refused(document: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidParametersError, match=message):
        RecognitionRequest.from_json(document)


@pytest.mark.parametrize("radius_m", [float("nan"), float("inf")])
def test_a_radius_that_is_no_json_number_becomes_text(radius_m: float) -> None:
    request = RecognitionRequest(radius_m=radius_m, settings={"r_n": radius_m})
    document = json.loads(json.dumps(request.to_json(), allow_nan=False))
    assert (document["radius_m"], document["settings"]) == (str(radius_m), {"r_n": str(radius_m)})
    with pytest.raises(InvalidParametersError):
        request.check()
