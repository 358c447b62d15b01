"""The parts of the camera driver that run without a camera: in this process, with the real depthai."""

import re
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from cell.camera.frame_averaging import NoFramesError
from cell.camera.oak_device import calibration_warnings, configure_depth, unreachable
from cell.camera.oak_driver import OakDriver, settle_exposure
from cell.camera.oak_stream import LONGEST_EXPOSURE_S, Stream, decode, decode_picture, load, next_message, send
from cell.config.camera_config import CameraName, OakCamera, SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.devices import CameraInfo
from cell.errors import BadFrameError, CameraLostError, CameraUnreachableError, CellError
from cell.planning.look_at import look_at
from cell.self_test.check_result import failed
from cell.self_test.exposure_noise import measure_noise
from cell.simulation.devices.frame_source import FrameSource
from cell.simulation.devices.oak_pipeline import open_simulated
from cell.simulation.devices.world import SimulatedWorld, simulated_world
from cell.simulation.rendering.depth_camera import camera_model

load()
import depthai as dai  # noqa: E402 (`load` sets what it reads)

pytestmark = pytest.mark.slow

OAK = OakCamera(kind="oak")
K = np.array([[402.5, 0, 319.25], [0, 402.75, 199.5], [0, 0, 1]])
UNNAMED = CameraInfo("test", "0", 64, 40, "none", None, ())


def message(depth: NDArray[np.uint16], padding: int = 0, exposure_us: int = 4000, end_s: float = 100.0) -> dai.ImgFrame:
    """Return a depth message whose rows have `padding` additional bytes."""
    height, width = depth.shape
    rows = np.full((height, 2 * width + padding), 0xAB, dtype=np.uint8)
    rows[:, : 2 * width] = depth.astype("<u2").view(np.uint8)
    image = dai.ImgFrame()
    image.setType(dai.ImgFrame.Type.RAW16)
    image.setWidth(width)
    image.setHeight(height)
    image.setStride(2 * width + padding)
    image.setData(rows.tobytes())
    extrinsics = dai.Extrinsics(np.eye(4).tolist(), dai.CameraBoardSocket.CAM_B)
    image.setTransformation(
        dai.ImgTransformation(width, height, K.tolist(), dai.CameraModel.Perspective, [0.0] * 14, extrinsics)
    )
    image.cam.exposureTimeUs = exposure_us
    image.setTimestamp(timedelta(seconds=end_s))
    return image


def picture_message(pixels: NDArray[np.uint8], kind: dai.ImgFrame.Type, padding: int = 0) -> dai.ImgFrame:
    """Return the message of a picture (H, W) or (H, W, 3) with padded rows. The colours of NV12 follow the rows."""
    height, width = pixels.shape[:2]
    row = pixels.size // height
    rows = np.full((height * 3 // 2, row + padding), 0xAB, dtype=np.uint8)
    rows[:height, :row] = pixels.reshape(height, row)
    result = message(np.ones((height, width), np.uint16))
    result.setType(kind)
    result.setStride(row + padding)
    result.setData(rows.tobytes())
    return result


@pytest.mark.parametrize("padding", [0, 64])
@pytest.mark.parametrize("kind", ["GRAY8", "RAW8", "NV12", "BGR888i"])
def test_a_picture_is_decoded_as_it_was_sent(kind: str, padding: int) -> None:
    shape = (40, 64, 3) if kind == "BGR888i" else (40, 64)
    pixels = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    picture = decode_picture(picture_message(pixels, getattr(dai.ImgFrame.Type, kind), padding))
    assert picture.pixels.dtype == np.uint8
    assert np.array_equal(picture.pixels, pixels)
    assert np.abs(picture.K - K).max() < 1e-4
    # 4 ms before the stamp of 100 s.
    assert picture.began_s == pytest.approx(99.996, abs=1e-6)


def test_an_invalid_picture_is_rejected() -> None:
    grey = np.ones((4, 4), np.uint8)
    cut = picture_message(grey, dai.ImgFrame.Type.GRAY8)
    cut.setHeight(7)
    for wrong in (
        picture_message(grey, dai.ImgFrame.Type.RAW16),
        picture_message(grey, dai.ImgFrame.Type.BITSTREAM),
        picture_message(grey, dai.ImgFrame.Type.BGR888i),  # rows too short for three colours
        cut,
    ):
        with pytest.raises(BadFrameError, match=r"24 bytes of type .* not a picture"):
            decode_picture(wrong)


@pytest.mark.parametrize("padding", [0, 64])
def test_an_image_is_decoded_as_it_was_sent(padding: int) -> None:
    depth = np.random.default_rng(0).integers(0, 65536, (400, 640)).astype(np.uint16)
    exposure = decode(message(depth, padding))
    assert exposure.depth.dtype == np.uint16
    assert np.array_equal(exposure.depth, depth)
    # depthai keeps the matrix in single precision.
    assert np.abs(exposure.K - K).max() < 1e-4
    assert np.array_equal(exposure.K[[0, 1, 2, 2], [1, 0, 0, 1]], [0, 0, 0, 0])
    assert exposure.K[2, 2] == 1.0


def test_the_start_of_an_exposure_precedes_its_stamp() -> None:
    depth = np.ones((4, 4), np.uint16)
    assert decode(message(depth, exposure_us=8000, end_s=100.0)).began_s == pytest.approx(99.992, abs=1e-6)
    # If the camera does not report the exposure time, the longest is assumed.
    assert decode(message(depth, exposure_us=0)).began_s == pytest.approx(100.0 - LONGEST_EXPOSURE_S, abs=1e-6)


def test_an_invalid_depth_image_is_rejected() -> None:
    grey = message(np.ones((4, 4), np.uint16))
    grey.setType(dai.ImgFrame.Type.GRAY8)
    short = message(np.ones((4, 4), np.uint16))
    short.setHeight(5)
    for wrong in (grey, short):
        with pytest.raises(BadFrameError, match=r"32 bytes of type .* not a depth image"):
            decode(wrong)
    for width, height in ((0, 4), (4, 0)):
        empty = message(np.ones((4, 4), np.uint16))
        empty.setWidth(width)
        empty.setHeight(height)
        with pytest.raises(BadFrameError, match=rf"{width}x{height}, stride 8, which is not a depth image"):
            decode(empty)


def test_a_full_disk_raises_an_error_although_depthai_is_loaded(tmp_path: Path) -> None:
    """The signal handler of depthai would end the process."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, hard))
    try:
        with (tmp_path / "file").open("wb", buffering=0) as file:
            file.write(bytes(1024))
            with pytest.raises(OSError, match="too large"):
                file.write(b"one more")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_the_clock_of_depthai_is_monotonic_time() -> None:
    before_s = time.monotonic()
    clock: Any = dai.Clock
    now_s = clock.now().total_seconds()
    # The clock returns whole microseconds.
    assert before_s - 1e-6 <= now_s <= time.monotonic() + 1e-6


def test_the_point_cloud_of_depthai_equals_the_pinhole_model() -> None:
    """The node of depthai and the formula of this project use the same camera matrix."""
    depth = np.random.default_rng(1).integers(2500, 6000, (40, 64)).astype(np.uint16)
    host_only: Any = dai.Pipeline(False)
    with host_only as pipeline:
        node = pipeline.create(dai.node.PointCloud)
        node.sync.setRunOnHost(True)
        node.setRunOnHost(True)
        node.initialConfig.setLengthUnit(dai.LengthUnit.METER)
        images = node.inputDepth.createInputQueue()
        clouds = node.outputPointCloud.createOutputQueue()
        pipeline.start()
        image = message(depth)
        images.send(image)
        cloud = clouds.get(timedelta(seconds=20))
    assert isinstance(cloud, dai.PointCloudData)
    points = np.asarray(cloud.getPoints(), dtype=np.float64)
    # The node reads depth counts as millimetres. A count is a tenth of that.
    z = depth.ravel() / 1000.0
    v, u = (axis.ravel() for axis in np.indices(depth.shape))
    expected = np.column_stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z])
    # Single precision.
    assert points == pytest.approx(expected, abs=2e-6)


def test_the_stereo_settings_replace_every_preset() -> None:
    spoilt = dai.StereoDepthConfig()
    spoilt.setMedianFilter(dai.StereoDepthConfig.MedianFilter.KERNEL_7x7)
    spoilt.setSubpixelFractionalBits(3)
    spoilt.postProcessing.decimationFilter.decimationFactor = 2
    spoilt.postProcessing.thresholdFilter.maxRange = 3000
    for name in ("spatialFilter", "temporalFilter", "speckleFilter", "holeFilling", "adaptiveMedianFilter"):
        getattr(spoilt.postProcessing, name).enable = True
    for config in (spoilt, dai.StereoDepthConfig()):
        configure_depth(config, OakCamera(kind="oak", extended_disparity=True))
        assert config.getConfidenceThreshold() == 55
        assert config.getLeftRightCheckThreshold() == 5
        assert config.getExtendedDisparity()
        assert (config.getSubpixel(), config.getSubpixelFractionalBits()) == (True, 5)
        # 10,000 counts per metre are 0.1 mm each.
        assert (config.getDepthUnit(), config.getCustomDepthUnitMultiplier()) == (dai.LengthUnit.CUSTOM, 10_000)
        assert config.getMedianFilter() == dai.StereoDepthConfig.MedianFilter.MEDIAN_OFF
        assert config.algorithmControl.depthAlign == dai.StereoDepthConfig.AlgorithmControl.DepthAlign.RECTIFIED_LEFT
        filters = config.postProcessing
        assert filters.decimationFilter.decimationFactor == 1
        assert filters.thresholdFilter.maxRange == 65535
        for name in ("spatialFilter", "temporalFilter", "speckleFilter", "holeFilling", "adaptiveMedianFilter"):
            assert not getattr(filters, name).enable, name


def calibration(focal_px: float = 805.0, turned_deg: float = 0.0, apart_cm: float = 7.5) -> dai.CalibrationHandler:
    handler: Any = dai.CalibrationHandler()
    left, right = dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C
    for socket in (left, right):
        handler.setCameraIntrinsics(socket, [[focal_px, 0, 640], [0, focal_px, 400], [0, 0, 1]], 1280, 800)
    c, s = np.cos(np.deg2rad(turned_deg)), np.sin(np.deg2rad(turned_deg))
    turn = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    handler.setCameraExtrinsics(right, left, turn, [apart_cm, 0, 0], [apart_cm, 0, 0])
    return handler


def test_a_camera_with_its_factory_calibration_gives_no_warning() -> None:
    assert calibration_warnings(calibration(), calibration(), OAK) == []


@pytest.mark.parametrize(
    ("current", "words"),
    [
        # The difference is halved at half the resolution.
        (calibration(focal_px=808.0), ["intrinsics of the left lens differ .* by 1.5 pixels", "of the right lens"]),
        (calibration(turned_deg=0.2), [r"lenses are turned by 0\.20 degrees"]),
        (calibration(apart_cm=2.0), ["product is oak-d-pro, whose lenses are 75 mm apart; this camera's are 20 mm"]),
    ],
)
def test_a_changed_camera_calibration_gives_warnings(current: dai.CalibrationHandler, words: list[str]) -> None:
    warnings = calibration_warnings(calibration(), current, OAK)
    assert len(warnings) == len(words)
    for warning, pattern in zip(warnings, words, strict=True):
        assert re.search(pattern, warning), warning


def test_the_action_depends_on_the_connection_of_the_camera() -> None:
    assert "udev rule for vendor 03e7" in unreachable(None, "x")
    assert "must be named by camera.device" in unreachable(None, "x")
    assert "udev" not in unreachable("10.0.0.7", "x")
    assert "the camera 10.0.0.7 was not found" in unreachable("10.0.0.7", "x")


class Sensor(dai.node.ThreadedHostNode):
    """Send images whose exposure times follow `times_us` and then stay constant, and record the commands."""

    def __init__(self, times_us: list[int]) -> None:
        super().__init__()
        self.images, self.control = self.createOutput(), self.createInput()
        self.pictures, self.gate = self.createOutput(), self.createInput()
        self.times_us, self.locked_at_us = times_us, 0
        self.lit: bool | None = None
        """Whether the dot projector is on. None: there is no dot projector."""
        self.pictureless = False

    def switch_dots(self, on: bool) -> None:
        self.lit = on

    def run(self) -> None:
        number, gate_open = 0, False
        while self.isRunning():
            exposure_us = self.times_us[min(number, len(self.times_us) - 1)]
            try:
                control = next_message(self.control, 0.0)
                change = next_message(self.gate, 0.0)
            except CameraLostError:
                return
            gate_open = gate_open if change is None else change.open
            if gate_open and not self.pictureless:
                pixels = np.where(np.indices((40, 64)).sum(axis=0) % 2, 200, 250 if self.lit else 50)
                picture = picture_message(pixels.astype(np.uint8), dai.ImgFrame.Type.GRAY8)
                picture.setTimestamp(timedelta(seconds=time.monotonic()))
                self.pictures.send(picture)
            if control is not None and control.getCommand(dai.CameraControl.Command.AE_LOCK):
                self.locked_at_us = exposure_us
            depth = (4000 + np.indices((40, 64)).sum(axis=0)).astype(np.uint16)
            self.images.send(message(depth, exposure_us=exposure_us, end_s=time.monotonic()))
            number += 1
            time.sleep(0.01)


@contextmanager
def sensor(times_us: list[int]) -> Iterator[tuple[Sensor, Stream]]:
    host_only: Any = dai.Pipeline(False)
    with host_only as pipeline:
        node = pipeline.create(Sensor, times_us)
        # No image is dropped, so the test does not depend on the load of the machine.
        images = node.images.createOutputQueue(maxSize=1000, blocking=True)
        control = node.control.createInputQueue()
        pictures, gate = node.pictures.createOutputQueue(maxSize=5, blocking=False), node.gate.createInputQueue()
        pipeline.start()
        yield node, Stream(pipeline, images, images, [control], lambda: UNNAMED, pipeline.stop, pictures, gate)


def test_the_exposure_is_locked_when_it_has_settled() -> None:
    with sensor([500, 1000, 2000, 4000, 3900, 4000]) as (node, stream):
        assert settle_exposure(stream, SimulatedCamera()) == ()
        until = time.monotonic() + 10
        while not node.locked_at_us and time.monotonic() < until:
            time.sleep(0.01)
        assert node.locked_at_us == 4000


def test_an_exposure_that_has_not_begun_to_change_is_not_locked() -> None:
    # At 30 images/s, the control of the exposure has not reacted within the first three images.
    with sensor([500] * 5 + [4000]) as (node, stream):
        assert settle_exposure(stream, SimulatedCamera()) == ()
        until = time.monotonic() + 10
        while not node.locked_at_us and time.monotonic() < until:
            time.sleep(0.01)
        assert node.locked_at_us == 4000


def test_a_configured_exposure_is_awaited_and_not_locked() -> None:
    with sensor([500] * 5 + [2000]) as (node, stream):
        assert settle_exposure(stream, OakCamera(kind="oak", exposure_us=2000)) == ()
        time.sleep(0.1)
        assert node.locked_at_us == 0


def test_an_exposure_that_does_not_settle_gives_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cell.camera.oak_driver.STEADY_S", 0.3)
    with sensor([1000, 2000] * 500) as (_, stream):
        (warning,) = settle_exposure(stream, SimulatedCamera())
        assert "still changes" in warning
    with sensor([1000]) as (_, stream):
        (warning,) = settle_exposure(stream, OakCamera(kind="oak", exposure_us=2000))
        assert "is 1000 microseconds and should be 2000" in warning


QUERIES = """
import time
import numpy as np
from cell.camera.oak_driver import OakDriver
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.simulation.devices.oak_pipeline import open_simulated
from cell.simulation.devices.world import simulated_world

settings = CellSettings(camera=SimulatedCamera(model="exact", fps=60.0))
T_base_flange = np.diag([1.0, -1.0, -1.0, 1.0])
T_base_flange[:3, 3] = 0.36, 0.0, 0.6
driver = OakDriver(
    settings.camera,
    lambda: open_simulated(settings.camera, simulated_world(settings), lambda: lambda: T_base_flange),
)
driver.open()
driver._running().watch(True)
until = time.monotonic() + 6
while time.monotonic() < until:
    driver.info()
driver.close()
"""


def test_a_camera_answers_queries_while_it_sends_images() -> None:
    """In a separate process, because a deadlock of depthai and Python can only be killed."""
    subprocess.run([sys.executable, "-c", QUERIES], timeout=120, check=True)


def test_a_closed_stream_is_a_lost_camera() -> None:
    with sensor([1000]) as (_, stream):
        assert next_message(stream.depth, 5.0) is not None
        stream.pipeline.stop()
        stream.pipeline.wait()
        with pytest.raises(CameraLostError, match="check its cable"):
            next_message(stream.depth, 0.1)
        with pytest.raises(CameraLostError, match="check its cable"):
            send(stream.controls[0], dai.CameraControl())


def test_a_link_that_breaks_while_opening_is_reported() -> None:
    def describe() -> CameraInfo:
        raise RuntimeError("Original message: X_LINK_ERROR")

    with sensor([1000]) as (_, stream):
        oak = OakDriver(OAK, lambda: replace(stream, describe=describe))
        with pytest.raises(CameraUnreachableError) as refused:
            oak.open()
    step = failed("camera", [refused.value])
    assert step.message == "the camera was found, but the camera does not answer"
    assert step.what_to_do == "check its cable and power supply (Original message: X_LINK_ERROR)"


@pytest.fixture(scope="module")
def world() -> SimulatedWorld:
    exact = simulated_world(CellSettings(camera=SimulatedCamera(model="exact", errors=0.0, scene="straight")))
    return replace(exact, camera=camera_model("exact", (160, 100)))


def looking_down(world: SimulatedWorld, azimuth_rad: float = 0.0) -> NDArray[np.float64]:
    return look_at(world.T_base_scene[:3, 3], azimuth_rad, 1.2, 0.4, 0.1) @ inverse(world.T_flange_camera)


@contextmanager
def driver(world: SimulatedWorld, pose: Any, exposures: int = 5) -> Iterator[OakDriver]:
    settings = SimulatedCamera(model="exact", fps=50.0, exposures=exposures)
    result = OakDriver(settings, lambda: open_simulated(settings, world, lambda: pose))
    try:
        yield result
    finally:
        result.close()


def test_simulated_frames_pass_through_depthai_unchanged(world: SimulatedWorld) -> None:
    T_base_flange = looking_down(world)
    with driver(world, lambda: T_base_flange) as oak:
        info = oak.open()
        assert (info.width, info.height, info.connection) == (160, 100, "simulated")
        assert (info.device_id, info.temperature_c, info.warnings) == (world.camera_id, None, ())
        frame = oak.capture(time.monotonic(), 5.0, 10.0)
    # The camera is exact: five exposures, their median and a rendered image are equal.
    assert np.array_equal(frame.depth, FrameSource(world).render_depth(T_base_flange))
    assert np.abs(frame.K - world.camera.K).max() < 1e-4
    assert frame.depth_unit_m == world.camera.depth_unit_m
    assert frame.exposures == 5


def test_frames_show_the_pose_at_the_time_of_their_exposure(world: SimulatedWorld) -> None:
    """The arm comes to rest while the driver waits. The frame must not contain an earlier exposure."""
    moving, rest = looking_down(world, 0.0), looking_down(world, 0.3)
    after_s = time.monotonic() + 1e9

    def pose() -> NDArray[np.float64]:
        return rest if time.monotonic() > after_s else moving

    with driver(world, pose) as oak:
        oak.open()
        after_s = time.monotonic() + 0.2
        frame = oak.capture(after_s, 5.0, 10.0)
    assert np.array_equal(frame.depth, FrameSource(world).render_depth(rest))


def test_a_burst_has_the_noise_of_single_exposures(world: SimulatedWorld) -> None:
    noisy = replace(world, camera=camera_model("ideal", (160, 100)))
    T_base_flange = looking_down(noisy)
    with driver(noisy, lambda: T_base_flange) as oak:
        oak.open()
        after_s = time.monotonic() + 0.1
        burst = oak.burst(25, after_s, 5.0, 20.0)
    assert burst.depth.shape == (25, 100, 160)
    assert burst.depth_unit_m == noisy.camera.depth_unit_m
    assert burst.began_s[0] > after_s
    # 50 images/s are configured; a busy machine sends fewer.
    assert np.diff(burst.began_s).min() > 0
    frames = FrameSource(noisy)
    expected = measure_noise(np.stack([frames.render_depth(T_base_flange) for _ in range(25)]), burst.depth_unit_m)
    found = measure_noise(burst.depth, burst.depth_unit_m)
    assert found is not None
    assert expected is not None
    # The fixed noise is that of the pose. The temporal noise of 12000 pixels and 24 differences varies by 0.1 %.
    assert found.fixed_m == pytest.approx(expected.fixed_m, rel=0.01)
    for median, expected_median in zip(found.medians, expected.medians, strict=True):
        assert median.temporal_m == pytest.approx(expected_median.temporal_m, rel=0.02)


def test_an_unwatched_simulated_camera_takes_fewer_images(world: SimulatedWorld) -> None:
    times_s: list[float] = []

    def pose() -> NDArray[np.float64]:
        times_s.append(time.monotonic())
        return looking_down(world)

    with driver(world, pose) as oak:
        oak.open()
        times_s.clear()
        begun_s = time.monotonic()
        time.sleep(1.0)
        rendered = len(times_s)
        # Two of 50 images per second are rendered. A busy machine renders fewer and sleeps longer.
        assert 1 <= rendered <= 2 * (time.monotonic() - begun_s) + 2


def test_a_camera_without_a_flange_pose_is_lost(world: SimulatedWorld) -> None:
    gone = False

    def pose() -> NDArray[np.float64]:
        if gone:
            raise ConnectionResetError("the controller has ended")
        return looking_down(world)

    with driver(world, pose) as oak:
        oak.open()
        gone = True
        with pytest.raises(CameraLostError, match="the controller has ended"):
            oak.capture(time.monotonic(), 0.5, 1.0)
        with pytest.raises(CameraLostError, match="the controller has ended"):
            oak.info()
    with driver(world, pose) as oak, pytest.raises(CameraUnreachableError, match="the controller has ended"):
        oak.open()


def test_a_closed_camera_refuses_calls_and_a_real_one_refuses_faults(world: SimulatedWorld) -> None:
    with driver(world, lambda: looking_down(world)) as oak:
        for method in (oak.info, lambda: oak.capture(0.0, 1.0, 1.0), lambda: oak.fault("zero")):
            with pytest.raises(CameraLostError, match="not open"):
                method()
    with sensor([1000]) as (_, stream):
        oak = driving(stream)
        with pytest.raises(CellError, match="only a simulated camera"):
            oak.fault("zero")


def test_a_frame_has_a_picture_only_on_request(world: SimulatedWorld) -> None:
    T_base_flange = looking_down(world)
    with driver(world, lambda: T_base_flange) as oak:
        oak.open()
        plain = oak.capture(time.monotonic(), 5.0, 10.0)
        assert plain.image is None
        pictured = oak.capture(time.monotonic(), 5.0, 10.0, with_image=True)
        assert pictured.intensity is None
        assert oak.capture(time.monotonic(), 5.0, 10.0).image is None
        # The gate is closed again, so only pictures in transit arrive, and no others while images are awaited.
        while next_message(oak._running().pictures, 0.3) is not None:
            pass
        oak._running().watch(True)
        assert next_message(oak._running().pictures, 0.3) is None
    assert np.array_equal(pictured.depth, plain.depth)
    assert pictured.image is not None
    source = FrameSource(world)
    truth = np.mean([source.render_intensity(T_base_flange) for _ in range(100)], axis=0)
    off = pictured.image - truth
    # The noise of five pictures of at most 2.5 grey levels each, plus the rounding of the mean. There is no bias.
    assert off.std() < np.hypot(2.5 / np.sqrt(5), np.sqrt(1 / 12))
    # 16,000 pixels give 0.01 grey levels of spread.
    assert abs(off.mean()) < 0.05


def test_a_frame_has_the_intensity_image_of_its_exposures(world: SimulatedWorld) -> None:
    T_base_flange = looking_down(world)
    with driver(world, lambda: T_base_flange) as oak:
        oak.open()
        frame = oak.capture(time.monotonic() + 0.1, 5.0, 10.0)
    assert frame.intensity is not None
    source = FrameSource(world)
    truth = np.mean([source.render_intensity(T_base_flange) for _ in range(100)], axis=0)
    # As for a picture: the noise of five images, plus the rounding of the mean.
    assert (frame.intensity - truth).std() < np.hypot(2.5 / np.sqrt(5), np.sqrt(1 / 12))


class Pairs(dai.node.ThreadedHostNode):
    """Send depth and left images whose values contain their number."""

    def __init__(self, has_left: Callable[[int], bool], late_s: float = 0.0, exposure_s: float = 0.004) -> None:
        super().__init__()
        self.images, self.control = self.createOutput(), self.createInput()
        self.pictures, self.gate = self.createOutput(), self.createInput()
        self.has_left, self.late_s, self.exposure_s = has_left, late_s, exposure_s

    def run(self) -> None:
        number, gate_open = 0, False
        ramp = np.indices((40, 64)).sum(axis=0)
        while self.isRunning():
            try:
                change = next_message(self.gate, 0.0)
            except CameraLostError:
                return
            gate_open = gate_open if change is None else change.open
            time.sleep(self.exposure_s)
            now_s = time.monotonic()
            left = picture_message((ramp + number).astype(np.uint8), dai.ImgFrame.Type.RAW8)
            exposure_us = round(self.exposure_s * 1e6)
            depth = message((4000 + ramp + number).astype(np.uint16), exposure_us=exposure_us, end_s=now_s)
            left.setTimestamp(timedelta(seconds=now_s))
            for image in (left, depth):
                image.setSequenceNum(number)
            sends_left = gate_open and self.has_left(number)
            if sends_left and self.late_s == 0:
                self.pictures.send(left)
            self.images.send(depth)
            if sends_left and self.late_s > 0:
                time.sleep(self.late_s)
                self.pictures.send(left)
            number += 1
            time.sleep(0.02)


@contextmanager
def pairs(has_left: Callable[[int], bool], late_s: float = 0.0, exposure_s: float = 0.004) -> Iterator[Stream]:
    host_only: Any = dai.Pipeline(False)
    with host_only as pipeline:
        node = pipeline.create(Pairs, has_left, late_s, exposure_s)
        images = node.images.createOutputQueue(maxSize=1000, blocking=True)
        control, gate = node.control.createInputQueue(), node.gate.createInputQueue()
        pictures = node.pictures.createOutputQueue(maxSize=5, blocking=False)
        pipeline.start()
        yield Stream(pipeline, images, images, [control], lambda: UNNAMED, pipeline.stop, pictures, gate)


@pytest.mark.parametrize("late_s", [0.0, 0.03])
def test_left_images_are_matched_with_the_depth_images_by_their_number(late_s: float) -> None:
    with pairs(lambda number: True, late_s) as stream:
        frame = driving(stream).capture(time.monotonic() + 0.2, 5.0, 10.0)
    # The median of five successive depth images is the third one, and so is the mean of their left images.
    assert frame.intensity is not None
    assert np.array_equal(frame.intensity, frame.depth - 4000)


def test_an_exposure_from_before_the_gate_was_open_is_not_taken() -> None:
    with pairs(lambda number: True, exposure_s=0.2) as stream:
        oak = OakDriver(OakCamera(kind="oak", exposures=1), lambda: stream)
        oak._stream = stream
        time.sleep(0.3)  # an exposure is under way, and its left image will not be sent
        assert oak.capture(0.0, 5.0, 10.0).intensity is not None


def test_a_left_image_is_kept_until_its_depth_image_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    world = replace(simulated_world(CellSettings()), camera=camera_model("ideal", (160, 100)))
    T_base_flange = looking_down(world)
    with driver(world, lambda: T_base_flange, exposures=1) as oak:
        oak.open()
        # Four more images come while a depth image is decoded.
        monkeypatch.setattr("cell.camera.oak_driver.decode", lambda message: (time.sleep(0.08), decode(message))[1])
        assert oak.capture(time.monotonic(), 5.0, 10.0).intensity is not None


def test_exposures_without_a_left_image_do_not_change_the_intensity_image() -> None:
    with pairs(lambda number: number % 5 == 0) as stream:
        frame = driving(stream).capture(time.monotonic() + 0.2, 5.0, 10.0)
    assert frame.intensity is not None
    # Of five successive exposures, one has an image, which is at most two numbers from the third.
    ramp = np.indices((40, 64)).sum(axis=0)
    number = int(frame.intensity[0, 0])
    assert number % 5 == 0
    assert np.array_equal(frame.intensity, ramp + number)
    assert abs(int(frame.depth[0, 0]) - 4000 - number) <= 2


def test_a_scan_needs_no_left_images(caplog: pytest.LogCaptureFixture) -> None:
    with pairs(lambda number: False) as stream:
        assert driving(stream).capture(time.monotonic(), 5.0, 10.0).intensity is None
    assert caplog.messages == []


def test_left_images_of_another_kind_are_left_out(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(image: dai.ImgFrame) -> None:
        raise BadFrameError("the camera sent something else")

    monkeypatch.setattr("cell.camera.oak_driver.decode_picture", refuse)
    with pairs(lambda number: True) as stream:
        assert driving(stream).capture(time.monotonic(), 5.0, 10.0).intensity is None
    assert "an intensity image is left out: the camera sent something else" in caplog.messages


def test_the_intensity_image_of_a_stereo_camera_is_the_left_image_with_dots() -> None:
    world = stereo_world("oak-d-pro", (160, 100), 1.0)
    T_base_flange = looking_down(world)
    with driver(world, lambda: T_base_flange) as oak:
        oak.open()
        frame = oak.capture(time.monotonic(), 5.0, 10.0)
    assert frame.intensity is not None
    dotted = FrameSource(world).render_intensity(T_base_flange).astype(float)
    # The noise of one image is about 2 grey levels. Dots have up to 200.
    assert np.abs(frame.intensity - dotted).max() < 15


def stereo_world(model: CameraName, size: tuple[int, int], ir_dots: float) -> SimulatedWorld:
    settings = SimulatedCamera(model=model, errors=0.0, scene="straight", table_top="bare", ir_dots=ir_dots)
    return replace(simulated_world(CellSettings(camera=settings)), camera=camera_model(model, size))


def test_the_unit_of_the_depth_is_that_of_the_simulated_camera() -> None:
    world = stereo_world("d435", (160, 90), 0.0)
    T_base_flange = looking_down(world)
    with driver(world, lambda: T_base_flange) as oak:
        info = oak.open()
        frame = oak.capture(time.monotonic(), 5.0, 10.0)
    assert (info.depth_unit_m, frame.depth_unit_m) == (0.001, 0.001)
    # The camera is 0.4 m from the table.
    assert np.median(frame.depth[frame.depth > 0]) * frame.depth_unit_m == pytest.approx(0.4, abs=0.02)


def test_pictures_of_a_simulated_camera_have_no_dots() -> None:
    world = stereo_world("oak-d-pro", (160, 100), 1.0)
    T_base_flange = looking_down(world)
    with driver(world, lambda: T_base_flange) as oak:
        oak.open()
        frame = oak.capture(time.monotonic(), 5.0, 10.0, with_image=True)
        depth_after = oak.capture(time.monotonic(), 5.0, 10.0).depth
    assert frame.image is not None
    source = FrameSource(world)
    dotted = source.render_intensity(T_base_flange).astype(float)
    source.switch_dots(False)
    dark = source.render_intensity(T_base_flange).astype(float)
    # The noise of one image is about 2 grey levels. Dots have up to 200.
    assert np.abs(frame.image - dark).max() < 15
    assert np.abs(frame.image - dotted).max() > 50
    # The depth is measured with dots, before and after. The right camera does not see the first 12 % of the columns.
    for depth in (frame.depth, depth_after):
        assert np.mean(np.abs(depth * 0.0001 - 0.4) < 0.08) > 0.7


def test_pictures_show_the_pose_at_the_time_of_their_exposure(world: SimulatedWorld) -> None:
    moving, rest = looking_down(world, 0.0), looking_down(world, 0.3)
    after_s = time.monotonic() + 1e9

    def pose() -> NDArray[np.float64]:
        return rest if time.monotonic() > after_s else moving

    with driver(world, pose) as oak:
        oak.open()
        after_s = time.monotonic() + 0.3
        image = oak.capture(after_s, 5.0, 10.0, with_image=True).image
    assert image is not None
    there, elsewhere = (FrameSource(world).render_intensity(T).astype(float) for T in (rest, moving))
    assert np.abs(image - there).mean() < 3 < np.abs(image - elsewhere).mean()


@pytest.mark.parametrize("fault", ["zero", "constant"])
def test_an_empty_picture_is_rejected(world: SimulatedWorld, fault: Any) -> None:
    with driver(world, lambda: looking_down(world)) as oak:
        oak.open()
        oak.fault(fault)
        with pytest.raises(BadFrameError, match="picture shows nothing"):
            oak.capture(time.monotonic(), 5.0, 10.0, with_image=True)


def driving(stream: Stream) -> OakDriver:
    result = OakDriver(OAK, lambda: stream)
    result._stream = stream
    return result


def test_a_camera_without_pictures_is_reported() -> None:
    with sensor([1000]) as (node, stream):
        node.pictureless = True
        with pytest.raises(NoFramesError, match=r"no picture for 1\.0 s"):
            driving(stream).capture(time.monotonic(), 1.0, 20.0, with_image=True)


def test_the_dot_projector_is_off_only_during_a_picture() -> None:
    switched: list[bool] = []
    with sensor([1000]) as (node, stream):
        node.lit = True

        def dots(on: bool) -> None:
            switched.append(on)
            node.switch_dots(on)

        with stream.sending_pictures():
            assert decode_picture(next_message(stream.pictures, 5.0)).pixels.min() == 200
        oak = driving(replace(stream, dots=dots))
        image = oak.capture(time.monotonic(), 5.0, 10.0, with_image=True).image
        assert image is not None
        assert (image.min(), image.max()) == (50, 200)
        assert switched == [False, True]
        assert node.lit
        # The dots stay on for depth alone.
        oak.capture(time.monotonic(), 5.0, 10.0)
        assert switched == [False, True]


def test_a_dot_projector_that_cannot_be_switched_is_a_lost_camera() -> None:
    def dots(on: bool) -> None:
        raise RuntimeError("the dot projector could not be switched")

    with sensor([1000]) as (_, stream):
        oak = driving(replace(stream, dots=dots))
        with pytest.raises(CameraLostError, match="projector could not be switched"):
            oak.capture(time.monotonic(), 5.0, 10.0, with_image=True)
