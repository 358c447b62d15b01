"""The camera in its child process: the simulated one, whose flange is where a file says, and a real one's absence."""

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

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

SETTINGS = SimulatedCamera(model="ideal", errors=0.0, scene="straight", fps=50.0)


SOON_S = 3.0
"""That there is no camera is told so soon: what is promised."""


def small_world() -> SimulatedWorld:
    world = simulated_world(CellSettings(camera=SETTINGS))
    return replace(world, camera=camera_model("ideal", (160, 100)))


def looking_down(world: SimulatedWorld, azimuth_rad: float = 0.0) -> NDArray[np.float64]:
    return look_at(world.T_base_scene[:3, 3], azimuth_rad, 1.2, 0.4, 0.1) @ inverse(world.T_flange_camera)


def runs(pid: int | None) -> bool:
    """Whether there is such a process, be it a zombie."""
    return pid is not None and Path(f"/proc/{pid}").exists()


def ask_until_lost(camera: LiveCamera) -> None:
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
    """A camera of the world; `prepare_pose` is called at connecting and gives what makes the source of poses."""

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
    """Connected and well; connecting takes seconds, so one serves all tests that leave it so."""
    flange.write(looking_down(world))
    if not one_camera.connected:
        one_camera.connect()
    one_camera.fault("none")
    return one_camera


def test_the_camera_tells_what_it_is(camera: LiveCamera, world: SimulatedWorld) -> None:
    info = camera.info()
    assert (info.product, info.device_id) == ("simulated ideal", world.camera_id)
    assert (info.width, info.height, info.connection, info.warnings) == (160, 100, "simulated", ())


def test_a_capture_shows_the_scene_from_where_the_arm_came_to_rest(
    camera: LiveCamera, world: SimulatedWorld, flange: FlangeFile
) -> None:
    after_s = time.monotonic() + 0.5
    flange.write(looking_down(world, 0.7), at_s=after_s)
    frame = camera.capture(after_s)
    asked_s = time.time()
    # The model is exact: no exposure of before, and none of another place, is in the median.
    assert np.array_equal(frame.depth, FrameSource(world).render_depth(looking_down(world, 0.7)))
    assert frame.exposures == SETTINGS.exposures
    assert frame.depth_unit_m == camera.info().depth_unit_m == world.camera.depth_unit_m
    assert np.abs(frame.K - world.camera.K).max() < 1e-4
    # The last exposure began after `after_s`, and before the answer.
    assert asked_s - (time.monotonic() - after_s) - 0.01 < frame.stamp_s <= asked_s


@pytest.mark.parametrize(
    ("fault", "reason"),
    [("zero", "all zero"), ("constant", "same depth at all measured pixels"), ("stale", "its clock is wrong")],
)
def test_frames_that_show_nothing_are_refused_and_the_next_look_is_well(
    camera: LiveCamera, fault: str, reason: str
) -> None:
    pid = camera.pid
    camera.fault(fault)  # pyright: ignore[reportArgumentType]
    with pytest.raises(BadFrameError, match=reason):
        camera.capture(time.monotonic())
    camera.fault("none")
    assert camera.capture(time.monotonic()).depth.any()
    # There was nothing to mend by a new connection.
    assert camera.pid == pid


@pytest.mark.parametrize("fault", ["silent", "lost"])
def test_a_camera_that_falls_silent_or_breaks_its_link_is_connected_once_more(camera: LiveCamera, fault: str) -> None:
    pid = camera.pid
    camera.fault(fault)  # pyright: ignore[reportArgumentType]
    assert camera.capture(time.monotonic()).depth.any()
    assert camera.pid != pid
    assert not runs(pid)


def test_a_killed_camera_process_costs_no_view(camera: LiveCamera, world: SimulatedWorld) -> None:
    """Killed while it waits for the arm to settle; the look succeeds, and shows what it would have shown."""
    pid = camera.pid
    assert pid is not None

    def kill_at_work() -> None:
        child = camera._child
        assert child is not None
        while not child._turn.locked():
            time.sleep(0.001)
        os.kill(pid, signal.SIGKILL)

    threading.Thread(target=kill_at_work).start()
    frame = camera.capture(time.monotonic() + 0.5)
    assert np.array_equal(frame.depth, FrameSource(world).render_depth(looking_down(world)))
    assert camera.connected
    assert camera.pid != pid
    assert not runs(pid)


def test_a_frozen_camera_process_is_noticed_and_replaced(camera: LiveCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cell.camera.camera.ASK_S", 0.5)
    pid = camera.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    assert camera.capture(time.monotonic()).depth.any()
    assert not runs(pid)


def test_a_camera_that_cannot_be_connected_again_is_lost_until_it_can(
    camera: LiveCamera, world: SimulatedWorld, flange: FlangeFile
) -> None:
    """One retry, then an error: the view is missing. The next look tries again, and here succeeds."""
    assert camera.pid is not None
    flange.path.unlink()  # nobody tells any more where the flange is: the simulated camera cannot start
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


def test_a_silent_camera_that_stays_silent_is_told(camera: LiveCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that replaces it is silent too: here the same one, as nothing else can silence a new one in time."""
    monkeypatch.setattr(camera, "_reopen", lambda: None)
    camera.fault("silent")
    with pytest.raises(NoFramesError, match=r"no frame for 2\.0 s"):
        camera.capture(time.monotonic())


def test_connecting_and_closing_leaves_nothing_behind(camera: LiveCamera) -> None:
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


def test_the_virtual_controller_tells_where_the_camera_is(world: SimulatedWorld) -> None:
    controller = start_controller("ur5e")
    camera = simulated_camera(world, lambda: partial(controller_pose, controller.host))
    try:
        controller.admin.reset(q_rad=inverse_kinematics("ur5e", looking_down(world))[0])
        camera.connect()
        frame = camera.capture(time.monotonic())
        assert np.array_equal(frame.depth, FrameSource(world).render_depth(controller.admin.pose()))
        controller.close()
        # Its process answers, but it is lost: from now on it counts as not connected.
        with pytest.raises(CameraLostError, match="lost the flange pose: no virtual controller answers"):
            ask_until_lost(camera)
        assert not camera.connected
    finally:
        camera.close()
        controller.close()


def test_a_camera_that_does_not_open_can_be_given_up_by_another_thread(
    world: SimulatedWorld, flange: FlangeFile
) -> None:
    """Frozen, it would be waited for as long as a slow one."""
    camera = simulated_camera(world, lambda: partial(flange_file, str(flange.path)))
    with thread_of(camera.connect) as result:
        until(lambda: camera.pid is not None, 5.0)
        assert camera.pid is not None
        os.kill(camera.pid, signal.SIGSTOP)
        given_up_s = time.monotonic()
        camera.cancel_connecting()
    error, ended_s = result
    assert isinstance(error, CameraUnreachableError)
    assert "was cancelled" in str(error)
    assert ended_s - given_up_s < 5.0  # of the 60 s that it would take
    assert camera.pid is None
    # For good: nobody is there to close one that is connected later.
    with pytest.raises(CameraUnreachableError, match="was cancelled"):
        camera.connect()
    assert camera.pid is None


def test_a_camera_that_is_open_is_not_lost_by_giving_up(world: SimulatedWorld, flange: FlangeFile) -> None:
    flange.write(looking_down(world))
    camera = simulated_camera(world, lambda: partial(flange_file, str(flange.path)))
    try:
        camera.connect()
        camera.cancel_connecting()
        assert camera.capture(time.monotonic()).depth.any()
    finally:
        camera.close()


def test_equipment_that_is_given_up_makes_no_camera_to_wait_for() -> None:
    equipment = Equipment(CellSettings(arm=SimulatedArm(host=free_host()), camera=SETTINGS))
    try:
        equipment.cancel_connecting()
        with pytest.raises(CameraUnreachableError, match="was cancelled"):
            equipment.camera.connect()
    finally:
        equipment.close()


def test_a_simulated_camera_without_an_arm_says_so(world: SimulatedWorld, tmp_path: Path) -> None:
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
def test_without_a_camera_it_is_said_what_to_check(device: str | None, words: str) -> None:
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


def test_the_parent_process_never_loads_what_hangs_or_weighs() -> None:
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


def test_a_picture_comes_across_and_what_shows_nothing_is_refused(camera: LiveCamera, world: SimulatedWorld) -> None:
    frame = camera.capture(time.monotonic(), with_image=True)
    source = FrameSource(world)
    assert np.array_equal(frame.depth, source.render_depth(looking_down(world)))
    assert frame.image is not None
    truth = np.mean([source.render_intensity(looking_down(world)) for _ in range(20)], axis=0)
    # The noise of a mean of five, 1.1 grey levels at most.
    assert np.abs(frame.image - truth).mean() < 1.1
    camera.fault("zero")
    with pytest.raises(BadFrameError, match="picture shows nothing"):
        camera.capture(time.monotonic(), with_image=True)
    camera.fault("none")
    assert camera.capture(time.monotonic()).image is None


def test_a_camera_that_is_connected_once_more_still_gives_the_picture(camera: LiveCamera) -> None:
    camera.fault("lost")
    assert camera.capture(time.monotonic(), with_image=True).image is not None
