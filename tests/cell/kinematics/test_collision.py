"""Distances of arm, camera and gripper from each other, the table and obstacles."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, transform_points
from cell.config.arm_config import ArmModelName, SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings, MountingSettings
from cell.config.gripper_config import GripperSettings
from cell.kinematics.collision import PARTS, CollisionModel, collision_model, grasp_collision_model
from cell.kinematics.ur_kinematics import forward
from recognition.grasping.gripper import Gripper, GripperBox
from recognition.grasping.gripper_presets import PRESETS, GripperPreset

T_FLANGE_CAMERA = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))
MODELS: tuple[ArmModelName, ...] = ("ur3e", "ur5e", "ur10e")
READY = np.deg2rad((0, -90, 90, -90, -90, 0))
Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def cell(model: ArmModelName = "ur5e", table_z_m: float = 0.0, obstacles: tuple[Box, ...] = ()) -> CollisionModel:
    return collision_model(
        CellSettings(
            arm=SimulatedArm(model=model),
            camera=SimulatedCamera(body_m=(0.1, 0.04, 0.04)),
            mounting=MountingSettings(table_z_m=table_z_m, obstacles_m=obstacles),
        ),
        T_FLANGE_CAMERA,
    )


def near_pairs(collisions: CollisionModel, degrees: tuple[float, ...]) -> list[str]:
    """Return the messages of all pairs that are too near at these joint angles."""
    gaps = collisions.gaps(np.deg2rad(degrees)[None])[0]
    return [words for words, short in zip(collisions.contacts, gaps - collisions.clearances, strict=True) if short < 0]


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    "degrees",
    [(0, -90, 90, -90, -90, 0), (0, -90, 0, -90, 0, 0), (30, -110, 100, -80, -90, 45), (180, -70, -100, -100, 90, 0)],
)
def test_usual_configurations_are_free(model: ArmModelName, degrees: tuple[float, ...]) -> None:
    assert near_pairs(cell(model), degrees) == []


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("degrees", "words"),
    [
        ((0, 20, 0, -90, -90, 0), "the elbow comes too near the table"),
        ((0, -20, 60, -90, -90, 0), "the camera comes too near the table"),
        ((0, -90, 170, -90, -90, 0), "the upper arm comes too near wrist 2"),
        ((0, -150, 20, 20, -160, 0), "the forearm comes too near wrist 3"),
        ((0, -10, -170, -10, -90, 0), "the upper arm comes too near wrist 1"),
    ],
)
def test_a_contact_is_named(model: ArmModelName, degrees: tuple[float, ...], words: str) -> None:
    assert words in near_pairs(cell(model), degrees)


@given(st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6).map(np.array), st.floats(-1.0, 0.1))
@settings(max_examples=40)
def test_the_distance_grows_as_the_table_is_lowered(q: NDArray[np.float64], table_z_m: float) -> None:
    near, far = cell(), cell(table_z_m=table_z_m)
    of_table = [k for k, words in enumerate(near.contacts) if words.endswith("the table")]
    difference = (far.gaps(q[None]) - near.gaps(q[None]))[0, of_table]
    assert difference == pytest.approx(np.full(len(of_table), -table_z_m), abs=1e-12)


@given(st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6).map(np.array), st.floats(-3.1, 3.1))
@settings(max_examples=40)
def test_a_rotation_of_the_base_keeps_the_self_distances(q: NDArray[np.float64], turn: float) -> None:
    collisions = cell()
    turned = q + np.array([turn, 0, 0, 0, 0, 0])
    own = [k for k, words in enumerate(collisions.contacts) if "obstacle" not in words and "workspace" not in words]
    one, other = collisions.gaps(np.array([q, turned]))[:, own]
    assert one == pytest.approx(other, abs=1e-9)


def test_a_box_touches_the_camera_only_if_it_is_near() -> None:
    eye = (forward("ur5e", READY) @ T_FLANGE_CAMERA)[:3, 3]

    def box(centre: NDArray[np.float64]) -> Box:
        low, high = (centre - 0.01).tolist(), (centre + 0.01).tolist()
        return (low[0], low[1], low[2]), (high[0], high[1], high[2])

    ready = tuple(np.rad2deg(READY))
    assert "the camera comes too near obstacle 1" in near_pairs(cell(obstacles=(box(eye),)), ready)
    # Corners in any order.
    low, high = box(eye)
    assert "the camera comes too near obstacle 1" in near_pairs(cell(obstacles=((high, low),)), ready)
    beside = eye + np.array([0.0, 0.0, -0.08])
    assert near_pairs(cell(obstacles=(box(beside), box(beside))), ready) == []
    # From the top of the box to the underside of the camera body, which is a nearly level capsule.
    collisions = cell(obstacles=(box(beside),))
    gap = collisions.gaps(READY[None])[0, collisions.contacts.index("the camera comes too near obstacle 1")]
    assert gap == pytest.approx(0.07 - 0.029, abs=0.006)


@given(st.tuples(*[st.floats(0.02, 0.2)] * 3))
@settings(deadline=None)
def test_the_capsule_contains_the_whole_camera_body(body_m: tuple[float, float, float]) -> None:
    collisions = collision_model(CellSettings(camera=SimulatedCamera(body_m=body_m)), np.eye(4))
    (a, b), radius = collisions.part_ends[-1], collisions.part_radii[-1]
    for corner in itertools.product(*((-size / 2, size / 2) for size in body_m)):
        nearest = np.clip(corner, np.minimum(a, b), np.maximum(a, b))  # the axis is along one side of the body
        assert np.linalg.norm(corner - nearest) <= radius + 1e-9


def test_a_part_inside_the_string_area_is_named() -> None:
    assert near_pairs(cell(), (180, -80, 130, -80, -40, 0)) == ["the camera reaches into the workspace"]


def test_a_batch_of_configurations_gives_the_single_results() -> None:
    collisions = cell(obstacles=(((0.3, 0.3, 0.0), (0.5, 0.5, 0.6)),))
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (40, 6))
    together = collisions.gaps(q)
    assert together.shape == (40, len(collisions.contacts))
    for k in range(len(q)):
        assert together[k] == pytest.approx(collisions.gaps(q[k : k + 1])[0], abs=1e-12)


GRIPPER = GripperSettings(length_m=0.174)
DOWN = np.deg2rad((180, -100, 110, -100, -90, 0))


def lowest_point(q: NDArray[np.float64], gripper: Gripper, opening_m: float | None = None) -> tuple[float, float]:
    """Return the heights of the lowest corner of the body and of the fingers, corner by corner."""
    T = forward("ur5e", q) @ from_rotation_vector((0, 0, 0), (0, 0, gripper.mounting_rotation_rad))
    fingers = gripper.fingers
    if opening_m is not None:
        wide = opening_m / 2 + gripper.finger_thickness_m
        fingers = GripperBox((-wide, *fingers.low_m[1:]), (wide, *fingers.high_m[1:]))
    body, tips = (
        min(
            transform_points(T, np.array([corner]))[0, 2]
            for box in boxes
            for corner in itertools.product(*zip(box.low_m, box.high_m, strict=True))
        )
        for boxes in (gripper.body, (fingers,))
    )
    return body, tips


@pytest.mark.parametrize("name", [*PRESETS, None])
@pytest.mark.parametrize("opening_m", [None, 0.012])
def test_the_gripper_is_as_high_above_the_table_as_its_lowest_corner(
    name: GripperPreset | None, opening_m: float | None
) -> None:
    gripper = replace(Gripper() if name is None else PRESETS[name], mounting_rotation_rad=0.6)
    collisions = grasp_collision_model(
        CellSettings(mounting=MountingSettings(table_z_m=-0.1)), T_FLANGE_CAMERA, gripper
    )
    for q in np.random.default_rng(2).uniform(-2.0, 2.0, (20, 6)):
        opening = None if opening_m is None else np.array([opening_m])
        found = collisions.gaps(q[None], opening)[0]
        body, tips = lowest_point(q, gripper, opening_m)
        near_table = [k for k, words in enumerate(collisions.contacts) if words.endswith("the table")]
        of_body = [k for k in near_table if collisions.contacts[k] == "the gripper comes too near the table"]
        assert found[of_body].min() == pytest.approx(body + 0.1, abs=1e-12)
        assert found[near_table[-1]] == pytest.approx(tips + 0.1, abs=1e-12)


def test_without_a_description_the_flange_is_bare() -> None:
    bare = collision_model(CellSettings(gripper=GripperSettings(stroke_m=0.05)), T_FLANGE_CAMERA)
    assert bare.parts == PARTS
    assert bare.gripper is None
    described = collision_model(CellSettings(gripper=GRIPPER), T_FLANGE_CAMERA)
    assert described.parts == (*PARTS, "gripper", "gripper's finger")
    # the contacts of arm and camera are the same
    known = dict(zip(described.contacts, described.gaps(DOWN[None])[0], strict=True))
    for words, gap in zip(bare.contacts, bare.gaps(DOWN[None])[0], strict=True):
        assert known[words] == pytest.approx(gap, abs=1e-12)


@pytest.mark.parametrize(
    ("degrees", "words"),
    [
        ((180, -90, 90, -20, -130, -110), "the forearm comes too near the gripper"),
        ((180, -80, 130, -20, -60, -100), "the upper arm comes too near the gripper"),
        ((180, -110, 130, -70, -90, 0), "the shoulder comes too near the gripper"),
        ((180, -60, 100, -60, -40, -60), "the gripper reaches into the workspace"),
        ((180, -40, 70, -140, -60, 80), "the gripper's finger comes too near the table"),
    ],
)
def test_a_contact_of_the_gripper_is_named(degrees: tuple[float, ...], words: str) -> None:
    collisions = collision_model(CellSettings(gripper=GRIPPER), T_FLANGE_CAMERA)
    assert near_pairs(collisions, degrees) == [words]


@pytest.mark.parametrize("name", [*PRESETS, None])
def test_the_capsules_contain_the_whole_gripper(name: GripperPreset | None) -> None:
    gripper = replace(Gripper() if name is None else PRESETS[name], mounting_rotation_rad=0.6)
    collisions = grasp_collision_model(CellSettings(), T_FLANGE_CAMERA, gripper)
    R = from_rotation_vector((0, 0, 0), (0, 0, 0.6))[:3, :3]
    shapes = zip((*gripper.body, gripper.fingers), collisions.part_ends[len(PARTS) :], strict=True)
    for (box, (a, b)), radius in zip(shapes, collisions.part_radii[len(PARTS) :], strict=True):
        for corner in itertools.product(*zip(box.low_m, box.high_m, strict=True)):
            share = np.clip((R @ corner - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0, 1)
            assert np.linalg.norm(R @ corner - a - share * (b - a)) <= radius + 1e-9


def test_points_are_as_near_as_the_nearest_capsule() -> None:
    collisions = cell()
    eye = (forward("ur5e", READY) @ T_FLANGE_CAMERA)[:3, 3]
    gaps = collisions.point_gaps(READY[None], np.array([eye, eye + 0.5]))
    assert gaps.shape == (1, len(PARTS))
    # the middle of the camera is inside its capsule by the radius
    assert gaps[0, -1] == pytest.approx(-collisions.part_radii[-1], abs=1e-9)
    assert gaps[0, 0] > 0.3


def test_everything_outside_the_workspace_is_solid() -> None:
    collisions = cell(obstacles=(((0.3, 0.3, 0.0), (0.5, 0.5, 0.6)),))
    assert [words for words, solid in zip(collisions.contacts, collisions.solid, strict=True) if not solid] == [
        words for words in collisions.contacts if words.endswith("the workspace")
    ]
