"""The camera in its child process: a simulated camera with the flange pose in a file, and a missing real camera."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from cell.camera.camera import LiveCamera, MakeDriver
from cell.camera.frame_averaging import NoFramesError
from cell.camera.oak_device import open_device
from cell.camera.oak_driver import OakDriver
from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import OakCamera, SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.control.equipment import Equipment
from cell.errors import BadFrameError, CameraLostError, CameraUnreachableError
from cell.kinematics.ur_kinematics import inverse as inverse_kinematics
from cell.planning.look_at import look_at
from cell.simulation.devices.flange_pose import PoseSource, controller_pose
from cell.simulation.devices.frame_source import FrameSource
from cell.simulation.devices.oak_pipeline import open_simulated
from cell.simulation.devices.world import SimulatedWorld, simulated_world
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.ur_controller.launcher import start_controller
from tests.cell.arm.virtual_arm import thread_of, until
from tests.cell.camera.flange_file import FlangeFile, flange_file
from tests.cell.loopback import free_host

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

SETTINGS = SimulatedCamera(model="exact", errors=0.0, scene="straight", fps=50.0)


SOON_S = 3.0
"""Promised limit of the time until a missing camera is reported, seconds."""


def small_world() -> SimulatedWorld:
    world = simulated_world(CellSettings(camera=SETTINGS))
    return replace(world, camera=camera_model("exact", (160, 100)))


def looking_down(world: SimulatedWorld, azimuth_rad: float = 0.0) -> NDArray[np.float64]:
    return look_at(world.T_base_scene[:3, 3], azimuth_rad, 1.2, 0.4, 0.1) @ inverse(world.T_flange_camera)


def runs(pid: int | None) -> bool:
    """Return whether the process exists, also as a zombie."""
    return pid is not None and Path(f"/proc/{pid}").exists()


def ask_until_lost(camera: LiveCamera) -> None:
    """Query the camera repeatedly, so that a lost camera raises its error."""
    for _ in range(100):
        camera.info()
        time.sleep(0.1)


@pytest.fixture(scope="module")
def world() -> SimulatedWorld:
    return small_world()


@pytest.fixture(scope="module")
def flange(tmp_path_factory: pytest.TempPathFactory, world: SimulatedWorld) -> FlangeFile:
    flange = FlangeFile(tmp_path_factory.mktemp("flange") / "T_base_flange.npz")
    flange.write(looking_down(world))
    return flange


def simulated_camera(world: SimulatedWorld, prepare_pose: Callable[[], Callable[[], PoseSource]]) -> LiveCamera:
    """Return a camera of the world. `prepare_pose` is called at connecting and returns a factory of the pose source."""

    def prepare_driver() -> MakeDriver:
        return partial(OakDriver, SETTINGS, partial(open_simulated, SETTINGS, world, prepare_pose()))

    return LiveCamera(SETTINGS, prepare_driver, 60.0)


@pytest.fixture(scope="module")
def one_camera(world: SimulatedWorld, flange: FlangeFile) -> Iterator[LiveCamera]:
    camera = simulated_camera(world, lambda: partial(flange_file, str(flange.path)))
    yield camera
    camera.close()


@pytest.fixture
def camera(one_camera: LiveCamera, world: SimulatedWorld, flange: FlangeFile) -> LiveCamera:
    """Return the shared camera, connected and without a fault. Connecting takes seconds."""
    flange.write(looking_down(world))
    if not one_camera.connected:
        one_camera.connect()
    one_camera.fault("none")
    return one_camera


def test_the_camera_returns_its_description(camera: LiveCamera, world: SimulatedWorld) -> None:
    info = camera.info()
    assert (info.product, info.device_id) == ("simulated exact", world.camera_id)
    assert (info.width, info.height, info.connection, info.warnings) == (160, 100, "simulated", ())


def test_a_capture_shows_the_scene_from_the_pose_at_rest(
    camera: LiveCamera, world: SimulatedWorld, flange: FlangeFile
) -> None:
    after_s = time.monotonic() + 0.5
    flange.write(looking_down(world, 0.7), at_s=after_s)
    frame = camera.capture(after_s)
    answered_s = time.time()
    # The model is exact, so the median contains no exposure from before or from another pose.
    assert np.array_equal(frame.depth, FrameSource(world).render_depth(looking_down(world, 0.7)))
    assert frame.exposures == SETTINGS.exposures
    assert frame.depth_unit_m == camera.info().depth_unit_m == world.camera.depth_unit_m
    assert np.abs(frame.K - world.camera.K).max() < 1e-4
    # The last exposure began after `after_s`, and before the answer.
    assert answered_s - (time.monotonic() - after_s) - 0.01 < frame.stamp_s <= answered_s


def test_a_burst_has_every_exposure_also_after_the_process_has_died(camera: LiveCamera, world: SimulatedWorld) -> None:
    pid, after_s = camera.pid, time.monotonic()
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    burst = camera.burst(7, after_s)
    assert camera.pid != pid
    assert burst.depth.shape == (7, 100, 160)
    exact = FrameSource(world).render_depth(looking_down(world))
    assert all(np.array_equal(depth, exact) for depth in burst.depth)
    assert (burst.began_s > after_s).all()


@pytest.mark.parametrize(
    ("fault", "reason"),
    [("zero", "all zero"), ("constant", "same depth at all measured pixels"), ("stale", "its clock is wrong")],
)
def test_an_empty_frame_is_rejected_and_the_next_capture_succeeds(camera: LiveCamera, fault: str, reason: str) -> None:
    pid = camera.pid
    camera.fault(fault)  # pyright: ignore[reportArgumentType]
    with pytest.raises(BadFrameError, match=reason):
        camera.capture(time.monotonic())
    camera.fault("none")
    assert camera.capture(time.monotonic()).depth.any()
    # The camera was not connected again.
    assert camera.pid == pid


@pytest.mark.parametrize("fault", ["silent", "lost"])
def test_a_silent_or_disconnected_camera_is_connected_again(camera: LiveCamera, fault: str) -> None:
    pid = camera.pid
    camera.fault(fault)  # pyright: ignore[reportArgumentType]
    assert camera.capture(time.monotonic()).depth.any()
    assert camera.pid != pid
    assert not runs(pid)


def test_a_killed_camera_process_loses_no_view(camera: LiveCamera, world: SimulatedWorld) -> None:
    """The process is killed while it waits for the arm to settle. The capture succeeds with the same image."""
    pid = camera.pid
    assert pid is not None

    def kill_during_capture() -> None:
        child = camera._child
        assert child is not None
        while not child._turn.locked():
            time.sleep(0.001)
        os.kill(pid, signal.SIGKILL)

    threading.Thread(target=kill_during_capture).start()
    frame = camera.capture(time.monotonic() + 0.5)
    assert np.array_equal(frame.depth, FrameSource(world).render_depth(looking_down(world)))
    assert camera.connected
    assert camera.pid != pid
    assert not runs(pid)


def test_a_suspended_camera_process_is_detected_and_replaced(
    camera: LiveCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cell.camera.camera.ASK_S", 0.5)
    pid = camera.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    assert camera.capture(time.monotonic()).depth.any()
    assert not runs(pid)


def test_a_camera_that_cannot_be_connected_again_is_lost_until_the_next_capture(
    camera: LiveCamera, world: SimulatedWorld, flange: FlangeFile
) -> None:
    """After one retry the view is missing. The next capture tries again and succeeds."""
    assert camera.pid is not None
    flange.path.unlink()  # without a flange pose, the simulated camera cannot start
    os.kill(camera.pid, signal.SIGKILL)
    with pytest.raises(
        CameraLostError, match=r"has ended .exit code -9.*could not be connected again: .*read the flange pose"
    ):
        camera.capture(time.monotonic())
    assert not camera.connected
    assert camera.pid is None
    with pytest.raises(CameraLostError, match="not connected"):
        camera.info()
    flange.write(looking_down(world))
    assert camera.capture(time.monotonic()).depth.any()
    assert camera.connected


def test_a_camera_that_stays_silent_is_reported(camera: LiveCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera is not replaced here, because a test cannot silence a new process in time."""
    monkeypatch.setattr(camera, "_reopen", lambda: None)
    camera.fault("silent")
    with pytest.raises(NoFramesError, match=r"no frame for 2\.0 s"):
        camera.capture(time.monotonic())


def test_connecting_and_closing_leaks_nothing(camera: LiveCamera) -> None:
    def open_files() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    camera.capture(time.monotonic())
    before, threads = open_files(), threading.active_count()
    pids = [camera.pid]
    camera.connect()
    pids.append(camera.pid)
    assert camera.capture(time.monotonic()).depth.any()
    assert open_files() == before
    assert threading.active_count() == threads
    camera.close()
    assert len(set(pids)) == 2
    assert not any(runs(pid) for pid in pids)
    with pytest.raises(CameraLostError, match="not connected"):
        camera.capture(time.monotonic())


def test_the_camera_uses_the_flange_pose_of_the_virtual_controller(world: SimulatedWorld) -> None:
    controller = start_controller("ur5e")
    camera = simulated_camera(world, lambda: partial(controller_pose, controller.host))
    try:
        controller.admin.reset(q_rad=inverse_kinematics("ur5e", looking_down(world))[0])
        camera.connect()
        frame = camera.capture(time.monotonic())
        assert np.array_equal(frame.depth, FrameSource(world).render_depth(controller.admin.pose()))
        controller.close()
        # The process of the camera answers, but the camera is lost, so it counts as not connected.
        with pytest.raises(CameraLostError, match="lost the flange pose: no virtual controller answers"):
            ask_until_lost(camera)
        assert not camera.connected
    finally:
        camera.close()
        controller.close()


def test_another_thread_can_cancel_the_connecting_of_a_camera(world: SimulatedWorld, flange: FlangeFile) -> None:
    """The process of the camera is suspended and would reach the timeout."""
    camera = simulated_camera(world, lambda: partial(flange_file, str(flange.path)))
    with thread_of(camera.connect) as result:
        until(lambda: camera.pid is not None, 5.0)
        assert camera.pid is not None
        os.kill(camera.pid, signal.SIGSTOP)
        cancelled_s = time.monotonic()
        camera.cancel_connecting()
    error, ended_s = result
    assert isinstance(error, CameraUnreachableError)
    assert "was cancelled" in str(error)
    assert ended_s - cancelled_s < 5.0  # the timeout is 60 s
    assert camera.pid is None
    # The cancel is permanent, because a camera that is connected later would not be closed.
    with pytest.raises(CameraUnreachableError, match="was cancelled"):
        camera.connect()
    assert camera.pid is None


def test_a_cancel_does_not_affect_a_connected_camera(world: SimulatedWorld, flange: FlangeFile) -> None:
    flange.write(looking_down(world))
    camera = simulated_camera(world, lambda: partial(flange_file, str(flange.path)))
    try:
        camera.connect()
        camera.cancel_connecting()
        assert camera.capture(time.monotonic()).depth.any()
    finally:
        camera.close()


def test_cancelled_equipment_does_not_connect_its_camera() -> None:
    equipment = Equipment(CellSettings(arm=SimulatedArm(host=free_host()), camera=SETTINGS))
    try:
        equipment.cancel_connecting()
        with pytest.raises(CameraUnreachableError, match="was cancelled"):
            equipment.camera.connect()
    finally:
        equipment.close()


def test_a_simulated_camera_without_an_arm_is_reported(world: SimulatedWorld, tmp_path: Path) -> None:
    camera = simulated_camera(world, lambda: partial(flange_file, str(tmp_path / "none.npz")))
    with pytest.raises(CameraUnreachableError, match="cannot read the flange pose from the arm's controller"):
        camera.connect()
    assert camera.pid is None


@pytest.mark.parametrize(
    ("device", "words"),
    [
        (None, r"no OAK camera was found on USB: check its cable.*no other program.*udev rule for vendor 03e7"),
        ("127.0.0.99", r"the camera 127\.0\.0\.99 was not found: check its cable.*camera\.device"),
    ],
)
def test_a_missing_camera_is_reported_with_an_action(device: str | None, words: str) -> None:
    settings = OakCamera(kind="oak", device=device)
    camera = LiveCamera(settings, lambda: partial(OakDriver, settings, partial(open_device, settings)), 30.0)
    took_s = []
    while not took_s or (min(took_s) > SOON_S and len(took_s) < 4):  # a busy machine may start the process late
        begun_s = time.monotonic()
        with pytest.raises(CameraUnreachableError, match=words):
            camera.connect()
        took_s.append(time.monotonic() - begun_s)
        assert camera.pid is None
    assert min(took_s) <= SOON_S


def test_the_parent_process_does_not_import_the_vendor_library() -> None:
    script = """
import sys
from functools import partial
from cell.camera.camera import LiveCamera
from cell.camera.oak_device import open_device
from cell.camera.oak_driver import OakDriver
from cell.errors import CameraUnreachableError
from cell.config.camera_config import OakCamera
if __name__ == "__main__":
    try:
        settings = OakCamera(kind="oak")
        LiveCamera(settings, lambda: partial(OakDriver, settings, partial(open_device, settings)), 30.0).connect()
    except CameraUnreachableError:
        print([name for name in ("depthai", "open3d", "scipy") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


def test_a_picture_is_returned_and_an_empty_one_is_rejected(camera: LiveCamera, world: SimulatedWorld) -> None:
    frame = camera.capture(time.monotonic(), with_image=True)
    source = FrameSource(world)
    assert np.array_equal(frame.depth, source.render_depth(looking_down(world)))
    assert frame.image is not None
    truth = np.mean([source.render_intensity(looking_down(world)) for _ in range(20)], axis=0)
    # The noise of a mean of five pictures is at most 1.1 grey levels.
    assert np.abs(frame.image - truth).mean() < 1.1
    camera.fault("zero")
    with pytest.raises(BadFrameError, match="picture shows nothing"):
        camera.capture(time.monotonic(), with_image=True)
    camera.fault("none")
    assert camera.capture(time.monotonic()).image is None


def test_a_camera_that_was_connected_again_returns_the_picture(camera: LiveCamera) -> None:
    camera.fault("lost")
    assert camera.capture(time.monotonic(), with_image=True).image is not None
