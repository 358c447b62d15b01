"""From strands to the chains of the model."""

import numpy as np

from recognition.geometry.polyline import arc_length
from recognition.model.model import Chain
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.shirakawa.chains import assemble_chains, sharp_bend_messages
from recognition.strand import Strand

NOTHING = np.empty((0, 3))


def strand(*corners_mm: tuple[float, float]) -> Strand:
    corners = np.array([(x, y, 4.2) for x, y in corners_mm]) / 1000
    s = arc_length(corners)
    even = np.linspace(0, s[-1], round(s[-1] / 0.0042) + 1)
    points = np.column_stack([np.interp(even, s, corners[:, k]) for k in range(3)])
    bridged = np.zeros(len(points), dtype=bool)
    bridged[1] = True
    return Strand(points, bridged)


def chains_of(strands: list[Strand], parameters: ChainParameters) -> tuple[tuple[Chain, ...], list[str]]:
    kept, chains, warnings = assemble_chains(strands, NOTHING, [], Scene(), parameters)
    assert len(kept) == len(chains)
    for kept_strand, chain in zip(kept, chains, strict=True):
        np.testing.assert_array_equal(kept_strand.points, chain.points)
    return chains, warnings


def test_the_longest_comes_first_and_ids_follow_the_order(table_1: ChainParameters) -> None:
    chains, warnings = chains_of(
        [strand((0, 0), (50, 0)), strand((0, 20), (90, 20)), strand((0, 40), (70, 40))], table_1
    )
    assert [chain.id for chain in chains] == [0, 1, 2]
    np.testing.assert_allclose([chain.length_m for chain in chains], (0.09, 0.07, 0.05), rtol=0, atol=1e-9)
    assert warnings == []


def test_each_begins_at_its_end_of_smaller_x_then_y(table_1: ChainParameters) -> None:
    to_the_left = strand((90, 10), (0, 40))
    downwards = strand((5, 50), (5, -30))
    (first, second), _ = chains_of([to_the_left, downwards], table_1)
    np.testing.assert_allclose(first.points[[0, -1], :2], [(0, 0.04), (0.09, 0.01)], rtol=0, atol=1e-12)
    np.testing.assert_allclose(second.points[[0, -1], :2], [(0.005, -0.03), (0.005, 0.05)], rtol=0, atol=1e-12)


def test_the_same_string_reads_the_same_whichever_way_it_was_found(table_1: ChainParameters) -> None:
    one = strand((0, 0), (60, 0), (90, 50))
    other = Strand(one.points[::-1].copy(), one.bridged[::-1].copy())
    kept = [assemble_chains([s], NOTHING, [], Scene(), table_1)[0][0] for s in (one, other)]
    np.testing.assert_array_equal(kept[0].points, kept[1].points)
    np.testing.assert_array_equal(kept[0].bridged, kept[1].bridged)


def test_pieces_shorter_than_r_cn_are_left_out_and_said_so(table_1: ChainParameters) -> None:
    # r_cn = 12.6 mm.
    chains, warnings = chains_of([strand((0, 0), (12.5, 0)), strand((0, 20), (12.7, 20))], table_1)
    assert len(chains) == 1
    (said,) = warnings
    assert said.startswith("left out a piece of 12 mm at (6, 0, 4) mm")


def test_no_strand_is_said_so(table_1: ChainParameters) -> None:
    assert chains_of([], table_1) == ((), ["no string found: nothing above the table is long and thin"])
    chains, warnings = chains_of([strand((0, 0), (5, 0))], table_1)
    assert chains == ()
    assert len(warnings) == 2


def test_what_the_strand_knows_goes_on_to_the_chain(table_1: ChainParameters) -> None:
    angle = np.linspace(0, 2 * np.pi, 45, endpoint=False)
    points = np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), np.full(45, 0.0042)])
    (chain,), _ = chains_of([Strand(points, np.zeros(45, dtype=bool), closed=True)], table_1)
    assert chain.closed
    assert chain.ends == ("free", "free")
    assert chain.radius_m == table_1.r
    assert len(chain.sigma_m) == len(chain.views) == 45


def test_an_end_at_the_workspaces_border_is_unseen(table_1: ChainParameters) -> None:
    scene = Scene(workspace_m=((-0.1, 0.092), (-0.1, 0.1), (0.0, 0.1)))
    _, (chain,), _ = assemble_chains([strand((90, 0), (0, 0))], NOTHING, [], scene, table_1)
    assert chain.ends == ("free", "unseen")


def bends(degrees: float, table_1: ChainParameters) -> list[str]:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    chains, _ = chains_of([strand((0, 0), (50.4, 0), (50.4 + 50.4 * c, 50.4 * s))], table_1)
    return sharp_bend_messages(chains)


def test_a_sharp_bend_is_said_where_it_is(table_1: ChainParameters) -> None:
    (said,) = bends(100, table_1)
    assert said.startswith("chain 0 bends sharply at (50, 0, 4) mm")
    assert bends(60, table_1) == []
    assert bends(0, table_1) == []


def test_a_short_chain_has_no_bend(table_1: ChainParameters) -> None:
    chains, _ = chains_of([strand((0, 0), (13, 0))], table_1)
    assert sharp_bend_messages(chains) == []
    assert sharp_bend_messages(()) == []
