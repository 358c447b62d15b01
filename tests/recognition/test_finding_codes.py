"""Every code of a finding, provoked through the code that makes it, with the members that a program needs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.clutter import Box, Rod
from cell.simulation.scenes.scenes import StringScene, make_scene
from recognition.assembly.chain_ends import mark_touching_ends
from recognition.assembly.crossings import find_fitted_crossings
from recognition.assembly.sharp_bends import sharp_bend_findings
from recognition.grasping.gripper import Gripper
from recognition.model.chains import Chain
from recognition.model.document import finding_json
from recognition.model.finding_types import FINDING_TYPES, FindingCode
from recognition.model.findings import Finding
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene, deproject
from recognition.refinement.refinement import FittedStrand, Refinement
from recognition.refinement.string_classifier import classify_strings
from recognition.request import RecognitionRequest
from tests.recognition.validity import assert_valid_finding

pytestmark = pytest.mark.slow

Points = NDArray[np.float64]
R = 0.0042
DEFAULT_GRIPPER = Gripper()
MADE_ELSEWHERE = {"view-missing", "recording-incomplete", "colour-unusable", "more-views-needed"}
"""Codes that the service makes, and that of `test_stepwise`."""
FINE_UNIT_M = 2e-5
"""Depth unit that is much less than a disparity."""
ALONG_X = ((-0.1, 0.0), (0.1, 0.0))


def line(start: tuple[float, float], end: tuple[float, float], z: float = R) -> Points:
    """Return a straight centre line in steps of about 1 mm."""
    a, b = np.array([*start, z]), np.array([*end, z])
    return np.linspace(a, b, round(float(np.linalg.norm(b - a)) / 0.001) + 1)


def scanned(*curves: Points, boxes: Sequence[Box] = (), views: int = 6) -> SimulatedScan:
    """Return a scan of strings and boxes without noise and pose errors, in coarse pixels."""
    scene = StringScene("codes", R, curves, tuple(boxes))
    return simulate(scene, camera_model("exact", (320, 200)), 1, errors=NO_ERRORS, views=views)


def findings_of(
    scan: SimulatedScan,
    r: float | None = R,
    views: Sequence[View] | None = None,
    half_m: float | None = 0.13,
    gripper: Gripper = DEFAULT_GRIPPER,
) -> tuple[Finding, ...]:
    """Return the findings of a scan in a workspace of twice `half_m`. None means the workspace of the scan."""
    workspace = scan.header.workspace_m
    if half_m is not None:
        workspace = ((-half_m, half_m), (-half_m, half_m), (0.0, 0.12))
    model = recognise(views or scan.views, RecognitionRequest(radius_m=r, gripper=gripper), Scene(0.0, workspace)).model
    for found in model.quality.findings:
        assert_valid_finding(found, model)
    return model.quality.findings


@cache
def one_string() -> SimulatedScan:
    return scanned(line(*ALONG_X))


@cache
def loop() -> SimulatedScan:
    return simulate(make_scene("loop", 1), camera_model("exact", (320, 200)), 1, errors=NO_ERRORS)


def with_view(scan: SimulatedScan, index: int, change: Callable[[View], View]) -> list[View]:
    """Return the views of a scan, one of them changed."""
    views = list(scan.views)
    views[index] = change(views[index])
    return views


def with_depth(depth: int) -> Callable[[View], View]:
    """Return a change of a view that sets all depths to one number of counts."""
    return lambda view: replace(view, depth=np.full_like(view.depth, depth))


def of_plane(view: View, z_m: float, finer: int = 1) -> View:
    """Return the view of a plane at a height instead of the scene, with `finer` times as many pixels each way."""
    K = view.K * np.array([[finer], [finer], [1.0]])
    T = view.T_base_camera
    v, u = np.indices((view.depth.shape[0] * finer, view.depth.shape[1] * finer))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T @ T[:3, :3].T
    depth = np.rint((z_m - T[2, 3]) / rays[..., 2] / view.depth_unit_m)
    return replace(view, depth=depth.astype(np.uint16), K=K, intensity=None)


def with_noisy_table(scan: SimulatedScan, sigma_m: float, block: int = 1) -> list[View]:
    """Return the views of a scan with noise on all pixels but those of the string and its edge.

    The pixels of a block share the noise.
    """
    rng, noisy = np.random.default_rng(1), []
    for view in scan.views:
        plane = of_plane(view, 0.003).depth.astype(np.float64)
        is_table = (view.depth > plane) & (view.depth > 0)
        height, width = view.depth.shape
        noise = rng.normal(0, sigma_m / view.depth_unit_m, (-(-height // block), -(-width // block)))
        noise = noise.repeat(block, axis=0).repeat(block, axis=1)[:height, :width]
        noisy.append(replace(view, depth=np.where(is_table, view.depth + noise, view.depth).astype(np.uint16)))
    return noisy


def with_curved_depth(scan: SimulatedScan) -> list[View]:
    """Return the views with a depth error that grows from the middle of the image to its sides, up to 3 mm."""
    views = []
    for view in scan.views:
        across = np.linspace(-1, 1, view.depth.shape[1]) ** 2 * 0.003 / view.depth_unit_m
        views.append(replace(view, depth=np.where(view.depth > 0, view.depth + across, 0).astype(np.uint16)))
    return views


def with_pixel_locking(captured: Sequence[View]) -> list[View]:
    """Return views with an error of a tenth of a disparity of a camera with f b = 30 pixel metres."""
    views = []
    for view in captured:
        depth_m = np.where(view.depth > 0, view.depth, 1) * view.depth_unit_m
        disparity = 30 / depth_m
        shown_m = 30 / (disparity + 0.1 * np.sin(2 * np.pi * disparity))
        depth = np.where(view.depth > 0, np.rint(shown_m / FINE_UNIT_M), 0)
        views.append(replace(view, depth=depth.astype(np.uint16), depth_unit_m=FINE_UNIT_M))
    return views


# --- parts of chains and crossings ---


def chain(number: int, points: Points, views: int = 5) -> Chain:
    n = len(points)
    return Chain(number, False, R, points, np.full(n, 0.0004), np.full(n, views, dtype=np.int64), ("free", "free"))


def bend(x_end: float) -> Callable[[], Sequence[Finding]]:
    """A simulated string with such a kink comes out rounder. The bend is that of a chain on the wrong strand."""
    bent = np.vstack([line((0, 0), (0.05, 0)), line((0.05, 0.001), (x_end, 0.05))])
    return lambda: sharp_bend_findings([chain(0, bent[::4])])


@cache
def flat_crossing() -> Sequence[Finding]:
    """Two strings that cross at nearly one height."""
    return findings_of(scanned(line((-0.08, 0), (0.08, 0)), line((0.01, -0.08), (0.01, 0.08), 1.2 * R)))


@cache
def hidden_junction() -> Sequence[Finding]:
    """One string goes in under a box, and two strings come out, 8 degrees to both sides."""
    c, s = np.cos(np.radians(8)), np.sin(np.radians(8))
    through = np.vstack([line((-0.09, 0), (0, 0)), line((0, 0), (0.09 * c, 0.09 * s))[1:]])
    other = line((0.01 * c, -0.01 * s), (0.09 * c, -0.09 * s))
    return findings_of(scanned(through, other, boxes=[Box((0.008, 0), (0.03, 0.05, 0.012), 0.0)]))


def unseen_upper_strand() -> Sequence[Finding]:
    """The views saw the lower strand at the crossing, but not the upper one."""
    over, under = line((-0.04, 0), (0.06, 0), 3 * R), line((0.01, -0.04), (0.01, 0.06))
    return find_fitted_crossings([chain(0, over[::4], views=0), chain(1, under[::4])]).findings


def facing_ends() -> Sequence[Finding]:
    """Two chains end to end. Tracing connects such strands, so no scan of the tests leaves them apart."""
    chains = [chain(0, line((-0.1, 0), (-0.002, 0))[::4]), chain(1, line((0.002, 0), (0.1, 0))[::4])]
    return mark_touching_ends(chains)[1]


@cache
def post_beside_string() -> tuple[Finding, ...]:
    post = Rod((0.0, 0.06, 0.0), (0.0, 0.06, 0.06), R)
    scene = StringScene("codes", R, (line(*ALONG_X),), rods=(post,))
    return findings_of(simulate(scene, camera_model("exact"), 1, errors=NO_ERRORS))


def string_into_box() -> Sequence[Finding]:
    """A box hides the end of a string. Its edges are no strings."""
    return findings_of(scanned(line((-0.1, 0), (0, 0)), boxes=[Box((0.015, 0), (0.03, 0.05, 0.02), 0.1)]))


# --- whole chains ---


def string_along_box() -> Sequence[Finding]:
    """A string lies along the side of a box, as an edge of the box would."""
    return findings_of(scanned(line(*ALONG_X), boxes=[Box((0, 0.026), (0.22, 0.04, 0.012), 0.0)]))


@cache
def raised() -> Sequence[Finding]:
    """A string one radius above the table."""
    return findings_of(scanned(line(*ALONG_X, 2 * R)))


def far_away() -> Sequence[Finding]:
    """Four noisy views from 0.6 m do not show whether a string of 100 mm is round."""
    camera = replace(camera_model("ideal"), working_m=(0.6, 0.62))
    scene = StringScene("codes", R, (line((-0.05, 0), (0.05, 0)),))
    return findings_of(simulate(scene, camera, 3, errors=NO_ERRORS, views=4))


def with_radius(r: float) -> Callable[[], Sequence[Finding]]:
    return lambda: findings_of(one_string(), r)


def moved_before_the_last_view() -> Sequence[Finding]:
    other = scanned(line((-0.1, 0.03), (0.1, 0.03)))
    return findings_of(one_string(), views=with_view(one_string(), -1, lambda _: other.views[-1]))


def drifted() -> Sequence[Finding]:
    """The camera is 4 mm from its calibrated pose in the flange."""
    T_error = from_rotation_vector((0.004, 0, 0), (0, 0, 0))
    scan = scanned(line(*ALONG_X), line((0.01, -0.1), (0.01, 0.1), 3 * R))
    return findings_of(
        scan, views=[replace(view, T_flange_camera=view.T_flange_camera @ T_error) for view in scan.views]
    )


def lower_table(distance_m: float) -> Callable[[], Sequence[Finding]]:
    """Return a function that returns the findings of a scan of a table that is lower than given."""

    def provoke() -> Sequence[Finding]:
        T_base_table = from_rotation_vector((0, 0, -distance_m), (0, 0, 0))
        scene = StringScene("codes", R, (line(*ALONG_X),))
        camera = camera_model("exact", (320, 200))
        return findings_of(simulate(scene, camera, 1, errors=NO_ERRORS, views=6, T_base_table=T_base_table))

    return provoke


# --- pieces and surface in no chain ---


@cache
def sunk(length_m: float, height_radii: float) -> Sequence[Finding]:
    """A string, and another one in a groove of the table: hardly any of its surface is seen."""
    half = length_m / 2
    return findings_of(scanned(line(*ALONG_X), line((-half, 0.05), (half, 0.05), height_radii * R)))


def seen_by_one_view() -> Sequence[Finding]:
    """A string, and a piece of 120 mm of which only the first view measured one side."""
    scan = scanned(line(*ALONG_X), line((-0.06, 0.05), (0.06, 0.05)))
    first, *others = scan.views
    return findings_of(scan, views=[without_piece(first, 0.049), *(without_piece(view, 0.07) for view in others)])


def without_piece(view: View, to_y_m: float) -> View:
    """Return a view without depth from y = 0.03 m to a line beside or on the piece along y = 0.05 m."""
    rows, columns = np.nonzero(view.depth)
    x, y, _ = deproject(view, rows, columns).T
    is_lost = (np.abs(x) < 0.08) & (y > 0.03) & (y < to_y_m)
    depth = view.depth.copy()
    depth[rows[is_lost], columns[is_lost]] = 0
    return replace(view, depth=depth)


@cache
def many_short_pieces() -> Sequence[Finding]:
    """A string, and 13 pieces of 30 mm."""
    corners = [(-0.1 + 0.05 * (k % 5), 0.03 + 0.025 * (k // 5)) for k in range(13)]
    return findings_of(scanned(line(*ALONG_X), *(line((x, y), (x + 0.03, y)) for x, y in corners)))


def in_the_table() -> Sequence[Finding]:
    """A fitted strand whose tube reaches into the table, as the edge of a leaning plate."""
    points = line((0, 0), (0.1, 0), 0.5 * R)[::3]
    n = len(points)
    strand = FittedStrand(points, False, np.zeros(n, dtype=bool), np.full(n, 40.0), R, R, 0.0, 0.0, 0.05)
    refinement = Refinement([strand], np.zeros(n, dtype=np.int64), 0.0002)
    face = [points + (0, offset, R) for offset in np.arange(2.1 * R, 3 * R, 0.001)]
    surface = np.vstack([points + (0, 0, R), *face])
    refinement = replace(refinement, strand_of_point=np.where(np.arange(len(surface)) < n, 0, -1))
    return classify_strings(refinement, surface, ChainParameters.for_radius(R)).findings


# --- views ---


def excluded(change: Callable[[View], View]) -> Callable[[], Sequence[Finding]]:
    """Return a function that returns the findings of a scan with its view 2 changed."""
    return lambda: findings_of(one_string(), views=with_view(one_string(), 2, change))


def crowded() -> Sequence[Finding]:
    """In the whole workspace, a plane in fine pixels has more than 100,000 points at the resolution for r = 3 mm."""
    views = with_view(one_string(), 2, lambda view: of_plane(view, 0.05, finer=4))
    return findings_of(one_string(), r=0.003, views=views, half_m=None)


def contradicting() -> Sequence[Finding]:
    other = scanned(line((-0.1, 0.03), (0.1, 0.03)))
    return findings_of(one_string(), views=with_view(one_string(), 2, lambda _: other.views[2]))


def wrong_pose() -> Sequence[Finding]:
    """The arm was 4 mm higher than it reported."""
    T_error = from_rotation_vector((0, 0, 0.004), (0, 0, 0))
    return findings_of(
        loop(), views=with_view(loop(), 2, lambda view: replace(view, T_base_flange=T_error @ view.T_base_flange))
    )


def without_table() -> Sequence[Finding]:
    """The only view has depth on a strip of the table, 50 mm wide, which does not determine the tilt."""
    view = one_string().views[0]
    v, u = np.indices(view.depth.shape)
    points = deproject(view, v.ravel(), u.ravel()).reshape(*view.depth.shape, 3)
    depth = np.where(np.abs(points[..., 1]) < 0.025, view.depth, 0).astype(np.uint16)
    return findings_of(one_string(), views=[replace(view, depth=depth)])


PROVOCATIONS: dict[FindingCode, Callable[[], Sequence[Finding]]] = {
    "sharp-bend": bend(-0.03),
    "tight-bend": bend(0.04),
    "connection-uncertain": hidden_junction,
    "crossing-undecided": flat_crossing,
    "upper-strand-unseen": unseen_upper_strand,
    "ends-touching": facing_ends,
    "possible-branch": lambda: findings_of(scanned(line(*ALONG_X), line((0, 0), (0, 0.1)))),
    "end-unobserved": string_into_box,
    "possible-bar": far_away,
    "possible-rod": with_radius(0.0036),
    "possible-object": string_along_box,
    "above-table": raised,
    "radius-much-smaller": with_radius(0.006),
    "radius-uncertain": lambda: findings_of(one_string(), r=None, views=with_pixel_locking(one_string().views)),
    "possible-string": lambda: sunk(0.2, 0.4),
    "string-of-other-radius": with_radius(0.009),
    "table-not-covered": lambda: findings_of(one_string(), half_m=0.6),
    "scene-changed": moved_before_the_last_view,
    "calibration-drift": drifted,
    "table-elsewhere": lower_table(0.006),
    "depth-noise": lambda: findings_of(one_string(), views=with_noisy_table(one_string(), 0.003)),
    "end-at-border": lambda: findings_of(one_string(), half_m=0.0985),
    "radius-smaller": with_radius(0.005),
    "radius-larger": with_radius(0.0036),
    "no-grasp": lambda: findings_of(one_string(), gripper=Gripper(stroke_m=0.008)),
    "low-objects-hidden": lambda: findings_of(one_string(), views=with_noisy_table(one_string(), 0.001)),
    "no-trusted-grasp": raised,
    "no-string-in-view": lambda: findings_of(one_string(), views=[of_plane(view, 0.0) for view in one_string().views]),
    "no-string-found": lambda: findings_of(scanned(boxes=[Box((0, 0), (0.08, 0.05, 0.02), 0.2)])),
    "piece-too-short": many_short_pieces,
    "piece-hardly-seen": seen_by_one_view,
    "piece-not-round": string_into_box,
    "piece-in-table": in_the_table,
    "piece-upright": post_beside_string,
    "more-pieces": many_short_pieces,
    "unexplained-surface": many_short_pieces,
    "more-unexplained-surface": many_short_pieces,
    "single-view-not-aligned": without_table,
    "single-view": lambda: findings_of(one_string(), views=one_string().views[:1]),
    "table-uncertain": lower_table(0.0018),
    "depth-warp": lambda: findings_of(one_string(), views=with_curved_depth(one_string())),
    "stereo-depth-corrected": lambda: findings_of(one_string(), views=with_pixel_locking(one_string().views)),
    "view-without-depth": excluded(with_depth(0)),
    "view-outside-workspace": excluded(with_depth(60000)),
    "view-stuck": excluded(lambda view: with_depth(int(np.median(view.depth)) - 20)(view)),
    "view-without-string": excluded(lambda view: of_plane(view, 0.0)),
    "view-crowded": crowded,
    "view-noisy": lambda: findings_of(
        one_string(), views=with_view(one_string(), 2, lambda _: with_noisy_table(one_string(), 0.007, block=4)[2])
    ),
    "view-contradicting": contradicting,
    "view-pose-error": wrong_pose,
}
"""A function for each code whose findings include one with this code."""


@dataclass(frozen=True)
class Expected:
    """What findings with a code have."""

    members: frozenset[str] = frozenset()
    """Members of the document apart from the code, the severity and the message."""
    sense: Literal["above", "below", None] = None
    """Side of the limit on which the value lies. None: the finding has no limit."""
    sometimes: frozenset[str] = frozenset()
    """Members that only some of the findings have."""


def has(members: str, sense: Literal["above", "below", None] = None, sometimes: str = "") -> Expected:
    names = {"part": "s_range_m", "point": "point_m"}
    return Expected(frozenset(names.get(name, name) for name in members.split()), sense, frozenset(sometimes.split()))


EXPECTED: dict[FindingCode, Expected] = {
    "sharp-bend": has("chains part point value limit", "above"),
    "tight-bend": has("chains part point value limit", "above"),
    "connection-uncertain": has("chains part point value limit", "below"),
    "crossing-undecided": has("chains crossing point value limit", "below"),
    "upper-strand-unseen": has("chains crossing point value limit", "below"),
    "ends-touching": has("chains end part point value limit", "below"),
    "possible-branch": has("chains part point value limit", "below", sometimes="end"),
    "end-unobserved": has("chains end part point"),
    "possible-bar": has("chains point value limit", "above"),
    "possible-rod": has("chains point value"),
    "possible-object": has("chains point value limit", "above"),
    "above-table": has("chains value limit", "above"),
    "radius-much-smaller": has("chains value limit", "below"),
    "radius-uncertain": has("chains value"),
    "possible-string": has("point value"),
    "string-of-other-radius": has("point value limit", "below"),
    "table-not-covered": has("value limit", "above"),
    "scene-changed": has("chains view"),
    "calibration-drift": has("chains value limit", "above"),
    "table-elsewhere": has("chains value limit", "above"),
    "depth-noise": has("value limit", "above"),
    "end-at-border": has("chains end part point"),
    "radius-smaller": has("chains value limit", "below"),
    "radius-larger": has("chains value limit", "above"),
    "no-grasp": has("chains"),
    "no-trusted-grasp": has("chains value"),
    "low-objects-hidden": has("value limit", "above"),
    "no-string-in-view": has(""),
    "no-string-found": has(""),
    "piece-too-short": has("point value"),
    "piece-hardly-seen": has("point value"),
    "piece-not-round": has("point value"),
    "piece-in-table": has("point value"),
    "piece-upright": has("point value"),
    "more-pieces": has("point value"),
    "unexplained-surface": has("point value limit", "above"),
    "more-unexplained-surface": has("point value"),
    "single-view-not-aligned": has("chains view"),
    "table-uncertain": has("value limit", "above"),
    "single-view": has("view"),
    "depth-warp": has("value limit", "above"),
    "stereo-depth-corrected": has("value"),
    "view-without-depth": has("view"),
    "view-outside-workspace": has("view"),
    "view-stuck": has("view"),
    "view-without-string": has("view"),
    "view-crowded": has("view"),
    "view-noisy": has("view"),
    "view-contradicting": has("view"),
    "view-pose-error": has("view"),
}


def test_each_code_of_the_table_is_provoked() -> None:
    assert set(PROVOCATIONS) == set(EXPECTED) == set(FINDING_TYPES) - MADE_ELSEWHERE


@pytest.mark.parametrize("code", PROVOCATIONS)
def test_a_provoked_finding_has_its_severity_and_the_members_that_a_program_needs(code: FindingCode) -> None:
    matching = [found for found in PROVOCATIONS[code]() if found.code == code]
    assert matching, "the code does not occur"
    expected = EXPECTED[code]
    documents = [finding_json(found) for found in matching]
    for member in expected.sometimes:
        assert {member in document for document in documents} == {True, False}
    for found, document in zip(matching, documents, strict=True):
        assert found.severity == FINDING_TYPES[code].severity
        assert set(document) - expected.sometimes == {"code", "severity", "message"} | expected.members
        assert all(np.isfinite(number) for number in (*document.get("point_m", ()), *document.get("s_range_m", ())))
        if found.value is not None:
            assert found.value > 0
        if expected.sense is not None:
            assert found.value is not None
            assert found.limit is not None
            assert found.value > found.limit if expected.sense == "above" else found.value < found.limit


@pytest.mark.parametrize("code", EXPECTED)
def test_the_members_agree_with_the_table(code: FindingCode) -> None:
    members, described = EXPECTED[code].members, FINDING_TYPES[code]
    assert ("value" in members) == (described.value is not None)
    assert ("limit" in members) == (EXPECTED[code].sense is not None)
    if described.scope == "model":
        assert not members & {"chains", "crossing", "end", "s_range_m"}
    elif described.scope == "chain":
        assert "chains" in members
        assert not members & {"crossing", "end", "s_range_m"}
    elif described.scope == "part":
        assert {"chains", "s_range_m"} <= members
    elif described.scope == "crossing":
        assert {"chains", "crossing"} <= members
        assert "s_range_m" not in members


# --- where they are ---


def only(findings: Sequence[Finding], code: str) -> Finding:
    (found,) = (found for found in findings if found.code == code)
    return found


def test_the_excluded_view_is_named() -> None:
    for code, provoke in PROVOCATIONS.items():
        if code.startswith("view-"):
            assert only(provoke(), code).view == 2
    found = only(moved_before_the_last_view(), "scene-changed")
    assert (found.view, found.chains) == (5, (0,))


def test_positions_are_those_of_the_scene() -> None:
    """Positions of chains and pieces are accurate to a millimetre, and those of hidden parts to a radius."""
    crossing = only(flat_crossing(), "crossing-undecided")
    assert crossing.point_m == pytest.approx((0.01, 0.0, 1.1 * R), abs=0.001)
    end = only(string_into_box(), "end-unobserved")
    assert (end.chains, end.end) == ((0,), "last")
    assert end.point_m == pytest.approx((0.0, 0.0, R), abs=R)
    assert only(raised(), "above-table").value == pytest.approx(R, abs=0.001)
    piece = only(seen_by_one_view(), "piece-hardly-seen")
    assert piece.point_m is not None
    # A third of it is missed, because a single view of one side is only just enough for a fragment.
    assert piece.value == pytest.approx(0.1, abs=0.03)
    assert piece.point_m[:2] == pytest.approx((0.0, 0.05), abs=0.03)


def test_more_pieces_are_counted_and_not_lost() -> None:
    findings = many_short_pieces()
    for listed, further in (("piece-too-short", "more-pieces"), ("unexplained-surface", "more-unexplained-surface")):
        assert sum(found.code == listed for found in findings) + (only(findings, further).value or 0) == 13


def test_pixel_locking_is_a_note_with_and_without_a_string() -> None:
    without_string = [of_plane(view, 0.0) for view in one_string().views]
    for captured in (one_string().views, without_string):
        note = only(findings_of(one_string(), views=with_pixel_locking(captured)), "stereo-depth-corrected")
        depth_m = np.median([view.depth[view.depth > 0] * view.depth_unit_m for view in without_string])
        # A tenth of a disparity, 1/30 per metre. The table in the workspace is up to a tenth farther than all of it.
        assert note.value == pytest.approx(0.1 / 30 * depth_m**2, rel=0.3)


def test_only_a_radius_that_was_measured_in_matched_depth_is_uncertain() -> None:
    matched = with_pixel_locking(one_string().views)
    doubt = only(findings_of(one_string(), r=None, views=matched), "radius-uncertain")
    # Without windows, half height and half width of a band are the radius, to a tenth in coarse pixels.
    assert doubt.value == pytest.approx(R, rel=0.1)
    for findings in (findings_of(one_string(), views=matched), findings_of(one_string(), r=None)):
        assert not any(found.code == "radius-uncertain" for found in findings)


def test_the_measured_radius_is_the_value() -> None:
    for code in ("radius-much-smaller", "radius-smaller", "radius-larger"):
        # Measured on a string without noise, to 2 %.
        assert only(PROVOCATIONS[code](), code).value == pytest.approx(R, rel=0.02)
