"""Chains of fitted strands: order, rejected surfaces, ends and findings."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from recognition.assembly.chains import MAX_TABLE_GAP_RADII, ChainAssembly, assemble_fitted_chains, classify_ends
from recognition.model.chains import Chain
from recognition.model.findings import Finding
from recognition.parameters import ChainParameters
from recognition.preprocessing.support_surface import SupportSurface
from recognition.preprocessing.target_cloud import Scene
from recognition.refinement.refinement import FittedStrand, Refinement, refine
from recognition.refinement.string_classifier import MAX_SQUARENESS, classify_strings
from recognition.registration.registration import Registration
from recognition.tracing.occlusion_map import OcclusionMap
from recognition.tracing.trace import trace_strands

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
NOISE = 0.05 * R

Surface = tuple[np.ndarray, np.ndarray]


def found(
    views: Registration, scene: Scene | None = None, parameters: ChainParameters = PARAMETERS
) -> tuple[tuple[Chain, ...], tuple[Finding, ...]]:
    """Return the chains and findings of the graph method, which must have no doubt."""
    assembly = assembled(views, scene, parameters)
    assert [finding for finding in assembly.findings if finding.severity != "note"] == []
    return assembly.chains, assembly.findings


def assembled(
    views: Registration, scene: Scene | None = None, parameters: ChainParameters = PARAMETERS
) -> ChainAssembly:
    occlusion_map = OcclusionMap(views.points)
    graph = trace_strands(views.points - parameters.r * views.normals, occlusion_map, parameters)
    refinement = refine(graph.strands, views.points, views.normals, parameters)
    return assembled_from(refinement, views, occlusion_map, scene or Scene(), parameters)


def assembled_from(
    refinement: Refinement,
    views: Registration,
    occlusion_map: OcclusionMap,
    scene: Scene,
    parameters: ChainParameters = PARAMETERS,
) -> ChainAssembly:
    strings = classify_strings(refinement, views.points, parameters, SupportSurface(scene.table_z_m))
    return assemble_fitted_chains([strings], views, occlusion_map, scene, parameters)


def fitted(points: np.ndarray) -> FittedStrand:
    n = len(points)
    return FittedStrand(points, False, np.zeros(n, dtype=bool), np.full(n, 40.0), R, R, 0.35, 0.0, 0.05)


def box(low: tuple[float, float], high: tuple[float, float], height: float, edge: float) -> Surface:
    """Top and sides of a box, its upper edges rounded with the radius `edge`, points 1.2 mm apart."""
    step, parts = 0.0012, []
    x, y = (np.arange(a + edge, b - edge, step) for a, b in zip(low, high, strict=True))
    top = np.stack(np.meshgrid(x, y, [height]), axis=-1).reshape(-1, 3)
    parts.append((top, np.tile((0.0, 0.0, 1.0), (len(top), 1))))
    turns = np.linspace(0, np.pi / 2, max(int(edge * np.pi / 2 / step), 3))
    for axis, along in ((0, y), (1, x)):
        for side, outward in ((low[axis], -1.0), (high[axis], 1.0)):
            flat = np.arange(0.005, height - edge, step)
            a, z = (grid.ravel() for grid in np.meshgrid(along, flat))
            b, turn = (grid.ravel() for grid in np.meshgrid(along, turns))
            points, normals = np.zeros((len(a) + len(b), 3)), np.zeros((len(a) + len(b), 3))
            normals[:, axis] = outward * np.concatenate([np.ones(len(a)), np.cos(turn)])
            normals[len(a) :, 2] = np.sin(turn)
            points[:, 1 - axis] = np.concatenate([a, b])
            points[:, axis] = side - outward * edge + edge * normals[:, axis]
            points[:, 2] = np.concatenate([z, height - edge + edge * np.sin(turn)])
            parts.append((points, normals))
    points, normals = (np.vstack(each) for each in zip(*parts, strict=True))
    return points, normals


def test_a_string_is_a_chain(seen: Callable, straight: Callable, registered: Callable, off_line: Callable) -> None:
    axis = straight((0, 0, R), (0.12, 0, R))
    views = registered([seen([axis], noise=NOISE, seed=seed) for seed in range(3)])
    (chain,), findings = found(views)
    assert findings == ()
    assert (chain.id, chain.closed, chain.radius_m, chain.ends) == (0, False, R, ("free", "free"))
    assert chain.length_m == pytest.approx(0.12, abs=0.3 * R)
    np.testing.assert_array_equal(chain.views, 3)
    assert off_line(chain.points, [axis]).max() < 0.1 * R
    # A tenth of a millimetre or so of pose and of noise each, and no better than the floor.
    assert chain.sigma_m.min() > 0.0001
    assert chain.sigma_m.max() < 0.0005


def test_chains_are_in_canonical_order_and_direction(seen: Callable, straight: Callable, registered: Callable) -> None:
    # Given from their far ends. x + y / 2 of their means is 62 mm and 30 mm, so the shorter one comes first.
    strings = [straight((0.1, 0.04, R), (-0.02, 0.05, R)), straight((0.06, 0, R), (0, 0, R))]
    chains, _ = found(registered([seen(strings, noise=NOISE)]))
    assert [chain.id for chain in chains] == [0, 1]
    for chain, start in zip(chains, ((0.0, 0.0), (-0.02, 0.05)), strict=True):
        np.testing.assert_allclose(chain.points[0, :2], start, rtol=0, atol=0.3 * R)
        assert len(chain.sigma_m) == len(chain.views) == len(chain.points)


@pytest.mark.parametrize("edge", [0.0, 0.3, 0.5, 0.8, 1.0, 1.5])
def test_the_edges_of_a_box_are_no_strings(
    seen: Callable, straight: Callable, registered: Callable, edge: float
) -> None:
    string = seen([straight((0, 0, R), (0.1, 0, R))], noise=NOISE)
    points, normals = box((0.02, 0.03), (0.08, 0.08), 0.025, edge * R)
    noisy = points + np.random.default_rng(1).normal(0, NOISE, (len(points), 1)) * normals
    chains, _ = found(registered([(np.vstack([string[0], noisy]), np.vstack([string[1], normals]))]))
    # Only the string: its whole length and no more.
    assert [round(chain.length_m, 3) for chain in chains] == [0.1]
    assert np.abs(chains[0].points[:, 1]).max() < 0.2 * R


def test_an_end_at_the_border_of_the_workspace_is_unobserved(
    seen: Callable, straight: Callable, registered: Callable
) -> None:
    views = registered([seen([straight((0, 0, R), (0.12, 0, R))], noise=NOISE)])
    box_m = ((-0.1, 0.122), (-0.1, 0.1), (-0.01, 0.1))
    (chain,), _ = found(views, Scene(workspace_m=box_m))
    assert chain.ends == ("free", "unobserved")
    (chain,), _ = found(views, Scene(workspace_m=((-0.1, 0.2), *box_m[1:])))
    assert chain.ends == ("free", "free")


def test_an_end_that_continues_under_another_strand_is_unobserved(seen: Callable, straight: Callable) -> None:
    over = straight((0, -0.05, 3 * R), (0, 0.05, 3 * R))
    occlusion_map = OcclusionMap(seen([over])[0])
    line = straight((-0.06, 0, R), (-R, 0, R), 0.003)
    assert classify_ends(fitted(line), occlusion_map, Scene(), PARAMETERS) == ("free", "unobserved")
    assert classify_ends(fitted(line[::-1]), occlusion_map, Scene(), PARAMETERS) == ("unobserved", "free")
    # Well before the other strand, and on top of it, the end was observed.
    assert classify_ends(fitted(line - (0.02, 0, 0)), occlusion_map, Scene(), PARAMETERS) == ("free", "free")
    assert classify_ends(fitted(line + (R, 0, 4 * R)), occlusion_map, Scene(), PARAMETERS) == ("free", "free")
    assert classify_ends(replace(fitted(line), closed=True), occlusion_map, Scene(), PARAMETERS) == ("free", "free")


@pytest.mark.parametrize(
    ("share", "codes"),
    [
        (1, []),
        (0.93, []),
        (1.07, []),
        (0.8, [("radius-smaller", "note")]),
        (1.15, [("radius-larger", "note")]),
        (1.4, [("radius-larger", "note")]),
        (0.65, [("radius-much-smaller", "doubt")]),
    ],
)
def test_a_radius_that_contradicts_the_given_one_is_a_note_and_a_much_smaller_one_a_doubt(
    seen: Callable, arc: Callable, registered: Callable, share: float, codes: list[tuple[str, str]]
) -> None:
    axis = arc(0.2, 0, 34, share * R)
    assembly = assembled(registered([seen([axis], radii=[share * R], noise=NOISE)]))
    (chain,) = assembly.chains
    assert [(finding.code, finding.severity) for finding in assembly.findings] == codes
    for finding in assembly.findings:
        assert (finding.chains, finding.limit) == ((0,), R)
        assert finding.value == pytest.approx(share * R, rel=0.02)
        assert finding.message.startswith(f"chain 0 measures {share * 4.2:.1f} mm in radius, not the expected 4.2 mm")
        assert ("give the radius of the thinnest string" in finding.message) == (share < 1)
        assert chain.radius_m == pytest.approx(share * R, rel=0.02)


@pytest.mark.parametrize(("share", "is_doubt"), [(1.4, True), (1.0, False)])
def test_a_straight_chain_of_another_radius_may_be_a_rod(
    seen: Callable, straight: Callable, registered: Callable, share: float, is_doubt: bool
) -> None:
    axis = straight((0, 0, share * R), (0.12, 0, share * R))
    assembly = assembled(registered([seen([axis], radii=[share * R], noise=NOISE)]))
    doubts = [finding for finding in assembly.findings if finding.severity == "doubt"]
    assert [(finding.code, finding.chains) for finding in doubts] == ([("possible-rod", (0,))] if is_doubt else [])
    if is_doubt:
        assert doubts[0].value == pytest.approx(share * R, rel=0.02)
        assert doubts[0].point_m == pytest.approx((0.06, 0.0, share * R), abs=0.001)


def test_strings_of_different_radii_lie_in_one_scene(
    seen: Callable, arc: Callable, registered: Callable, off_line: Callable
) -> None:
    # In the order of x + y / 2 of their means.
    axes = [arc(0.2, 0, 28, 0.6 * R), arc(0.25, 0, 30, 1.4 * R)]
    assembly = assembled(registered([seen(axes, radii=[0.6 * R, 1.4 * R], noise=NOISE)]))
    chains = assembly.chains
    (doubt,) = (finding for finding in assembly.findings if finding.severity != "note")
    # Parts of the thinner string may be missing.
    assert (doubt.code, doubt.chains) == ("radius-much-smaller", (0,))
    assert doubt.value == pytest.approx(0.6 * R, rel=0.02)
    np.testing.assert_allclose([chain.radius_m / R for chain in chains], (0.6, 1.4), rtol=0.02, atol=0)
    for chain, axis in zip(chains, axes, strict=True):
        assert off_line(chain.points, [axis]).max() < 0.1 * R


@pytest.mark.parametrize("gap", [1.2, 2.0])
def test_a_strand_has_no_views_where_another_hides_it(
    seen: Callable, heap: Callable, registered: Callable, gap: float
) -> None:
    under, over = heap((0, 90), gap * R, half=0.07)
    views = registered([seen([under, over[:-8]], noise=NOISE, seed=seed) for seed in range(2)])
    chains, _ = found(views)
    below, above = sorted(chains, key=lambda chain: np.ptp(chain.points[:, 0]), reverse=True)
    hidden = np.abs(below.points[:, 0]) < 0.5 * R
    assert hidden.any()
    np.testing.assert_array_equal(below.views[hidden], 0)
    np.testing.assert_array_equal(below.views[np.abs(below.points[:, 0]) > 2 * R], 2)
    assert below.sigma_m[hidden].min() > below.sigma_m[below.views > 0].max()
    np.testing.assert_array_equal(above.views, 2)


def test_a_ring_is_closed_and_its_length_is_its_perimeter(seen: Callable, arc: Callable, registered: Callable) -> None:
    (chain,), findings = found(registered([seen([arc(0.04, 0, 360)], noise=NOISE)]))
    assert chain.closed
    assert chain.ends == ("free", "free")
    assert findings == ()
    # 251.3 mm: the radius of its line is known to 0.02 r.
    assert chain.length_m == pytest.approx(2 * np.pi * 0.04, abs=2 * np.pi * 0.02 * R)


def test_without_strands_there_are_no_chains_and_a_note(
    seen: Callable, straight: Callable, registered: Callable
) -> None:
    views = registered([seen([straight((0, 0, R), (0.1, 0, R))])])
    nothing = Refinement([], np.full(len(views.points), -1), 0.0)
    assembly = assembled_from(nothing, views, OcclusionMap(views.points), Scene())
    assert assembly.chains == ()
    (note,) = assembly.findings
    assert (note.code, note.severity, note.chains) == ("no-string-found", "note", ())
    assert note.message.startswith("no string of radius 4.2 mm found")
    assert note.message.endswith("check the radius")


def test_a_string_that_nothing_supports_is_a_doubt(seen: Callable, straight: Callable, registered: Callable) -> None:
    def findings_on(*strings: np.ndarray) -> tuple[Finding, ...]:
        return assembled(registered([seen(list(strings), noise=NOISE, seed=seed) for seed in range(2)])).findings

    (doubt,) = findings_on(straight((0, 0, 1.6 * R), (0.15, 0, 1.6 * R)))
    assert (doubt.code, doubt.severity, doubt.chains) == ("above-table", "doubt", (0,))
    # 0.6 r above the table; the depth noise is 0.05 r.
    assert doubt.value == pytest.approx(0.6 * R, abs=0.1 * R)
    assert doubt.limit == pytest.approx(MAX_TABLE_GAP_RADII * R, rel=0.05)
    assert "above what is beside it along nearly all its length" in doubt.message
    # One that rests on another in the middle lies on the table elsewhere.
    over = straight((0, 0, R), (0.2, 0, R))
    over[:, 2] += 2 * R * np.exp(-(((over[:, 0] - 0.1) / 0.025) ** 2))
    assert findings_on(over, straight((0.1, -0.1, R), (0.1, 0.1, R))) == ()
    # One that lies on two others, as in a heap, is supported. On one of them, nothing supports its other half.
    others = [straight((x, -0.1, R), (x, 0.1, R)) for x in (0.04, 0.16)]
    upper = straight((0, 0, 3 * R), (0.2, 0, 3 * R))
    assert findings_on(upper, *others) == ()
    (doubt,) = findings_on(upper, others[0])
    assert doubt.code == "above-table"


def test_a_string_that_may_be_a_bar_is_kept_with_a_doubt(
    seen: Callable, straight: Callable, registered: Callable
) -> None:
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    views = registered([seen([line])])
    # Without a measurement of the squareness, the finding has no value.
    for sigma, value in ((0.1, pytest.approx(0.3, abs=1e-12)), (np.inf, None)):
        strand = replace(fitted(line), roundness_error_m=0.0, squareness=0.1, squareness_sigma=sigma)
        refinement = Refinement([strand], np.zeros(len(views.points), dtype=np.int64), 0.0002)
        assembly = assembled_from(refinement, views, OcclusionMap(views.points), Scene())
        (chain,), (doubt,) = assembly.chains, assembly.findings
        assert (chain.id, doubt.code, doubt.severity, doubt.chains) == (0, "possible-bar", "doubt", (0,))
        assert doubt.point_m == pytest.approx((0.05, 0.0, R), abs=1e-9)
        assert (doubt.value, doubt.limit) == (value, MAX_SQUARENESS)
        assert doubt.message.startswith("chain 0 at (50, 0, 4) mm may be a bar with edges instead of a string")
