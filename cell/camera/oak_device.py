"""Opens a real OAK camera, with settings for thin things near by.

No such camera was at hand when this was written: names and values were checked against depthai 3.12, not on a device.
"""

import contextlib
import ipaddress
from typing import TYPE_CHECKING

import numpy as np

from calibration.geometry.transforms import rotation_angle
from cell.camera.oak_stream import DEPTH_UNIT_M, Stream, load
from cell.config.camera_config import OakCamera
from cell.config.camera_optics import baseline_m
from cell.devices import CameraInfo
from cell.errors import CameraUnreachableError

if TYPE_CHECKING:
    import depthai as dai

CONFIDENCE = 55
"""Depth of no more confidence than this is dropped (0 to 255)."""
LEFT_RIGHT_PX = 5
"""Largest disagreement of matching left to right and right to left, as the device counts disparity."""
FRACTIONAL_BITS = 5
"""Disparities are told in 1/32 pixel."""

LENSES_APART_SHARE = 0.1
INTRINSICS_PX = 0.5
TURNED_RAD = float(np.deg2rad(0.05))
"""Larger differences of the factory's calibration from the one in use are told."""


def open_device(settings: OakCamera) -> Stream:
    """A running pipeline on the configured camera.

    Raises:
        CameraUnreachableError: there is none, or it does not start; it says what to check.
    """
    load(settings.device)
    import depthai as dai

    found = _find(settings.device)
    try:
        device = dai.Device(found)
    except RuntimeError as error:
        raise CameraUnreachableError(unreachable(settings.device, str(error))) from error
    try:
        return _started(device, settings)
    except RuntimeError as error:
        with contextlib.suppress(RuntimeError):
            device.close()
        raise CameraUnreachableError(
            f"the camera was found but did not start: check its cable and power supply ({error})"
        ) from error


def configure_depth(config: "dai.StereoDepthConfig", settings: OakCamera) -> None:
    """Sets the stereo matching of an RVC2 camera, whatever preset was there before.

    Nothing that smooths or thins out: at half a metre it would erase a string of 4 mm.
    """
    import depthai as dai

    config.setConfidenceThreshold(CONFIDENCE)
    config.setLeftRightCheck(True)
    config.setLeftRightCheckThreshold(LEFT_RIGHT_PX)
    config.setExtendedDisparity(settings.extended_disparity)
    config.setSubpixel(True)
    config.setSubpixelFractionalBits(FRACTIONAL_BITS)
    config.setDepthAlign(dai.StereoDepthConfig.AlgorithmControl.DepthAlign.RECTIFIED_LEFT)
    config.setDepthUnit(dai.LengthUnit.CUSTOM)
    config.setCustomDepthUnitMultiplier(1 / DEPTH_UNIT_M)
    config.setMedianFilter(dai.StereoDepthConfig.MedianFilter.MEDIAN_OFF)
    filters = config.postProcessing
    filters.decimationFilter.decimationFactor = 1
    for smoothing in (
        filters.spatialFilter,
        filters.temporalFilter,
        filters.speckleFilter,
        filters.holeFilling,
        filters.adaptiveMedianFilter,
    ):
        smoothing.enable = False
    filters.thresholdFilter.minRange, filters.thresholdFilter.maxRange = 0, 65535


def calibration_warnings(
    factory: "dai.CalibrationHandler", current: "dai.CalibrationHandler", settings: OakCamera
) -> list[str]:
    """What an operator should know of the camera's calibration: the hand-eye calibration rests on it."""
    import depthai as dai

    left, right = dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C
    warnings = []
    for socket, name in ((left, "left"), (right, "right")):
        K, K_factory = (
            np.array(calibration.getCameraIntrinsics(socket, settings.width, settings.height))
            for calibration in (current, factory)
        )
        if (off_px := float(np.abs(K - K_factory).max())) > INTRINSICS_PX:
            warnings.append(
                f"the {name} lens' intrinsics in use differ from the factory's by {off_px:.1f} pixels: after such a "
                "change the hand-eye calibration must be done anew"
            )
    T, T_factory = (np.array(calibration.getCameraExtrinsics(right, left)) for calibration in (current, factory))
    turned = np.eye(4)
    turned[:3, :3] = T_factory[:3, :3].T @ T[:3, :3]
    if (off_rad := rotation_angle(turned)) > TURNED_RAD:
        warnings.append(
            f"the lenses are turned by {np.rad2deg(off_rad):.2f} degrees against their factory calibration: depth may "
            "be wrong; was the camera dropped, or calibrated anew?"
        )
    apart_m = float(np.linalg.norm(T[:3, 3])) / 100
    expected_m = baseline_m(settings.product)
    if abs(apart_m - expected_m) > LENSES_APART_SHARE * expected_m:
        warnings.append(
            f"camera.product is {settings.product}, whose lenses are {expected_m * 1000:.0f} mm apart; this camera's "
            f"are {apart_m * 1000:.0f} mm apart"
        )
    return warnings


def unreachable(device: str | None, reason: str) -> str:
    """What to check when there is no camera."""
    what = "no OAK camera was found on USB" if device is None else f"the camera {device} was not found"
    checks = "check its cable and power supply, and that no other program uses it"
    usb = "; on Linux, that the udev rule for vendor 03e7 is installed (in a container, that /dev/bus/usb is mapped)"
    address = "; one in the network must be named by camera.device" if device is None else ", and camera.device"
    return f"{what}: {checks}{address}{usb if device is None or not _is_address(device) else ''} ({reason.strip()})"


def _find(device: str | None) -> "dai.DeviceInfo":
    """The one camera that is meant. Raises CameraUnreachableError."""
    import depthai as dai

    if device is not None and _is_address(device):
        return dai.DeviceInfo(device)
    try:
        found = dai.Device.getAllConnectedDevices()
    except RuntimeError as error:
        raise CameraUnreachableError(unreachable(device, f"USB cannot be used: {error}")) from error
    meant = [info for info in found if device in (None, info.deviceId, info.name)]
    taken = {dai.XLinkDeviceState.X_LINK_BOOTED, dai.XLinkDeviceState.X_LINK_GATE_BOOTED}
    free = [info for info in meant if info.state not in taken]
    names = ", ".join(info.deviceId for info in meant or found)
    if len(free) == 1:
        return free[0]
    if free:
        raise CameraUnreachableError(f"there are {len(free)} cameras ({names}): name one by camera.device")
    if meant:
        raise CameraUnreachableError(f"another program uses the camera {names}: end it")
    raise CameraUnreachableError(unreachable(device, f"found: {names or 'none'}"))


def _is_address(device: str) -> bool:
    try:
        ipaddress.ip_address(device)
    except ValueError:
        return False
    return True


def _started(device: "dai.Device", settings: OakCamera) -> Stream:
    import depthai as dai

    device.setMaxReconnectionAttempts(0)  # a lost link is told, not mended behind our back
    warnings = _warnings(device, settings)
    pipeline = dai.Pipeline(device)
    pipeline.setAutoCalibrationMode(dai.Pipeline.AutoCalibrationMode.OFF)
    pipeline.setStopOnDeviceLoss(True)
    cameras = [
        pipeline.create(dai.node.Camera).build(socket, sensorFps=settings.fps)
        for socket in (dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C)
    ]
    if settings.exposure_us is not None:
        for camera in cameras:
            camera.initialControl.setManualExposure(settings.exposure_us, settings.iso)
    left, right = (camera.requestOutput((settings.width, settings.height), fps=settings.fps) for camera in cameras)
    depth, rectified = _depth_output(pipeline, device, left, right, settings)
    gate = _shut_gate(pipeline, rectified)
    queue = depth.createOutputQueue(maxSize=1, blocking=False)
    # Those that come while depth is waited for are kept; were there more, the oldest would go.
    pictures = gate.output.createOutputQueue(maxSize=settings.exposures, blocking=False)
    shutter = gate.inputControl.createInputQueue()
    timing = left.createOutputQueue(maxSize=1, blocking=False)
    controls = [camera.inputControl.createInputQueue() for camera in cameras]
    pipeline.start()
    lit = settings.ir_dots > 0 and device.setIrLaserDotProjectorIntensity(settings.ir_dots)
    if settings.ir_dots > 0 and not lit:
        warnings.append("camera.ir_dots is set, but this camera has no dot projector, or it did not start")

    def dots(on: bool) -> None:
        if not device.setIrLaserDotProjectorIntensity(settings.ir_dots if on else 0.0):
            raise RuntimeError("the dot projector could not be switched")

    def describe() -> CameraInfo:
        return CameraInfo(
            product=str(device.getProductName()),
            device_id=device.getDeviceId(),
            width=settings.width,
            height=settings.height,
            connection=_connection(device),
            temperature_c=float(device.getChipTemperature().average),
            warnings=tuple(warnings),
        )

    def close() -> None:
        pipeline.stop()
        pipeline.wait()
        device.close()

    return Stream(pipeline, queue, timing, controls, describe, close, pictures, shutter, dots if lit else None)


def _depth_output(
    pipeline: "dai.Pipeline",
    device: "dai.Device",
    left: "dai.Node.Output",
    right: "dai.Node.Output",
    settings: OakCamera,
) -> tuple["dai.Node.Output", "dai.Node.Output"]:
    """The depth images, and the rectified left pictures that they are of, pixel for pixel."""
    import depthai as dai

    if device.getPlatform() == dai.Platform.RVC4 and device.isNeuralDepthSupported():
        neural = pipeline.create(dai.node.NeuralDepth).build(left, right)
        neural.initialConfig.setDepthUnit(dai.LengthUnit.CUSTOM)
        neural.initialConfig.setCustomDepthUnitMultiplier(1 / DEPTH_UNIT_M)
        return neural.depth, neural.rectifiedLeft
    stereo = pipeline.create(dai.node.StereoDepth).build(left, right, dai.node.StereoDepth.PresetMode.FAST_ACCURACY)
    stereo.setRectification(True)
    configure_depth(stereo.initialConfig, settings)
    return stereo.depth, stereo.rectifiedLeft


def _shut_gate(pipeline: "dai.Pipeline", output: "dai.Node.Output") -> "dai.node.Gate":
    """A gate on the camera behind which images stay until it is told to open: unasked for, they take no bandwidth."""
    import depthai as dai

    gate = pipeline.create(dai.node.Gate)
    gate.initialConfig.open = False
    # What waits at a shut gate must not keep the stereo node from going on.
    gate.input.setBlocking(False)
    gate.input.setMaxSize(1)
    output.link(gate.input)
    return gate


def _warnings(device: "dai.Device", settings: OakCamera) -> list[str]:
    import depthai as dai

    warnings = []
    if device.getUsbSpeed() in (dai.UsbSpeed.LOW, dai.UsbSpeed.FULL, dai.UsbSpeed.HIGH):
        warnings.append(
            f"the camera is connected by slow USB ({device.getUsbSpeed().name}): use a USB 3 cable and socket"
        )
    try:
        warnings += calibration_warnings(device.readFactoryCalibration(), device.readCalibration(), settings)
    except RuntimeError as error:
        warnings.append(
            f"the camera's calibration could not be compared with the factory's: connect it again ({error})"
        )
    return warnings


def _connection(device: "dai.Device") -> str:
    import depthai as dai

    if device.getDeviceInfo().protocol == dai.XLinkProtocol.X_LINK_TCP_IP:
        return "TCP"
    speed = device.getUsbSpeed()
    fast = speed in (dai.UsbSpeed.SUPER, dai.UsbSpeed.SUPER_PLUS)
    return f"USB {3 if fast else 2} ({speed.name})"
