"""Documents of schema `pointchain/1`: conversion, doubts in place of messages, and broken documents."""

import copy
import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from recognition.errors import ModelError
from recognition.model.model import PointChainModel
from recognition.model.schema_1 import REASON, convert
from recognition.parameters import ChainParameters

Document = dict[str, Any]
MESSAGES = ("crossing 0 is not certain", "excluded a piece of 12 mm")
"""An ambiguity and a warning."""


def document(ambiguities: tuple[str, ...] = MESSAGES[:1], warnings: tuple[str, ...] = MESSAGES[1:]) -> Document:
    """Return a loop with one crossing, as it was written in the schema `pointchain/1`."""
    points = [
        [0.0, 0.0, 0.0042],
        [0.06, 0.0, 0.0042],
        [0.06, 0.04, 0.0042],
        [0.03, 0.04, 0.0126],
        [0.03, -0.04, 0.0126],
    ]
    s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]).round(6).tolist()
    over_m = round(s[3] + 0.04, 6)
    under, over = {"chain": 0, "s_m": 0.03}, {"chain": 0, "s_m": over_m}
    parameters = ChainParameters.for_radius(0.0042)
    return {
        "schema": "pointchain/1",
        "frame": "base",
        "method": "graph",
        "parameters": {
            "r_m": parameters.r, "z_t_m": parameters.z_t, "r_c_m": parameters.r_c, "r_s_m": parameters.r_s,
            "rho_t": parameters.rho_t, "R_t": parameters.R_t, "r_n_m": parameters.r_n, "r_f_m": parameters.r_f,
            "r_cn_m": parameters.r_cn, "r_cf_m": parameters.r_cf,
        },
        "chains": [
            {
                "id": 0, "closed": False, "radius_m": 0.0042, "length_m": s[-1], "points": points, "arc_length_m": s,
                "sigma_m": [0.0002] * 5, "views": [6, 6, 6, 6, 0], "ends": ["free", "unseen"],
            }
        ],
        "crossings": [
            {
                "id": 0, "point": [0.03, 0.0, 0.0084], "over": over, "under": under,
                "gap_m": 0.0084, "angle_rad": 1.5708, "sign": 1, "confidence": 0.98,
            }
        ],
        "topology": {
            "gauss_code": [[[0, "under", 1], [0, "over", 1]]],
            "p_data": {
                "elements": [
                    {"id": 0, "kind": "end", "chain": 0, "which": "first", "s_m": 0.0, "end": "free"},
                    {"id": 1, "kind": "end", "chain": 0, "which": "last", "s_m": s[-1], "end": "unseen"},
                    {"id": 2, "kind": "crossing", "crossing": 0, "sign": 1, "over": over, "under": under},
                    {"id": 3, "kind": "segment", "chain": 0, "s_m": [0.0, 0.03]},
                    {"id": 4, "kind": "segment", "chain": 0, "s_m": [0.03, over_m]},
                    {"id": 5, "kind": "segment", "chain": 0, "s_m": [over_m, s[-1]]},
                ],
                "matrix": [
                    [0, 0, 0, 2, 0, 0], [0, 0, 0, 0, 0, 0], [0, 0, 0, 0, -1, 1],
                    [0, 0, -1, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 2, 0, 0, 0, 0],
                ],
            },
        },
        "grasps": [
            {
                "chain": 0, "s_m": 0.045,
                "T_base_grasp": [[0, 1, 0, 0.045], [1, 0, 0, 0], [0, 0, -1, 0.0042], [0, 0, 0, 1]],
                "opening_m": 0.0124, "reach_m": 0.0032, "clearance_m": 0.03, "table_clearance_m": 0.001, "score": 0.9,
            }
        ],
        "quality": {
            "views": [
                {"index": 0, "used": True, "reason": None, "points": 5213, "fitness": 0.97, "rms_m": 0.0003,
                 "correction_m": 0.0008, "correction_rad": 0.002},
                {"index": 1, "used": False, "reason": "no pixel has a depth", "points": 0, "fitness": None,
                 "rms_m": None, "correction_m": None, "correction_rad": None},
            ],
            "ambiguities": list(ambiguities),
            "warnings": list(warnings),
        },
        "timing_s": {"preprocess": 0.05},
    }  # fmt: skip


def test_the_lines_crossings_and_grasps_are_read() -> None:
    given_document = document()
    before = copy.deepcopy(given_document)
    model = PointChainModel.from_json(given_document)
    assert given_document == before, "the given document is not changed"
    (chain,), (crossing,), (grasp,) = model.chains, model.crossings, model.grasps
    np.testing.assert_array_equal(chain.points, before["chains"][0]["points"])
    np.testing.assert_array_equal(chain.views, before["chains"][0]["views"])
    assert (crossing.under.s_m, crossing.sign, crossing.confidence) == (0.03, 1, 0.98)
    np.testing.assert_array_equal(grasp.T_base_grasp, before["grasps"][0]["T_base_grasp"])
    assert model.parameters == ChainParameters.for_radius(0.0042)
    assert model.timing_s == {"preprocess": 0.05}


def test_an_unseen_end_is_unobserved() -> None:
    model = PointChainModel.from_json(document())
    assert model.chains[0].ends == ("free", "unobserved")
    written = model.to_json()
    assert written["chains"][0]["ends"] == ["free", "unobserved"]
    assert [element["end"] for element in written["topology"]["p_data"]["elements"][:2]] == ["free", "unobserved"]
    converted = convert(document())
    assert converted["topology"] == written["topology"], "the conversion needs no recomputed topology"


def test_each_message_is_a_doubt_about_all_chains() -> None:
    given_document = document()
    given_document["chains"].append(given_document["chains"][0] | {"id": 3})
    model = PointChainModel.from_json(given_document)
    assert [(found.code, found.severity) for found in model.quality.findings] == [("pointchain-1", "doubt")] * 3
    assert tuple(found.message for found in model.quality.findings) == (REASON, *MESSAGES)
    assert [found.chains for found in model.quality.findings] == [(0, 3)] * 3
    assert model.quality.verdict == "review"
    for chain in (0, 3):
        assert (model.chain_trust(chain).verdict, model.chain_trust(chain).trusted_m) == ("review", ())
    assert model.crossing_verdict(0) == "review"
    assert not model.grasps[0].trusted
    assert not model.trusted(0, model.grasps[0].s_m)


def test_a_model_without_messages_is_reviewed_because_fewer_checks_were_made() -> None:
    model = PointChainModel.from_json(document((), ()))
    (found,) = model.quality.findings
    assert (found.message, found.chains) == (REASON, (0,))
    assert (model.quality.verdict, model.chain_trust(0).verdict, model.crossing_verdict(0)) == ("review",) * 3
    assert not model.grasps[0].trusted


@pytest.mark.parametrize("messages", [((), ()), (MESSAGES, ()), ((), MESSAGES)])
def test_the_converted_members_agree_with_the_rules(messages: tuple[tuple[str, ...], tuple[str, ...]]) -> None:
    """The conversion alone, which the comparison of models uses, gives what reading and writing gives."""
    converted = json.loads(json.dumps(convert(document(*messages))))
    written = PointChainModel.from_json(document(*messages)).to_json()
    for findings in (converted["quality"]["findings"], written["quality"]["findings"]):
        assert [found["message"] for found in findings] == [REASON, *messages[0], *messages[1]]
    # The length of the document is rounded, and the sum of the rounded links is not: 1 micrometre a link.
    assert converted.pop("timing_s") == written.pop("timing_s")
    for converted_chain, written_chain in zip(converted.pop("chains"), written.pop("chains"), strict=True):
        assert converted_chain.pop("trusted_m") == written_chain.pop("trusted_m") == []
        np.testing.assert_allclose(converted_chain.pop("length_m"), written_chain.pop("length_m"), atol=5e-6)
        assert converted_chain == written_chain
    for converted_grasp, written_grasp in zip(converted.pop("grasps"), written.pop("grasps"), strict=True):
        assert {name: written_grasp[name] for name in converted_grasp} == converted_grasp
    assert converted == written


def test_views_have_no_code() -> None:
    views = PointChainModel.from_json(document()).quality.views
    assert [(view.used, view.code) for view in views] == [(True, None), (False, None)]
    assert views[1].reason == "no pixel has a depth"


def test_no_string_is_a_valid_model() -> None:
    empty = document((), ("no string in view",)) | {"chains": [], "crossings": [], "grasps": []}
    empty["topology"] = {"gauss_code": [], "p_data": {"elements": [], "matrix": []}}
    model = PointChainModel.from_json(empty)
    assert model.chains == ()
    assert [(found.chains, found.message) for found in model.quality.findings] == [
        ((), REASON),
        ((), "no string in view"),
    ]


def test_an_error_document_is_no_model_and_is_converted_unchanged() -> None:
    error = {"schema": "pointchain/1", "error": {"slug": "no-depth", "detail": "no view measured anything"}}
    assert convert(error) == error
    with pytest.raises(ModelError, match="not a point chain model"):
        PointChainModel.from_json(error)


@pytest.mark.parametrize("broken", [None, [], "pointchain/1", 1, {}, {"schema": "pointchain/1"}, {"schema": None}])
def test_what_is_no_document_is_a_model_error(broken: Any) -> None:
    with pytest.raises(ModelError):
        PointChainModel.from_json(broken)


def test_a_missing_member_is_named() -> None:
    broken = document()
    del broken["quality"]["warnings"]
    with pytest.raises(ModelError, match="'warnings' is missing"):
        PointChainModel.from_json(broken)
    with pytest.raises(ModelError, match="'ambiguities' must be a list"):
        convert(document() | {"quality": {"views": [], "warnings": [], "ambiguities": "not certain"}})


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all members and elements of a document."""
    if path:
        yield path
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, member in members:
        yield from places(member, (*path, key))


PLACES = tuple(places(document()))
ODD_VALUES: tuple[Any, ...] = (
    None, True, -1, 10**30, 0.5, float("nan"), float("inf"), "", "x", [], [None], [[]], {}, {"id": 0}, [{}],
)  # fmt: skip


def changed(path: tuple[Any, ...], change: Callable[[Any, Any], None]) -> Document:
    """Return the document after `change(container, key)` at a path."""
    broken = document()
    container: Any = broken
    for key in path[:-1]:
        container = container[key]
    change(container, path[-1])
    return broken


def read(broken: Document) -> PointChainModel | None:
    """Return the model of a document, which must be written again, or None if it is refused with a ModelError."""
    try:
        return PointChainModel.from_json(broken)
    except ModelError:
        return None


@pytest.mark.parametrize("path", [path for path in PLACES if isinstance(path[-1], str)], ids=str)
def test_a_document_without_one_of_its_members_is_refused(path: tuple[Any, ...]) -> None:
    model = read(changed(path, lambda container, key: container.pop(key)))
    # A duration may be absent. Without the schema, the document is none of either version.
    assert (model is not None) == (path == ("timing_s", "preprocess"))


@pytest.mark.parametrize("value", ODD_VALUES, ids=repr)
def test_a_document_with_an_odd_value_anywhere_is_a_model_or_a_model_error(value: Any) -> None:
    def put(container: Any, key: Any) -> None:
        container[key] = value

    models = [read(changed(path, put)) for path in PLACES]
    # Most values are refused in most places.
    assert {model.quality.verdict for model in models if model is not None} <= {"review"}
    assert models.count(None) > len(PLACES) / 4
