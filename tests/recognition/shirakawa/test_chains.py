"""Chains of the model from strands, and the uncertainty of their points."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from recognition.geometry.polyline import arc_length, points_at
from recognition.model.chains import Chain
from recognition.model.findings import Finding
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import Scene
from recognition.shirakawa.chains import MIN_SIGMA_M, assemble_chains, point_uncertainty
from recognition.strand import Strand

NOTHING = np.empty((0, 3))
X = np.arange(0.0, 0.1001, 0.004)


def strand(*corners_mm: tuple[float, float]) -> Strand:
    corners = np.array([(x, y, 4.2) for x, y in corners_mm]) / 1000
    s = arc_length(corners)
    points = points_at(corners, np.linspace(0, s[-1], round(s[-1] / 0.0042) + 1))
    bridged = np.zeros(len(points), dtype=bool)
    bridged[1] = True
    return Strand(points, bridged)


def chains_of(strands: list[Strand], parameters: ChainParameters) -> tuple[tuple[Chain, ...], list[Finding]]:
    assembly = assemble_chains(strands, NOTHING, [], Scene(), parameters)
    kept, chains, findings = assembly.strands, assembly.chains, list(assembly.findings)
    assert len(kept) == len(chains)
    for kept_strand, chain in zip(kept, chains, strict=True):
        np.testing.assert_array_equal(kept_strand.points, chain.points)
    return chains, findings


def test_chains_are_in_canonical_order_and_ids_follow_it(table_1: ChainParameters) -> None:
    # x + y / 2 of their means is 25, 55 and 45 mm.
    chains, findings = chains_of(
        [strand((0, 0), (50, 0)), strand((0, 20), (90, 20)), strand((0, 40), (50, 40))], table_1
    )
    assert [chain.id for chain in chains] == [0, 1, 2]
    np.testing.assert_allclose([chain.length_m for chain in chains], (0.05, 0.05, 0.09), rtol=0, atol=1e-9)
    np.testing.assert_allclose([chain.points[0, 1] for chain in chains], (0.0, 0.04, 0.02), rtol=0, atol=1e-9)
    assert findings == []


def test_each_runs_along_x_and_a_half_of_y(table_1: ChainParameters) -> None:
    to_the_left = strand((90, 10), (0, 40))
    downwards = strand((5, 50), (5, -30))
    (first, second), _ = chains_of([to_the_left, downwards], table_1)
    np.testing.assert_allclose(first.points[[0, -1], :2], [(0.005, -0.03), (0.005, 0.05)], rtol=0, atol=1e-12)
    np.testing.assert_allclose(second.points[[0, -1], :2], [(0, 0.04), (0.09, 0.01)], rtol=0, atol=1e-12)


def test_a_string_has_the_same_order_in_whichever_direction_it_was_found(table_1: ChainParameters) -> None:
    one = strand((0, 0), (60, 0), (90, 50))
    other = Strand(one.points[::-1].copy(), one.bridged[::-1].copy())
    kept = [assemble_chains([s], NOTHING, [], Scene(), table_1).strands[0] for s in (one, other)]
    np.testing.assert_array_equal(kept[0].points, kept[1].points)
    np.testing.assert_array_equal(kept[0].bridged, kept[1].bridged)


def test_pieces_shorter_than_r_cn_are_excluded_with_a_note(table_1: ChainParameters) -> None:
    # r_cn = 12.6 mm.
    chains, (excluded,) = chains_of([strand((0, 0), (12.5, 0)), strand((0, 20), (12.7, 20))], table_1)
    assert len(chains) == 1
    assert (excluded.code, excluded.severity, excluded.chains) == ("piece-too-short", "note", ())
    assert excluded.value == pytest.approx(0.0125, abs=1e-12)
    assert excluded.point_m == pytest.approx((0.00625, 0.0, 0.0042), abs=1e-12)
    assert excluded.message == "excluded a piece of 12 mm at (6, 0, 4) mm: too short to be distinguished from noise"


def test_excluded_pieces_are_listed_by_length_and_the_rest_are_counted(table_1: ChainParameters) -> None:
    _, findings = chains_of([strand((0, 20 * k), (5 + 0.5 * k, 20 * k)) for k in range(13)], table_1)
    none_found, *excluded, further = findings
    assert none_found.code == "no-string-found"
    assert [found.value for found in excluded] == pytest.approx([0.011 - 0.0005 * k for k in range(10)], abs=1e-9)
    assert (further.code, further.value) == ("more-pieces", 3)
    assert further.message == "excluded 3 more pieces, 5 to 6 mm long, the longest at (3, 40, 4) mm"


def test_no_strand_gives_a_note(table_1: ChainParameters) -> None:
    chains, (none_found,) = chains_of([], table_1)
    assert chains == ()
    assert (none_found.code, none_found.severity) == ("no-string-found", "note")
    assert none_found.message == "no string found: nothing above the table is long and thin"
    chains, findings = chains_of([strand((0, 0), (5, 0))], table_1)
    assert chains == ()
    assert [found.code for found in findings] == ["no-string-found", "piece-too-short"]


def test_the_chain_has_the_properties_of_its_strand(table_1: ChainParameters) -> None:
    angle = np.linspace(0, 2 * np.pi, 45, endpoint=False)
    points = np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), np.full(45, 0.0042)])
    (chain,), _ = chains_of([Strand(points, np.zeros(45, dtype=bool), closed=True)], table_1)
    assert chain.closed
    assert chain.ends == ("free", "free")
    assert chain.radius_m == table_1.r
    assert len(chain.sigma_m) == len(chain.views) == 45


def test_an_end_at_the_workspaces_border_is_unobserved(table_1: ChainParameters) -> None:
    scene = Scene(workspace_m=((-0.1, 0.092), (-0.1, 0.1), (0.0, 0.1)))
    (chain,) = assemble_chains([strand((90, 0), (0, 0))], NOTHING, [], scene, table_1).chains
    assert chain.ends == ("free", "unobserved")


def straight_strand(bridged: np.ndarray | None = None) -> Strand:
    points = np.column_stack([X, np.zeros_like(X), np.full_like(X, 0.0042)])
    return Strand(points, np.zeros(len(X), dtype=bool) if bridged is None else bridged)


def seen_from(tube: Callable, r: float, view: int, x0: float, x1: float, aside_m: float = 0.0) -> NormalCloud:
    """Return what a view measures of the string between x0 and x1: exact, with an offset of `aside_m` along y."""
    x = np.arange(x0, x1, 0.0005)
    axis = np.column_stack([x, np.full_like(x, aside_m), np.full_like(x, 0.0042)])
    points, normals = tube(axis, r, 0.0, np.pi)
    return NormalCloud(view, points, normals, np.eye(4))


def test_views_are_counted_point_by_point(table_1: ChainParameters, tube: Callable) -> None:
    r = table_1.r
    clouds = [
        seen_from(tube, r, 0, -0.01, 0.11),
        seen_from(tube, r, 1, -0.01, 0.0501),
        seen_from(tube, r, 2, -0.01, 0.0301),
    ]
    sigma, views = point_uncertainty(straight_strand(), clouds, table_1)
    # A view's centres count within r: up to 30 + 4.2 and 50 + 4.2 mm.
    expected = 1 + (X < 0.0543).astype(int) + (X < 0.0343)
    np.testing.assert_array_equal(views, expected)
    assert np.issubdtype(views.dtype, np.integer)
    # Exact and agreeing views: only the floor is left, where a whole neighbourhood is seen.
    np.testing.assert_allclose(sigma, MIN_SIGMA_M, rtol=0, atol=1e-12)


def test_sigma_is_the_spread_of_the_views(table_1: ChainParameters, tube: Callable) -> None:
    clouds = [seen_from(tube, table_1.r, k, -0.01, 0.11, aside_m=a) for k, a in enumerate((0.001, -0.001))]
    sigma, views = point_uncertainty(straight_strand(), clouds, table_1)
    np.testing.assert_array_equal(views, 2)
    # A millimetre to either side, with the floor of 0.2 mm.
    np.testing.assert_allclose(sigma, np.hypot(0.001, MIN_SIGMA_M), rtol=0, atol=1e-9)


def test_an_offset_along_the_string_is_no_disagreement(table_1: ChainParameters, tube: Callable) -> None:
    # It ends in the neighbourhood of the last points, so that means lie behind them, but on the line.
    clouds = [seen_from(tube, table_1.r, 0, -0.01, 0.0985)]
    sigma, _ = point_uncertainty(straight_strand(), clouds, table_1)
    np.testing.assert_allclose(sigma, MIN_SIGMA_M, rtol=0, atol=1e-12)


def test_bridged_points_have_no_views_and_a_larger_sigma_towards_their_middle(
    table_1: ChainParameters, tube: Callable
) -> None:
    bridged = (X > 0.0399) & (X < 0.0601)
    # An object lies 2 r above the string all along the bridged part.
    x, y = np.meshgrid(np.arange(0.038, 0.0621, 0.0005), np.arange(-0.006, 0.0061, 0.0005))
    lid = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 4 * table_1.r)])
    cloud = seen_from(tube, table_1.r, 0, -0.01, 0.11)
    covered = replace(
        cloud,
        points=np.vstack([cloud.points, lid]),
        normals=np.vstack([cloud.normals, np.tile((0.0, 0.0, 1.0), (len(lid), 1))]),
    )
    sigma, views = point_uncertainty(straight_strand(bridged), [covered], table_1)
    np.testing.assert_array_equal(views, np.where(bridged, 0, 1))
    # 36 and 64 mm are the last seen points on either side.
    gap = np.minimum(X - 0.036, 0.064 - X)[bridged]
    np.testing.assert_allclose(sigma[bridged], MIN_SIGMA_M + gap**2 / (10 * table_1.r), rtol=0, atol=1e-9)
    assert sigma[bridged].min() > sigma[~bridged].max()


def test_a_bridge_that_nothing_covers_was_seen(table_1: ChainParameters, tube: Callable) -> None:
    # The over strand of an intersection: bridged there like the other, but in plain sight.
    bridged = (X > 0.0399) & (X < 0.0601)
    sigma, views = point_uncertainty(straight_strand(bridged), [seen_from(tube, table_1.r, 0, -0.01, 0.11)], table_1)
    np.testing.assert_array_equal(views, 1)
    np.testing.assert_allclose(sigma[bridged], MIN_SIGMA_M, rtol=0, atol=1e-9)


def test_sigma_is_r_if_no_view_saw_the_strand(table_1: ChainParameters, tube: Callable) -> None:
    for clouds in ([], [seen_from(tube, table_1.r, 0, 0.5, 0.6)]):
        sigma, views = point_uncertainty(straight_strand(), clouds, table_1)
        np.testing.assert_array_equal(views, 0)
        np.testing.assert_array_equal(sigma, table_1.r)


def test_a_single_point_has_a_sigma(table_1: ChainParameters, tube: Callable) -> None:
    alone = Strand(np.array([[0.05, 0.0, 0.0042]]), np.zeros(1, dtype=bool))
    sigma, views = point_uncertainty(alone, [seen_from(tube, table_1.r, 0, 0.0, 0.1)], table_1)
    assert views.tolist() == [1]
    assert np.isfinite(sigma).all()
