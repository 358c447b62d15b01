"""Ends that may be joined to the side of a strand."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.planning.look_at import look_at
from cell.simulation.cases import make_case, simulate
from cell.simulation.evaluation.metrics import score
from cell.simulation.rendering.depth_camera import DepthCamera, camera_model
from cell.simulation.scenes.scenes import StringScene
from recognition.assembly.branches import MAX_GAP_RADII, mark_branches
from recognition.assembly.chain_ends import END_PART_RADII, mark_touching_ends
from recognition.model.chains import Chain, End
from recognition.pipeline import recognise
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest

R = 0.0042
FREE: tuple[End, End] = ("free", "free")


@dataclass(frozen=True, eq=False)
class Image:
    """A depth image, as recognition reads it."""

    depth: NDArray[np.uint16]
    depth_unit_m: float
    K: NDArray[np.float64]
    T_base_camera: NDArray[np.float64]
    index: int


def line(start: tuple[float, float], end: tuple[float, float], z: float = R) -> NDArray[np.float64]:
    a, b = np.array([*start, z]), np.array([*end, z])
    return np.linspace(a, b, round(float(np.linalg.norm(b - a)) / 0.003) + 1)


def chain(number: int, points: NDArray[np.float64], ends: tuple[End, End] = FREE, closed: bool = False) -> Chain:
    n = len(points)
    return Chain(number, closed, R, points, np.full(n, 1e-4), np.full(n, 8), ends)


def captured(*curves: NDArray[np.float64]) -> list[NormalCloud]:
    """Return six views of strings without noise."""
    camera = DepthCamera(camera_model("exact"), StringScene("hand-made", R, curves))
    clouds = []
    for k in range(6):
        T = look_at(np.zeros(3), np.radians(60 * k), np.radians(50), 0.5, 0.0)
        depth = camera.capture(T, np.random.default_rng(k))
        image = Image(depth, camera.model.depth_unit_m, camera.model.K, T, k)
        clouds.append(NormalCloud(k, np.empty((0, 3)), np.empty((0, 3)), np.eye(4), T, image))
    return clouds


TRUNK = chain(0, line((-0.1, 0), (0.1, 0)))


def branch(gap_m: float, angle_deg: float = 90, z: float = R, ends: tuple[End, End] = FREE) -> Chain:
    """Return a chain whose first end is `gap_m` before the side of the trunk at x = 0, along its own axis."""
    angle = np.radians(angle_deg)
    direction = np.array([np.cos(angle), np.sin(angle)])
    near = (R / np.sin(angle) + gap_m) * direction
    return chain(1, line((near[0], near[1]), tuple(near + 0.1 * direction), z), ends)


@pytest.mark.parametrize("angle_deg", [40, 65, 90])
@pytest.mark.parametrize("gap_radii", [0.0, 0.5, 1.5])
def test_an_end_before_a_side_may_be_joined(angle_deg: float, gap_radii: float) -> None:
    (trunk, found), findings = mark_branches([TRUNK, branch(gap_radii * R, angle_deg)], [])
    assert (trunk.ends, found.ends) == (FREE, ("touching", "free"))
    assert [(one.code, one.severity, one.chains) for one in findings] == [
        ("possible-branch", "doubt", (1,)),
        ("possible-branch", "doubt", (0,)),
    ]
    # the doubt about the trunk concerns its side, and so no end
    assert [one.end for one in findings] == ["first", None]
    part = END_PART_RADII * R
    assert findings[0].s_range_m == pytest.approx((0.0, part))
    middle = 0.1 + R / np.tan(np.radians(angle_deg))
    assert findings[1].s_range_m == pytest.approx((middle - part, middle + part), abs=0.3 * R)
    for one in findings:
        assert one.value == pytest.approx(R + gap_radii * R * np.sin(np.radians(angle_deg)), abs=0.1 * R)
        assert one.limit == pytest.approx(R + MAX_GAP_RADII * R)
        assert one.point_m is not None
        assert one.point_m[1] == pytest.approx(R, abs=0.3 * R)
        assert "the first end of chain 1 meets the side of chain 0" in one.message


def test_the_last_end_and_an_unobserved_end() -> None:
    other = branch(0.0, ends=("unobserved", "free"))
    turned = chain(1, other.points[::-1])
    (_, found), findings = mark_branches([TRUNK, turned], [])
    assert found.ends == ("free", "touching")
    assert [one.end for one in findings] == ["last", None]
    (_, found), findings = mark_branches([TRUNK, other], [])
    assert (found.ends, len(findings)) == (("unobserved", "free"), 2)


@pytest.mark.parametrize(
    "other",
    [
        branch(3.2 * R),  # too far away
        branch(0.0, z=3 * R),  # on top of the trunk
        branch(0.0, z=2.3 * R),  # pressed onto it
        chain(1, line((0, 2 * R), (0.08, 2 * R))),  # parallel, side by side
        chain(1, line((0.05, 0.1), (0.05, 0.05))),
    ],
)
def test_other_ends_are_free(other: Chain) -> None:
    chains, findings = mark_branches([TRUNK, other], [])
    assert [one.ends for one in chains] == [FREE, FREE]
    assert findings == []


def test_an_end_at_its_own_side() -> None:
    turn = np.radians(np.arange(-90, 185, 4))
    loop = np.column_stack([0.03 * np.cos(turn), 0.03 + 0.03 * np.sin(turn), np.full_like(turn, R)])
    down = line((-0.03, 0.026), (-0.03, 0.001 + R))
    own = chain(0, np.vstack([line((-0.15, 0), (-0.002, 0)), loop, down]))
    (found,), findings = mark_branches([own], [])
    assert found.ends == ("free", "touching")
    assert [one.chains for one in findings] == [(0,), (0,)]
    assert findings[1].s_range_m == pytest.approx((0.12 - END_PART_RADII * R, 0.12 + END_PART_RADII * R), abs=0.3 * R)
    assert "meets its own side" in findings[0].message


def test_a_gap_that_the_images_show_excludes_a_joint() -> None:
    other = branch(2 * R)
    apart = captured(TRUNK.points, other.points)
    joined = captured(TRUNK.points, branch(-R).points)
    assert mark_branches([TRUNK, other], apart)[1] == []
    assert len(mark_branches([TRUNK, branch(0.3 * R)], joined)[1]) == 2


def test_ends_with_a_visible_gap_between_them_are_not_touching() -> None:
    halves = [chain(0, line((-0.1, 0), (-0.7 * R, 0))), chain(1, line((0.7 * R, 0), (0.1, 0)))]
    assert len(mark_touching_ends(halves)[1]) == 2
    chains, findings = mark_touching_ends(halves, captured(*(half.points for half in halves)))
    assert ([one.ends for one in chains], findings) == ([FREE, FREE], [])
    whole = captured(line((-0.1, 0), (0.1, 0)))
    assert len(mark_touching_ends(halves, whole)[1]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3, 5])
def test_each_joint_of_a_harness_has_a_doubt(seed: int) -> None:
    case = make_case("branches", seed, "ideal")
    scan = simulate(case)
    model = recognise(
        scan.views, RecognitionRequest(radius_m=case.scene.radius_m), Scene(workspace_m=scan.header.workspace_m)
    ).model
    assert score(model.to_json(), scan.truth).topology
    doubts = [found for found in model.quality.doubts if found.code == "possible-branch"]
    for curve in case.scene.curves[1:]:
        near = [found for found in doubts if np.linalg.norm(found.point_m - curve[0]) < 3.5 * case.scene.radius_m]
        assert len({found.chains for found in near}) == 2
    assert sum(end == "touching" for one in model.chains for end in one.ends) == len(case.scene.curves) - 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 4, 6, 17, 23])
def test_ends_near_other_strands_are_right_and_free(seed: int) -> None:
    # End to end, beyond a strand under it, beside a strand, and at the own side.
    case = make_case("ends", seed, "ideal")
    scan = simulate(case)
    model = recognise(
        scan.views, RecognitionRequest(radius_m=case.scene.radius_m), Scene(workspace_m=scan.header.workspace_m)
    ).model
    assert score(model.to_json(), scan.truth).topology
    assert all("unobserved" not in one.ends for one in model.chains)
