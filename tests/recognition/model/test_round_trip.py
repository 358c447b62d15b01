"""A document that is read and written again is the same document, in all digits."""

import json
from collections.abc import Sequence

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.findings import Finding, finding
from recognition.model.grasps import Grasp, GraspMotion
from recognition.model.model import PointChainModel
from recognition.model.quality import Quality, ViewQuality
from recognition.parameters import ChainParameters

NEAR_M = 1e-5
"""Distance from a limit within which rounding can move a number to the other side: a few micrometres, and that below
which arc lengths count as equal."""
Rng = np.random.Generator


def random_chain(rng: Rng, number: int, closed: bool) -> Chain:
    """Return a chain of 2 to 300 points with links of 1 to 4 mm, 1 mm to 1 m long."""
    n = int(rng.integers(2, 300))
    links = rng.normal(size=(n, 3))
    links *= rng.uniform(1e-3, 4e-3, size=(n, 1)) / np.linalg.norm(links, axis=1, keepdims=True)
    views = rng.integers(0, 9, size=n)
    return Chain(
        number,
        closed,
        float(rng.uniform(0.001, 0.01)),
        np.cumsum(links, axis=0),
        rng.uniform(1e-5, 1e-3, size=n),
        views,
        ("free", "unobserved"),
    )


def random_position(rng: Rng, chains: Sequence[Chain]) -> StrandPoint:
    chain = chains[int(rng.integers(len(chains)))]
    return StrandPoint(chain.id, float(rng.uniform(0.0, chain.length_m)))


def random_crossing(rng: Rng, number: int, chains: Sequence[Chain]) -> Crossing:
    over = random_position(rng, chains)
    under = random_position(rng, chains)
    sign = int(rng.choice((1, -1)))
    gap_m, angle_rad, confidence = (float(value) for value in rng.uniform((0.0, 0.0, 0.5), (0.02, 1.5, 1.0)))
    return Crossing(number, rng.normal(size=3), over, under, gap_m, angle_rad, sign, confidence)


def random_pose(rng: Rng) -> NDArray[np.float64]:
    T = np.eye(4)
    T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3))).Q
    T[:3, 3] = rng.normal(size=3)
    return T


def random_grasp(rng: Rng, number: int, chains: Sequence[Chain]) -> Grasp:
    at = random_position(rng, chains)
    opening_m, reach_m, clearance_m, table_clearance_m = (float(value) for value in rng.uniform(0.0, 0.05, size=4))
    return Grasp(
        id=number,
        cluster=int(rng.integers(number + 1)),
        chain=at.chain,
        s_m=at.s_m,
        T_base_grasp=random_pose(rng),
        opening_m=opening_m,
        reach_m=reach_m,
        clearance_m=clearance_m,
        table_clearance_m=table_clearance_m,
        score=float(rng.uniform()),
        sigma_m=float(rng.uniform(0.0, 0.002)),
        end_distance_m=float(rng.uniform(0.0, 0.4)),
        over_distance_m=float(rng.uniform(0.0, 0.4)),
        under_distance_m=None,
        chains_above=(at.chain,),
        object_above_m=float(rng.uniform(0.0, 0.06)),
        T_base_flange=GraspMotion(random_pose(rng), random_pose(rng), random_pose(rng)),
    )


def doubts(rng: Rng, chain: Chain, crossings: Sequence[Crossing]) -> list[Finding]:
    """Return doubts about an end, about a part whose limits are near crossings or the ends, and about a crossing."""
    length = chain.length_m
    passes = [at.s_m for x in crossings for at in (x.over, x.under) if at.chain == chain.id]
    limits = np.array([0.0, length / 3, length, *passes])
    start, stop = np.sort(rng.choice(limits, size=2) + rng.uniform(-NEAR_M, NEAR_M, size=2))
    found = [
        finding("end-unobserved", "m", chains=(chain.id,), end="last", s_range_m=(0.9 * length, length), value=1 / 3),
        finding("sharp-bend", "m", chains=(chain.id,), s_range_m=(start, stop), limit=2 / 3),
    ]
    if chain.closed:  # a part of a ring may exceed the length
        found.append(finding("sharp-bend", "m", chains=(chain.id,), s_range_m=(stop, start + length)))
    for x in crossings:
        both = tuple({x.over.chain, x.under.chain})
        found.append(finding("crossing-undecided", "m", chains=both, crossing=x.id, point=x.point))
    return [one for one in found if rng.random() < 0.4]


@st.composite
def models(draw: st.DrawFn) -> PointChainModel:
    """Draw open and closed chains with crossings, doubts and grasps. Their numbers have all digits of a float."""
    closed = draw(st.lists(st.booleans(), min_size=1, max_size=3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    chains = [random_chain(rng, number, ring) for number, ring in enumerate(closed)]
    crossings = [random_crossing(rng, number, chains) for number in range(draw(st.integers(0, 5)))]
    findings = [one for chain in chains for one in doubts(rng, chain, crossings)]
    fitness, rms_m, correction_m, correction_rad = (float(value) for value in rng.uniform(0.0, 0.01, size=4))
    view = ViewQuality(0, True, None, 5213, fitness, rms_m, correction_m, correction_rad)
    return PointChainModel(
        "graph",
        ChainParameters.for_radius(float(rng.uniform(0.002, 0.006))),
        tuple(chains),
        tuple(crossings),
        Quality((view,), tuple(findings)),
        {"preprocess": float(rng.uniform())},
        grasps=tuple(random_grasp(rng, number, chains) for number in range(3)),
    )


@given(models())
@settings(max_examples=300)
def test_a_document_that_is_read_and_written_again_is_the_same(model: PointChainModel) -> None:
    document = model.to_json()
    assert PointChainModel.from_json(document).to_json() == document
    text = json.dumps(document)
    assert json.dumps(PointChainModel.from_json(json.loads(text)).to_json()) == text


@given(models())
def test_a_model_that_is_read_has_the_verdicts_and_the_topology_of_its_document(model: PointChainModel) -> None:
    document = json.loads(json.dumps(model.to_json()))
    read = PointChainModel.from_json(document)
    for chain, entry in zip(read.chains, document["chains"], strict=True):
        assert chain.length_m == entry["length_m"]
        np.testing.assert_array_equal(chain.arc_length_m, entry["arc_length_m"])
        assert read.chain_trust(chain.id).verdict == entry["trust"]
    assert [read.crossing_verdict(x.id) for x in read.crossings] == [entry["trust"] for entry in document["crossings"]]
    assert read.gauss_code() == document["topology"]["gauss_code"]
