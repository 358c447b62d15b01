"""Gauss code and P-data: by hand, for known knots and links, and their invariants on random chains."""

import json
from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell.simulation.scenes.scenes import make_scene
from recognition.assembly.crossings import find_crossings
from recognition.errors import TopologyError
from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.document import p_data_document
from recognition.model.model import PointChainModel
from recognition.model.topology import CrossingElement, EndElement, PData, SegmentElement, gauss_code, p_data
from recognition.parameters import ChainParameters
from recognition.strand import Strand
from tests.recognition.invariants import Strings, gauss_code_of, linking_number, mirrored, turned_round, writhe

PARAMETERS = ChainParameters.for_radius(0.0042)


def chain(number: int, points: np.ndarray, closed: bool = False) -> Chain:
    n = len(points)
    return Chain(
        number, closed, 0.0042, points, np.full(n, 3e-4), np.full(n, 5, dtype=np.int64), ("free", "unobserved")
    )


def laid(*curves: np.ndarray, closed: bool = False) -> Strings:
    """Return chains along exact curves, and their crossings according to the heights of the curves."""
    strands = [Strand(points, np.zeros(len(points), dtype=bool), closed) for points in curves]
    crossings = find_crossings(strands, np.empty((0, 3)), PARAMETERS).crossings
    return tuple(chain(k, points, closed) for k, points in enumerate(curves)), tuple(crossings)


def circle(x: float, waves: int = 0) -> np.ndarray:
    """Return a ring of radius 50 mm about (x, 0), counter-clockwise, with `waves` height waves of amplitude 10 mm."""
    t = np.linspace(0, 2 * np.pi, 100, endpoint=False) + 0.01
    height = 0.01 * np.sin(waves * t) if waves else np.full(len(t), 0.02)
    return np.column_stack([x + 0.05 * np.cos(t), 0.05 * np.sin(t), height])


LOOP = np.array([(0, 0, 0.004), (60, 0, 0.004), (60, 40, 0.004), (30, 40, 0.012), (30, -40, 0.012)]) * (1e-3, 1e-3, 1)
"""A string along +x, +y, -x, then -y. It crosses over its first part at x = 30 mm: over is along -y, under along +x."""
OVER_AT = 0.06 + 0.04 + np.hypot(0.03, 0.008) + 0.04


@pytest.mark.parametrize("seed", range(4))
def test_an_overhand_knot_is_a_trefoil(seed: int) -> None:
    chains, crossings = laid(*make_scene("overhand-knot", seed).curves)
    assert [x.sign for x in crossings] in ([1, 1, 1], [-1, -1, -1])
    assert abs(writhe(crossings, 0)) == 3
    (code,) = gauss_code(chains, crossings)
    assert [role for _, role, _ in code] in (["over", "under"] * 3, ["under", "over"] * 3)
    # Each crossing is passed again three passes later.
    assert [number for number, _, _ in code[:3]] == [number for number, _, _ in code[3:]]


def test_a_loop_by_hand() -> None:
    chains, crossings = laid(LOOP)
    # Over is along -y and under along +x: the cross product of over and under is along +z.
    assert gauss_code(chains, crossings) == [[[0, "under", 1], [0, "over", 1]]]
    data = p_data(chains, crossings)
    length = chains[0].length_m
    first, last, crossing = data.elements[:3]
    assert first == EndElement(0, "first", 0.0, "free")
    assert last == EndElement(0, "last", length, "unobserved")
    assert isinstance(crossing, CrossingElement)
    assert (crossing.crossing, crossing.sign) == (0, 1)
    np.testing.assert_allclose(spans(data), [(0, 0.03), (0.03, OVER_AT), (OVER_AT, length)], rtol=0, atol=1e-12)
    # To the crossing (under, -1), around to the crossing again (over, 1), then to the other end (2).
    assert data.matrix.tolist() == [
        [0, 0, 0, 2, 0, 0],
        [0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, -1, 1],
        [0, 0, -1, 0, 0, 0],
        [0, 0, 1, 0, 0, 0],
        [0, 2, 0, 0, 0, 0],
    ]


def test_closed_chains_by_hand() -> None:
    plain = p_data(*laid(circle(0.0), closed=True))
    (segment,) = plain.elements
    assert isinstance(segment, SegmentElement)
    assert segment.s_m == pytest.approx((0, 100 * 0.1 * np.sin(np.pi / 100)), abs=1e-12)
    assert plain.matrix.tolist() == [[2]]
    assert gauss_code_of(plain) == [[]]

    t = np.linspace(0, 2 * np.pi, 200, endpoint=False) + 1.0
    eight = np.column_stack([0.1 * np.cos(t), 0.05 * np.sin(2 * t), 0.01 + 0.008 * np.sin(t)])
    chains, crossings = laid(eight, closed=True)
    crossed = p_data(chains, crossings)
    # It is highest at pi / 2, its first pass. The chain begins in the last segment.
    assert crossed.matrix.tolist() == [[0, 1, -1], [-1, 0, 0], [1, 0, 0]]
    begins, ends = spans(crossed)[-1]
    assert begins < chains[0].length_m < ends
    assert gauss_code_of(crossed) == gauss_code(chains, crossings)


def spans(data: PData) -> list[tuple[float, float]]:
    """Return the arc lengths of the beginning and the end of each segment."""
    return [element.s_m for element in data.elements if isinstance(element, SegmentElement)]


def test_no_string_has_no_elements() -> None:
    data = p_data((), ())
    assert (data.elements, data.matrix.shape) == ((), (0, 0))
    assert p_data_document(data).model_dump() == {"elements": [], "matrix": []}


def test_the_document_names_every_element() -> None:
    document = json.loads(p_data_document(p_data(*laid(LOOP))).model_dump_json())
    assert [element["id"] for element in document["elements"]] == list(range(6))
    assert [element["kind"] for element in document["elements"]] == ["end"] * 2 + ["crossing"] + ["segment"] * 3
    assert document["elements"][0] == {"id": 0, "kind": "end", "chain": 0, "which": "first", "s_m": 0.0, "end": "free"}
    assert document["elements"][2]["under"] == {"chain": 0, "s_m": 0.03}
    assert document["elements"][3] == {"id": 3, "kind": "segment", "chain": 0, "s_m": [0.0, 0.03]}


def test_linking_numbers() -> None:
    # The wavy ring passes over the flat one at one crossing and under it at the other.
    chains, crossings = laid(circle(0.0) - np.array([0, 0, 0.02]), circle(0.06, waves=1), closed=True)
    assert len(crossings) == 2
    hopf = linking_number(chains, crossings, 0, 1)
    assert abs(hopf) == 1
    assert linking_number(*turned_round(chains, crossings, 1), 0, 1) == -hopf
    assert linking_number(*turned_round(*turned_round(chains, crossings, 0), 1), 0, 1) == hopf
    assert linking_number(*mirrored(chains, crossings), 0, 1) == -hopf

    chains, crossings = laid(circle(0.0), circle(0.06) + np.array([0, 0, 0.01]), closed=True)
    assert len(crossings) == 2
    assert linking_number(chains, crossings, 0, 1) == 0


def test_a_crossing_of_an_unknown_chain_is_an_error() -> None:
    chains, crossings = laid(LOOP)
    with pytest.raises(TopologyError, match="chain 0, which is not in the model"):
        p_data((replace(chains[0], id=7),), crossings)


def described(crossings: tuple[Crossing, ...]) -> list[tuple[int, int, int, float, float]]:
    return sorted((x.over.chain, x.under.chain, x.sign, x.over.s_m, x.under.s_m) for x in crossings)


def assert_same(a: tuple[Crossing, ...], b: tuple[Crossing, ...]) -> None:
    assert [entry[:3] for entry in described(a)] == [entry[:3] for entry in described(b)]
    np.testing.assert_allclose(
        [entry[3:] for entry in described(a)], [entry[3:] for entry in described(b)], rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["figure-eight", "overhand-knot", "several"])
def test_turning_and_mirroring_agree_with_the_turned_and_mirrored_curves(name: str, seed: int) -> None:
    curves = make_scene(name, seed).curves
    chains, crossings = laid(*curves)
    for k in range(len(curves)):
        found = laid(*(curve[::-1] if j == k else curve for j, curve in enumerate(curves)))
        turned = turned_round(chains, crossings, k)
        assert_same(turned[1], found[1])
        np.testing.assert_array_equal(turned[0][k].points, found[0][k].points)
        for before, after in zip(crossings, turned[1], strict=True):
            itself = before.over.chain == before.under.chain
            other = k not in (before.over.chain, before.under.chain)
            assert after.sign == (before.sign if itself or other else -before.sign)
    reflected = mirrored(chains, crossings)
    assert [x.sign for x in reflected[1]] == [-x.sign for x in crossings]
    assert_same(reflected[1], laid(*(curve * (1, -1, 1) for curve in curves))[1])


def test_turning_a_closed_chain_agrees_with_the_turned_curve() -> None:
    wavy = circle(0.06, waves=1)
    chains, crossings = laid(circle(0.0), wavy, closed=True)
    assert_same(turned_round(chains, crossings, 1)[1], laid(circle(0.0), wavy[::-1].copy(), closed=True)[1])
    assert_same(turned_round(*turned_round(chains, crossings, 0), 0)[1], crossings)


@st.composite
def tangles(draw: st.DrawFn) -> Strings:
    """Draw open and closed chains with crossings at any passes, also such that no real string could have."""
    closed = draw(st.lists(st.booleans(), min_size=1, max_size=4))
    straight = np.column_stack([np.linspace(0, 1, 11), np.zeros((11, 2))])
    chains = tuple(chain(k, straight, loop) for k, loop in enumerate(closed))
    count = draw(st.integers(0, 8))
    # Passes in a random order, each at its own arc length.
    order = draw(st.permutations(range(2 * count)))
    passes = [StrandPoint(draw(st.integers(0, len(closed) - 1)), (k + 0.5) / (2 * count)) for k in order]
    crossings = tuple(
        Crossing(k, np.zeros(3), passes[2 * k], passes[2 * k + 1], 0.008, 1.0, draw(st.sampled_from((1, -1))), 1.0)
        for k in range(count)
    )
    return chains, crossings


def numbers(data: PData, kind: type) -> list[int]:
    return [k for k, element in enumerate(data.elements) if isinstance(element, kind)]


@given(tangles())
def test_every_element_has_its_neighbours(strings: Strings) -> None:
    chains, crossings = strings
    data = p_data(chains, crossings)
    matrix = data.matrix
    ends, nodes, segments = (numbers(data, kind) for kind in (EndElement, CrossingElement, SegmentElement))
    assert (len(ends), len(nodes)) == (2 * sum(not c.closed for c in chains), len(crossings))
    for k in nodes:
        # Four segment ends: over and under, each coming and going.
        assert sorted(matrix[k][matrix[k] != 0]) == sorted(matrix[:, k][matrix[:, k] != 0]) == [-1, 1]
    for k in ends:
        assert np.count_nonzero(matrix[k]) + np.count_nonzero(matrix[:, k]) == 1
    for k in segments:
        assert np.count_nonzero(matrix[k]) == np.count_nonzero(matrix[:, k]) == 1
    # Each segment has two ends, each at an end (1 contact) or a crossing (4 contacts). Closed chains without crossings
    # have none.
    loops = int(np.count_nonzero(np.diag(matrix)))
    assert 2 * (len(segments) - loops) == len(ends) + 4 * len(nodes)
    # The segments together are as long as the chains.
    assert sum(end - begin for begin, end in spans(data)) == pytest.approx(sum(c.length_m for c in chains), abs=1e-9)


@given(tangles())
def test_the_gauss_code_can_be_read_from_the_matrix(strings: Strings) -> None:
    assert gauss_code_of(p_data(*strings)) == gauss_code(*strings)


@given(tangles(), st.randoms(use_true_random=False))
def test_the_numbers_of_the_crossings_do_not_matter(strings: Strings, random: Random) -> None:
    chains, crossings = strings
    shuffled = list(crossings)
    random.shuffle(shuffled)
    again = tuple(replace(x, id=100 + k) for k, x in enumerate(shuffled))
    before, after = p_data(chains, crossings), p_data(chains, again)
    np.testing.assert_array_equal(after.matrix, before.matrix)
    back = {x.id: old.id for x, old in zip(again, shuffled, strict=True)}
    assert [replace(e, crossing=back[e.crossing]) if isinstance(e, CrossingElement) else e for e in after.elements] == [
        *before.elements
    ]


def test_the_numbers_do_not_matter_where_three_strands_cross_in_one_point() -> None:
    line = np.column_stack([np.linspace(0, 1, 11), np.zeros((11, 2))])
    chains = tuple(chain(k, line) for k in range(3))
    lowest, at = StrandPoint(0, 0.5), np.zeros(3)
    codes = []
    for first, second in ((1, 2), (2, 1)):
        crossings = tuple(
            Crossing(k, at, StrandPoint(other, 0.5), lowest, 0.008, 1.0, 1, 1.0)
            for k, other in enumerate((first, second))
        )
        code = gauss_code(chains, crossings)[0]
        codes.append([crossings[number].over.chain for number, _, _ in code])
    assert codes[0] == codes[1]


@given(tangles())
def test_reversing_every_chain_reverses_its_gauss_code(strings: Strings) -> None:
    chains, crossings = strings
    for c in chains:
        chains, crossings = turned_round(chains, crossings, c.id)
    assert [x.sign for x in crossings] == [x.sign for x in strings[1]]
    for there, back in zip(gauss_code(*strings), gauss_code_of(p_data(chains, crossings)), strict=True):
        # The code of a closed chain may begin at another crossing.
        turned = back[::-1]
        assert any(turned[k:] + turned[:k] == there for k in range(max(len(there), 1)))


def test_the_document_has_gauss_code_and_p_data() -> None:
    chains, crossings = laid(LOOP)
    model = PointChainModel("enhanced", PARAMETERS, chains, crossings)
    topology = model.to_json()["topology"]
    assert topology == {
        "gauss_code": gauss_code(chains, crossings),
        "p_data": p_data_document(p_data(chains, crossings)).model_dump(mode="json"),
    }
