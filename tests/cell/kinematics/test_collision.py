import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.config.arm_config import ArmModelName, SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings, MountingSettings
from cell.kinematics.collision import CollisionModel, collision_model
from cell.kinematics.ur_kinematics import forward

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
        ((0, -90, 170, -90, -90, 0), "the upper arm comes too near the wrist 2"),
        ((0, -150, 20, 20, -160, 0), "the forearm comes too near the wrist 3"),
        ((0, -10, -170, -10, -90, 0), "the upper arm comes too near the wrist 1"),
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


def test_everything_outside_the_workspace_is_solid() -> None:
    collisions = cell(obstacles=(((0.3, 0.3, 0.0), (0.5, 0.5, 0.6)),))
    assert [words for words, solid in zip(collisions.contacts, collisions.solid, strict=True) if not solid] == [
        words for words in collisions.contacts if words.endswith("the workspace")
    ]
