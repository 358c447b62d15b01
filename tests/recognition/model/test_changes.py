"""Comparison of two models: the chains are matched by length, radius, place and shape."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.geometry.polyline import points_at
from recognition.model.chains import Chain, End
from recognition.model.changes import compare_chains
from recognition.model.model import PointChainModel
from recognition.pipeline import recognise
from recognition.preprocessing import Scene
from recognition.request import RecognitionRequest

R = 0.0042


def curve(length_m: float = 0.3, bend: float = 1.0, y: float = 0.0) -> np.ndarray:
    """Return an asymmetric curve of `length_m` that turns by `bend` rad, more and more."""
    s = np.linspace(0, 1, 101)
    heading = bend * s**2
    step = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(s))])[:-1] * length_m / 100
    return np.vstack([np.zeros(3), np.cumsum(step, axis=0)]) + (0, y, R)


def chain(
    number: int,
    points: np.ndarray,
    radius_m: float = R,
    closed: bool = False,
    ends: tuple[End, End] = ("free", "free"),
) -> Chain:
    count = len(points)
    return Chain(number, closed, radius_m, points, np.full(count, 0.0003), np.full(count, 8), ends)


def moved(points: np.ndarray, yaw: float, x: float, y: float) -> np.ndarray:
    """Return the points turned by `yaw` (rad) about the origin and shifted."""
    rotation = np.array([(np.cos(yaw), -np.sin(yaw), 0), (np.sin(yaw), np.cos(yaw), 0), (0, 0, 1)])
    return points @ rotation.T + (x, y, 0)


def noisy(points: np.ndarray, seed: int) -> np.ndarray:
    """Return the points with smooth errors of about 0.3 mm, as between two scans of one scene."""
    rng = np.random.default_rng(seed)
    phase, size = rng.uniform(0, 2 * np.pi, 3), rng.normal(0, 0.0003, 3)
    return points + size * np.sin(np.linspace(0, 6, len(points))[:, None] + phase)


@pytest.mark.parametrize("seed", range(5))
def test_an_unmoved_string_is_unmoved(seed: int) -> None:
    (match,) = compare_chains([chain(0, curve())], [chain(7, noisy(curve(), seed))]).matches
    assert (match.before, match.chain, match.change, match.is_reversed) == (0, 7, "unmoved", False)
    np.testing.assert_array_equal(match.T_now_before, np.eye(4))
    # Three sigmas of the noise along each of the three axes.
    assert match.displacement_m < 3 * 0.0003 * np.sqrt(3)
    assert match.confidence > 0.99


@pytest.mark.parametrize("backwards", [False, True])
def test_the_motion_of_a_moved_string_is_found(backwards: bool) -> None:
    points = moved(curve(), 0.7, 0.05, -0.1)
    (match,) = compare_chains([chain(0, curve())], [chain(0, points[::-1] if backwards else points)]).matches
    assert (match.change, match.is_reversed) == ("moved", backwards)
    # The same points were moved, so only rounding and the sampling of the line remain.
    np.testing.assert_allclose(moved(curve(), 0.7, 0.05, -0.1), transformed(match.T_now_before, curve()), atol=1e-5)
    assert match.rms_m < 1e-5
    assert match.displacement_m > 0.1


def transformed(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ T[:3, :3].T + T[:3, 3]


def test_a_string_with_another_shape_is_deformed() -> None:
    (match,) = compare_chains([chain(0, curve(bend=0.5))], [chain(0, curve(bend=2.5, y=0.1))]).matches
    assert (match.change, match.before, match.chain) == ("deformed", 0, 0)
    assert match.rms_m > R


def test_length_and_radius_tell_strings_apart() -> None:
    short, thick = chain(0, curve(0.2)), chain(1, curve(0.3, y=0.1), radius_m=0.006)
    now = [chain(0, moved(thick.points, 2.0, 0, 0), radius_m=0.006), chain(1, moved(short.points, -1.0, 0.1, 0))]
    changes = compare_chains([short, thick], now)
    assert [(match.before, match.chain, match.change) for match in changes.matches] == [
        (1, 0, "moved"),
        (0, 1, "moved"),
    ]
    assert min(match.confidence for match in changes.matches) > 0.99


def test_of_two_equal_strings_the_unmoved_one_is_told_by_its_place() -> None:
    first, second = curve(), curve(y=0.1)
    changes = compare_chains([chain(0, first), chain(1, second)], [chain(0, second), chain(1, moved(first, 1, 0.2, 0))])
    assert [(match.before, match.chain, match.change) for match in changes.matches] == [
        (1, 0, "unmoved"),
        (0, 1, "moved"),
    ]


def test_two_equal_strings_that_both_moved_cannot_be_told_apart() -> None:
    first, second = curve(), curve(y=0.1)
    now = [chain(0, moved(first, 1, 0.3, 0)), chain(1, moved(second, -1, 0.3, 0.3))]
    changes = compare_chains([chain(0, first), chain(1, second)], now)
    assert [match.confidence for match in changes.matches] == [pytest.approx(0.5, abs=0.2)] * 2


def test_new_and_gone_strings() -> None:
    stays, gone, new = curve(), curve(0.2, y=0.1), curve(0.5, y=-0.1)
    changes = compare_chains([chain(3, stays), chain(4, gone)], [chain(0, new), chain(1, stays)])
    assert (changes.new, changes.gone) == ((0,), (4,))
    (match,) = changes.matches
    assert (match.before, match.chain, match.change) == (3, 1, "unmoved")


@pytest.mark.parametrize(("before", "now"), [(0, 0), (0, 2), (2, 0)])
def test_models_without_chains(before: int, now: int) -> None:
    chains = [chain(k, curve(y=0.1 * k)) for k in range(2)]
    changes = compare_chains(chains[:before], chains[:now])
    assert changes.matches == ()
    assert (len(changes.gone), len(changes.new)) == (before, now)


def test_a_string_that_is_half_hidden_is_the_same_string() -> None:
    whole = curve()
    half = chain(0, points_at(whole, np.linspace(0, 0.18, 60)), ends=("free", "unobserved"))
    (match,) = compare_chains([chain(0, whole)], [half]).matches
    assert match.change == "unmoved"


def test_the_first_point_of_a_ring_may_change() -> None:
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    # An egg: a circle would look the same after any rotation.
    radius = 0.05 + 0.008 * np.cos(angle) + 0.004 * np.sin(2 * angle)
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(120, R)])
    before = chain(0, ring, closed=True)
    now = chain(0, np.roll(moved(ring, 0, 0.1, 0), -30, axis=0), closed=True)
    (match,) = compare_chains([before], [now]).matches
    assert (match.change, match.is_reversed) == ("moved", False)
    # The first point before is point 90 now. The comparison has 96 samples, so a third of a sample remains.
    assert match.s_offset_m == pytest.approx(now.arc_length_m[90], abs=now.length_m / 96)
    (other,) = compare_chains([before], [replace(now, points=now.points[::-1])]).matches
    assert other.is_reversed


def test_an_open_string_is_not_a_ring() -> None:
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    ring = np.column_stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), np.full(120, R)])
    changes = compare_chains([chain(0, ring, closed=True)], [chain(0, ring)])
    assert (changes.new, changes.gone, changes.matches) == ((0,), (0,), ())


@cache
def model(name: str, seed: int, more: tuple[tuple[str, int], ...] = ()) -> PointChainModel:
    scene = make_scene(name, 3, **dict(more))
    scan = simulate(scene, camera_model("ideal"), seed)
    return recognise(
        scan.views, RecognitionRequest(radius_m=scene.radius_m), Scene(workspace_m=scan.header.workspace_m)
    ).model


@pytest.mark.parametrize(
    ("name", "more"), [("overhand-knot", ()), ("ring", ()), ("tangle", (("strings", 3),)), ("mixed-radii", ())]
)
def test_scans_of_an_unmoved_scene(name: str, more: Sequence[tuple[str, int]]) -> None:
    """The scans have other noise and another hand-eye error (0.7 mm)."""
    before, now = model(name, 1, tuple(more)), model(name, 5, tuple(more))
    changes = now.since(before)
    assert (changes.new, changes.gone) == ((), ())
    assert [(match.before, match.change, match.is_reversed) for match in changes.matches] == [
        (chain.id, "unmoved", False) for chain in now.chains
    ]
    assert min(match.confidence for match in changes.matches) > 0.9
