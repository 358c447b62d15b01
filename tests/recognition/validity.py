"""Conditions that every answer of recognition meets."""

import json
from collections.abc import Sequence
from typing import cast

import numpy as np

from recognition.errors import RecognitionError
from recognition.model.chains import Chain, StrandPoint
from recognition.model.finding_types import FINDING_TYPES, FindingCode
from recognition.model.findings import SEVERITIES, Finding
from recognition.model.grasps import Grasp
from recognition.model.model import PointChainModel
from recognition.pipeline import recognise
from recognition.stage_timer import stages_of
from tests.recognition.invariants import gauss_code_of
from tests.recognition.odd_scans import Case

ADVICE = ("check", "give", "needed", "must", "no model is made")
"""Every error message has one of these words: it says what to do or what is needed."""


def check(case: Case) -> PointChainModel | RecognitionError:
    """Return the answer to `case` after checking that it is a valid model, or an error that says what to do."""
    try:
        model = recognise(case.views, case.request, case.scene).model
    except RecognitionError as error:
        assert_helpful(error)
        return error
    assert_valid(model, case)
    return model


def assert_helpful(error: RecognitionError) -> None:
    words = str(error).lower()
    assert type(error).slug != RecognitionError.slug, "a refusal of no kind"
    assert any(word in words for word in ADVICE), f"{type(error).__name__} does not say what to do: {words}"
    assert not {"nan", "inf"} & set(words.split())


def assert_valid(model: PointChainModel, case: Case) -> None:
    document = model.to_json()
    json.dumps(document, allow_nan=False)
    assert model.method == case.request.method
    assert set(document["timing_s"]) in ({"preprocess"}, set(stages_of(case.request.method)))
    if case.request.radius_m is not None:
        assert model.parameters == case.request.parameters_for(case.request.radius_m)
    assert [chain.id for chain in model.chains] == list(range(len(model.chains)))
    for chain in model.chains:
        assert_valid_chain(chain)
    assert [x.id for x in model.crossings] == list(range(len(model.crossings)))
    for x in model.crossings:
        assert x.point.shape == (3,)
        assert np.isfinite(x.point).all()
        for place in (x.over, x.under):
            assert_on_chain(place, model)
        assert x.gap_m >= 0
        assert 0 <= x.angle_rad <= np.pi / 2
        assert x.sign in (-1, 1)
        assert 0.5 <= x.confidence <= 1
    assert gauss_code_of(model.p_data()) == [code for code, _ in zip(model.gauss_code(), model.chains, strict=True)]
    for grasp in model.grasps:
        assert_on_chain(StrandPoint(grasp.chain, grasp.s_m), model)
        R = grasp.T_base_grasp[:3, :3]
        # A rotation, to rounding.
        np.testing.assert_allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-9)
        assert np.linalg.det(R) > 0
        assert np.isfinite(grasp.T_base_grasp).all()
        assert min(grasp.opening_m, grasp.reach_m) > 0
        assert grasp.clearance_m >= 0
        assert 0 <= grasp.score <= 1
    assert_valid_order(model.grasps)
    assert_valid_quality(model, case)
    assert_valid_trust(model)


def assert_valid_chain(chain: Chain) -> None:
    count = len(chain.points)
    assert chain.points.shape == (count, 3)
    assert count >= 2
    assert chain.sigma_m.shape == chain.views.shape == chain.arc_length_m.shape == (count,)
    assert np.isfinite(chain.points).all()
    assert np.isfinite(chain.sigma_m).all()
    assert (chain.sigma_m > 0).all()
    assert (chain.views >= 0).all()
    assert np.issubdtype(chain.views.dtype, np.integer)
    assert (np.diff(chain.arc_length_m) > 0).all()
    assert chain.arc_length_m[-1] <= chain.length_m
    assert 0.0002 < chain.radius_m < 0.05
    assert set(chain.ends) <= {"free", "unobserved", "touching"}


def assert_valid_order(grasps: Sequence[Grasp]) -> None:
    assert [grasp.id for grasp in grasps] == list(range(len(grasps)))
    clusters = len({grasp.cluster for grasp in grasps})
    best, others = grasps[:clusters], grasps[clusters:]
    assert [grasp.cluster for grasp in best] == list(range(clusters))
    for part in (best, others):
        ranks = [(not grasp.trusted, -grasp.score) for grasp in part]
        assert ranks == sorted(ranks)
    for grasp in others:
        assert grasp.chain == best[grasp.cluster].chain


def assert_on_chain(place: StrandPoint, model: PointChainModel) -> None:
    assert 0 <= place.chain < len(model.chains)
    # Rounding of an arc length.
    assert -1e-9 <= place.s_m <= model.chains[place.chain].length_m + 1e-9


def assert_valid_quality(model: PointChainModel, case: Case) -> None:
    quality = model.quality
    assert sorted(view.index for view in quality.views) == sorted(view.index for view in case.views)
    for view in quality.views:
        assert view.used == (view.reason is None) == (view.code is None)
        assert view.points >= 0
        figures = [view.fitness, view.rms_m, view.correction_m, view.correction_rad]
        assert all(figure is None or (np.isfinite(figure) and figure >= 0) for figure in figures)
    codes = {found.code for found in quality.findings}
    assert model.chains or codes & {"no-string-in-view", "no-string-found"}, "no string, and no finding that says why"
    for found in quality.findings:
        assert_valid_finding(found, model)
    ranks = [SEVERITIES.index(found.severity) for found in quality.findings]
    assert ranks == sorted(ranks), "the most serious first"


def assert_valid_finding(found: Finding, model: PointChainModel) -> None:
    assert found.severity == FINDING_TYPES[cast(FindingCode, found.code)].severity
    assert found.message.strip()
    assert not {"nan", "inf"} & set(found.message.lower().split())
    numbers = [found.value, found.limit, *(found.s_range_m or ()), *(found.point_m or ())]
    assert all(number is None or np.isfinite(number) for number in numbers)
    assert set(found.chains) <= {chain.id for chain in model.chains}
    assert found.crossing is None or found.crossing in {x.id for x in model.crossings}
    if found.end is not None or found.s_range_m is not None:
        assert len(found.chains) == 1, "an end and a part belong to one chain"
    if found.s_range_m is not None:
        start, stop = found.s_range_m
        assert 0 <= start <= stop
        assert start <= model.chains[found.chains[0]].length_m


def assert_valid_trust(model: PointChainModel) -> None:
    for chain in model.chains:
        trust = model.chain_trust(chain.id)
        edges = [edge for part in trust.trusted_m for edge in part]
        assert edges == sorted(edges)
        assert all(0 <= edge <= chain.length_m for edge in edges)
        assert (trust.verdict == "accept") == (trust.trusted_m == ((0.0, chain.length_m),))
    for grasp in model.grasps:
        assert grasp.trusted
        assert model.trusted(grasp.chain, grasp.s_m)
