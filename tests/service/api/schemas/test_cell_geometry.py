"""The JSON document of the cell's geometry."""

import httpx2
import numpy as np
from numpy.typing import NDArray

from cell.config.arm_config import SimulatedArm
from cell.config.cell_config import CellSettings, MountingSettings
from cell.kinematics.collision import PARTS, collision_model
from cell.kinematics.ur_kinematics import ARMS, link_frames
from service.api.schemas.cell_geometry import ArmGeometry, CellGeometry, cell_geometry
from service.config.loader import ServiceConfig
from tests.service.conftest import ServedClient

Q_RAD = np.array([0.3, -1.2, 1.3, -1.4, -1.5, 0.6])


def link_frames_of(arm: ArmGeometry, q_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the frames of the links, (7, 4, 4), from the document alone."""
    frames = [np.eye(4)]
    for q, d, a, alpha in zip(q_rad, arm.d_m, arm.a_m, arm.alpha_rad, strict=True):
        c, s, ca, sa = np.cos(q), np.sin(q), np.cos(alpha), np.sin(alpha)
        step = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        frames.append(frames[-1] @ np.array(step))
    return np.array(frames)


def test_the_geometry_is_returned_without_a_device(client: httpx2.Client) -> None:
    answer = client.get("/api/cell/geometry")
    assert answer.status_code == 200
    geometry = CellGeometry.model_validate_json(answer.content)
    settings = CellSettings()
    assert geometry.workspace_m == list(settings.workspace_m)
    assert geometry.scan.views == settings.scan.views
    assert geometry.hand_eye_max_age_days == settings.hand_eye.max_age_days
    assert geometry.camera.width == 640
    assert [capsule.name for capsule in geometry.arm.capsules][-1] == "camera"
    assert client.get("/api/cell").json()["state"] == "not_ready"
    assert client.get("/api/cell/geometry?x=1").status_code == 422


def test_the_arm_can_be_drawn_from_the_document() -> None:
    for model in ARMS:
        arm = cell_geometry(ServiceConfig(arm=SimulatedArm(model=model)), None).arm
        assert arm.model == model
        # the same product of the same matrices, rounded in another order
        np.testing.assert_allclose(link_frames_of(arm, Q_RAD), link_frames(model, Q_RAD[None])[0], rtol=0, atol=1e-12)
        for capsule in arm.capsules:
            assert all(0 <= frame <= 6 for frame in capsule.frames)
            assert 0.01 < capsule.radius_m < 0.2


def test_the_capsules_are_those_of_the_collision_check(client: ServedClient) -> None:
    """The capsules follow from the document alone, as in a browser."""
    geometry = CellGeometry.model_validate_json(client.get("/api/cell/geometry").content)
    frames = link_frames_of(geometry.arm, Q_RAD)
    calibration = client.app.state.context.cell.hand_eye()
    model = collision_model(client.app.state.context.config.cell, calibration.T_flange_camera)
    expected = link_frames(model.model, Q_RAD[None])[0][model.part_frames]
    ends = np.einsum("peij,pej->pei", expected[..., :3, :3], model.part_ends) + expected[..., :3, 3]
    assert [capsule.name for capsule in geometry.arm.capsules] == list(PARTS)
    for capsule, of_part, radius_m in zip(geometry.arm.capsules, ends, model.part_radii, strict=True):
        drawn = [
            frames[frame] @ np.array([*end, 1.0]) for frame, end in zip(capsule.frames, capsule.ends_m, strict=True)
        ]
        np.testing.assert_allclose(np.array(drawn)[:, :3], of_part, rtol=0, atol=1e-12)
        assert capsule.radius_m == radius_m


def test_without_a_calibration_the_shape_has_no_camera() -> None:
    parts = [capsule.name for capsule in cell_geometry(ServiceConfig(), None).arm.capsules]
    assert parts[-1] == "wrist 3"
    assert not any("camera" in part for part in parts)


def test_obstacles_have_their_lowest_and_highest_corner() -> None:
    corners = ((0.6, 0.2, 0.3), (0.5, 0.3, 0.0))
    mounting = MountingSettings(table_z_m=-0.02, obstacles_m=(corners,))
    geometry = cell_geometry(ServiceConfig(mounting=mounting), None)
    assert geometry.obstacles_m == [((0.5, 0.2, 0.0), (0.6, 0.3, 0.3))]
    assert geometry.table_z_m == -0.02
