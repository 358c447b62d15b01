"""The JSON document of the model has the keys of the contract and the values of the arrays. Broken ones are refused."""

import copy
import json
import math
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from recognition.errors import ModelError
from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.findings import finding
from recognition.model.grasps import Grasp, GraspMotion
from recognition.model.model import METHODS, PointChainModel
from recognition.model.quality import Quality, ViewQuality
from recognition.parameters import ChainParameters

T_BASE_GRASP = np.array([(0.6, -0.8, 0, 0.1), (-0.8, -0.6, 0, -0.2), (0, 0, -1, 1 / 3), (0, 0, 0, 1)])
SQUARE = np.array([(0, 0, 0), (0.03, 0, 0), (0.03, 0.04, 0), (0, 0.04, 0)])
GRASP = Grasp(
    1, 0.02, T_BASE_GRASP, 0.0124, 0.0032, 0.03, 0.001, 2 / 3, trusted=False,
    id=0, cluster=0, sigma_m=0.0003, end_distance_m=0.02, over_distance_m=0.03, under_distance_m=None,
    chains_above=(0,), object_above_m=None, T_base_flange=GraspMotion(T_BASE_GRASP, T_BASE_GRASP, T_BASE_GRASP),
)  # fmt: skip


def chain(number: int, points: np.ndarray, closed: bool = False) -> Chain:
    count = len(points)
    return Chain(
        number, closed, 0.0042, points, np.full(count, 0.0003), np.arange(count, dtype=np.int64), ("free", "unobserved")
    )


def crossing(number: int, over: tuple[int, float], under: tuple[int, float], sign: int) -> Crossing:
    point = np.array([0.1, -0.2, 1 / 3])
    return Crossing(number, point, StrandPoint(*over), StrandPoint(*under), 0.0083, 1.1, sign, 0.98)


def test_a_model_is_read_without_scipy() -> None:
    """Programs that only read models start half a second earlier."""
    program = (
        "import sys; from recognition.model import PointChainModel; PointChainModel.from_json; "
        "print([name for name in ('scipy', 'open3d', 'pydantic') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.fixture(scope="module")
def model(table_1: ChainParameters) -> PointChainModel:
    """Two chains: the first crosses itself and lies under the second."""
    views = (
        ViewQuality(0, True, None, 5213, 0.97, 0.0003, 0.0008, 0.002),
        ViewQuality(1, False, "no pixel has a depth", 0, code="view-without-depth"),
    )
    findings = (
        finding("crossing-undecided", "not certain", chains=(0, 1), crossing=1, value=0.55, limit=0.9),
        finding("view-without-depth", "excluded", view=1),
    )
    return PointChainModel(
        "enhanced",
        table_1,
        (chain(0, SQUARE), chain(1, SQUARE + 0.01)),
        (crossing(0, (0, 0.09), (0, 0.02), 1), crossing(1, (1, 0.05), (0, 0.04), -1)),
        Quality(views, findings),
        {"preprocess": 0.05123456789},
        grasps=(GRASP,),
    )


def test_the_document_has_the_keys_of_the_contract_and_no_others(model: PointChainModel) -> None:
    document = model.to_json()
    assert set(document) == {
        "schema", "frame", "method", "parameters", "chains", "crossings", "topology", "grasps", "quality",
        "timing_s",
    }  # fmt: skip
    assert (document["schema"], document["frame"], document["method"]) == ("pointchain/2", "base", "enhanced")
    for entry in document["chains"]:
        assert set(entry) == {
            "id", "closed", "radius_m", "length_m", "points", "arc_length_m", "sigma_m", "views", "ends",
            "trust", "trusted_m",
        }  # fmt: skip
    for entry in document["crossings"]:
        assert set(entry) == {
            "id", "point", "over", "under", "gap_m", "angle_rad", "sign", "confidence", "trust"
        }  # fmt: skip
        assert set(entry["over"]) == set(entry["under"]) == {"chain", "s_m"}
    assert set(document["quality"]) == {"verdict", "findings", "views"}
    for entry in document["quality"]["views"]:
        assert set(entry) == {
            "index", "used", "reason", "code", "points", "fitness", "rms_m", "correction_m", "correction_rad"
        }  # fmt: skip
    assert set(document["topology"]) == {"gauss_code", "p_data"}
    assert set(document["topology"]["p_data"]) == {"elements", "matrix"}
    for entry in document["grasps"]:
        assert set(entry) == {
            "id", "cluster", "chain", "s_m", "T_base_grasp", "opening_m", "reach_m", "clearance_m", "table_clearance_m",
            "score", "trusted", "sigma_m", "end_distance_m", "over_distance_m", "under_distance_m", "chains_above",
            "object_above_m", "T_base_flange",
        }  # fmt: skip


def test_parameters_carry_their_units(model: PointChainModel, table_1: ChainParameters) -> None:
    assert model.to_json()["parameters"] == {
        "r_m": table_1.r,
        "z_t_m": table_1.z_t,
        "r_c_m": table_1.r_c,
        "r_s_m": table_1.r_s,
        "rho_t": table_1.rho_t,
        "R_t": table_1.R_t,
        "r_n_m": table_1.r_n,
        "r_f_m": table_1.r_f,
        "r_cn_m": table_1.r_cn,
        "r_cf_m": table_1.r_cf,
    }


def numbers(value: Any) -> list[float]:
    if isinstance(value, dict):
        return [n for entry in value.values() for n in numbers(entry)]
    if isinstance(value, list | tuple):
        return [n for entry in value for n in numbers(entry)]
    return [value] if isinstance(value, int | float) else []


def test_the_document_is_plain_json_of_finite_numbers_to_a_micrometre(model: PointChainModel) -> None:
    document = model.to_json()
    again = json.loads(json.dumps(document, allow_nan=False))
    assert all(map(math.isfinite, numbers(again)))
    assert again["crossings"][0]["point"] == [0.1, -0.2, 0.333333]
    assert again["grasps"][0]["T_base_grasp"] == [
        [0.6, -0.8, 0, 0.1],
        [-0.8, -0.6, 0, -0.2],
        [0, 0, -1, 0.333333],
        [0, 0, 0, 1],
    ]
    assert again["grasps"][0]["score"] == 0.6667
    assert again["timing_s"] == {"preprocess": 0.051235}
    assert again["chains"][0]["points"] == SQUARE.tolist()
    assert again["chains"][0]["arc_length_m"] == [0.0, 0.03, 0.07, 0.1]
    assert again["chains"][0]["views"] == [0, 1, 2, 3]
    assert again["chains"][0]["ends"] == ["free", "unobserved"]
    assert again["quality"]["views"][1]["reason"] == "no pixel has a depth"
    assert again["quality"]["views"][1]["code"] == "view-without-depth"
    assert again["quality"]["views"][1]["rms_m"] is None
    assert again["quality"]["views"][0]["code"] is None


def test_findings_have_only_the_members_that_apply(model: PointChainModel) -> None:
    assert model.to_json()["quality"]["findings"] == [
        {
            "code": "crossing-undecided", "severity": "doubt", "message": "not certain", "chains": [0, 1],
            "crossing": 1, "value": 0.55, "limit": 0.9,
        },
        {"code": "view-without-depth", "severity": "note", "message": "excluded", "view": 1},
    ]  # fmt: skip


def test_the_document_has_the_verdicts_and_the_trusted_parts(model: PointChainModel) -> None:
    document = model.to_json()
    assert document["quality"]["verdict"] == model.quality.verdict == "review"
    assert [x["trust"] for x in document["crossings"]] == ["accept", "review"]
    assert [entry["trust"] for entry in document["chains"]] == ["review", "review"]
    # Three radii of 4.2 mm on both sides of the crossing: at 0.04 m on chain 0, and at 0.05 m on chain 1.
    assert document["chains"][0]["trusted_m"] == [[0.0, 0.0274], [0.0526, 0.1]]
    assert document["chains"][1]["trusted_m"] == [[0.0, 0.0374], [0.0626, 0.1]]
    assert document["grasps"][0]["trusted"] is False
    certain = replace(model, quality=replace(model.quality, findings=model.quality.findings[1:])).to_json()
    assert certain["quality"]["verdict"] == "accept"
    assert [entry["trust"] for entry in certain["chains"] + certain["crossings"]] == ["accept"] * 4
    assert [entry["trusted_m"] for entry in certain["chains"]] == [[[0.0, 0.1]]] * 2


def test_trusted_parts_are_written_to_a_micrometre_and_without_negative_zeros(table_1: ChainParameters) -> None:
    third = np.linspace((-1e-9, -0.0, 0.0042), (1 / 3, -0.0, 0.0042), 40)
    findings = [
        finding("connection-uncertain", "doubt", chains=(0,), s_range_m=span) for span in ((-0.0, 1 / 30), (0.1, 1 / 7))
    ]
    document = PointChainModel(
        "graph", table_1, (chain(0, third),), quality=Quality(findings=tuple(findings))
    ).to_json()
    assert document["chains"][0]["trusted_m"] == [[0.033333, 0.1], [0.142857, 0.333333]]
    assert re.search(r"-0\.0(?!\d)", json.dumps(document)) is None


def test_a_refused_model_has_no_trusted_part(model: PointChainModel) -> None:
    refused = replace(model, quality=Quality(findings=(finding("sharp-bend", "the whole model"),))).to_json()
    assert refused["quality"]["verdict"] == "refuse"
    assert [entry["trust"] for entry in refused["chains"] + refused["crossings"]] == ["refuse"] * 4
    assert [entry["trusted_m"] for entry in refused["chains"]] == [[], []]


def test_the_gauss_code_lists_each_chains_crossings_in_order(model: PointChainModel) -> None:
    expected = [[[0, "under", 1], [1, "under", -1], [0, "over", 1]], [[1, "over", -1]]]
    assert model.gauss_code() == expected
    assert model.to_json()["topology"]["gauss_code"] == expected


def test_a_chain_without_crossings_has_an_empty_code(table_1: ChainParameters) -> None:
    assert PointChainModel("matching", table_1, (chain(0, SQUARE),)).gauss_code() == [[]]


def test_no_string_is_a_valid_model(table_1: ChainParameters) -> None:
    document = PointChainModel(
        "enhanced", table_1, quality=Quality(findings=(finding("no-string-found", "none"),))
    ).to_json()
    assert (document["chains"], document["crossings"], document["grasps"]) == ([], [], [])
    assert document["topology"] == {"gauss_code": [], "p_data": {"elements": [], "matrix": []}}
    assert document["quality"]["verdict"] == "accept"
    json.dumps(document, allow_nan=False)


def test_lengths_by_hand() -> None:
    assert chain(0, SQUARE).length_m == pytest.approx(0.1, abs=1e-15)
    # Including the link from the last point to the first.
    assert chain(0, SQUARE, closed=True).length_m == pytest.approx(0.14, abs=1e-15)


def test_methods_are_the_papers_two_and_ours() -> None:
    assert METHODS == ("matching", "enhanced", "graph")


def paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all members and elements of a document."""
    if path:
        yield path
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, member in members:
        yield from paths(member, (*path, key))


def changed(document: dict[str, Any], path: tuple[Any, ...], change: Callable[[Any, Any], None]) -> dict[str, Any]:
    """Return the document after `change(container, key)` at a path."""
    broken: dict[str, Any] = copy.deepcopy(document)
    container: Any = broken
    for key in path[:-1]:
        container = container[key]
    change(container, path[-1])
    return broken


def read(broken: dict[str, Any]) -> PointChainModel | None:
    """Return the model of a document, or None if it is refused with a ModelError."""
    try:
        return PointChainModel.from_json(broken)
    except ModelError:
        return None


@pytest.mark.parametrize("broken", [None, [], "pointchain/2", 1, {}, {"schema": "pointchain/2"}, {"schema": None}])
def test_a_value_that_is_not_a_document_is_refused(broken: Any) -> None:
    with pytest.raises(ModelError):
        PointChainModel.from_json(broken)


def test_a_document_without_one_of_its_members_is_refused(model: PointChainModel) -> None:
    document = model.to_json()
    optional = {("timing_s", "preprocess")}
    optional |= {("quality", "findings", 0, name) for name in ("chains", "crossing", "value", "limit")}
    optional |= {("quality", "findings", 1, "view")}
    members = [path for path in paths(document) if isinstance(path[-1], str)]
    without = {path: changed(document, path, lambda container, key: container.pop(key)) for path in members}
    assert {path for path in members if read(without[path]) is not None} == optional


ODD_VALUES: tuple[Any, ...] = (
    None, True, -1, 10**30, 0.5, float("nan"), float("inf"), "", "x", [], [None], [[]], {}, {"id": 0}, [{}],
)  # fmt: skip


@pytest.mark.parametrize("value", ODD_VALUES, ids=repr)
def test_a_document_with_an_odd_value_anywhere_is_a_model_or_a_model_error(model: PointChainModel, value: Any) -> None:
    document = model.to_json()

    def put(container: Any, key: Any) -> None:
        container[key] = value

    models = [read(changed(document, path, put)) for path in paths(document)]
    # Most values are refused in most positions.
    assert models.count(None) > len(models) / 4
