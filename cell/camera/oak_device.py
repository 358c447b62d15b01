"""Opening of a real OAK camera, with settings for thin objects at short distance.

No such camera was available for testing. Names and values were checked against depthai 3.12.
"""

import contextlib
import ipaddress
from typing import TYPE_CHECKING

import numpy as np

from calibration.geometry.transforms import rotation_angle
from cell.camera.oak_stream import DEPTH_UNIT_M, SPARE_PICTURES, Stream, load
from cell.config.camera_config import OakCamera
from cell.config.camera_optics import baseline_m
from cell.devices import CameraInfo
from cell.errors import CameraUnreachableError

if TYPE_CHECKING:
    import depthai as dai

CONFIDENCE = 55
"""Confidence threshold of the stereo matching, 0 to 255. Larger costs are dropped."""
LEFT_RIGHT_PX = 5
"""Largest difference between the disparities of the left-right and the right-left matching, as the device counts."""
FRACTIONAL_BITS = 5
"""Fractional bits of a disparity: its unit is 1/32 pixel."""

BASELINE_SHARE = 0.1
INTRINSICS_PX = 0.5
ROTATION_RAD = float(np.deg2rad(0.05))
"""Smallest differences between the factory calibration and the current one that give a warning."""


def open_device(settings: OakCamera) -> Stream:
    """Start a pipeline on the configured camera.

    Raises:
        CameraUnreachableError: The camera is not found, or does not start.
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
    """Set every parameter of the stereo matching of an RVC2 camera.

    All filters that smooth or decimate are off. At half a metre they would erase a string of 4 mm diameter.
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
    """Return warnings about the camera's own calibration, on which the hand-eye calibration depends."""
    import depthai as dai

    left, right = dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C
    warnings = []
    for socket, name in ((left, "left"), (right, "right")):
        K, K_factory = (
            np.array(calibration.getCameraIntrinsics(socket, settings.width, settings.height))
            for calibration in (current, factory)
        )
        if (difference_px := float(np.abs(K - K_factory).max())) > INTRINSICS_PX:
            warnings.append(
                f"the current intrinsics of the {name} lens differ from the factory's by "
                f"{difference_px:.1f} pixels: after such a change, calibrate the cell again"
            )
    T, T_factory = (np.array(calibration.getCameraExtrinsics(right, left)) for calibration in (current, factory))
    turned = np.eye(4)
    turned[:3, :3] = T_factory[:3, :3].T @ T[:3, :3]
    if (difference_rad := rotation_angle(turned)) > ROTATION_RAD:
        warnings.append(
            f"the lenses are turned by {np.rad2deg(difference_rad):.2f} degrees against their factory values: depth "
            "may be wrong; was the camera dropped or recalibrated?"
        )
    measured_m = float(np.linalg.norm(T[:3, 3])) / 100
    expected_m = baseline_m(settings.product)
    if abs(measured_m - expected_m) > BASELINE_SHARE * expected_m:
        warnings.append(
            f"camera.product is {settings.product}, whose lenses are {expected_m * 1000:.0f} mm apart; this camera's "
            f"are {measured_m * 1000:.0f} mm apart"
        )
    return warnings


def unreachable(device: str | None, reason: str) -> str:
    """Return the message for a camera that is not found, with what to check."""
    what = "no OAK camera was found on USB" if device is None else f"the camera {device} was not found"
    checks = "check its cable and power supply, and that no other program uses it"
    usb = "; on Linux, that the udev rule for vendor 03e7 is installed (in a container, that /dev/bus/usb is mapped)"
    address = "; one in the network must be named by camera.device" if device is None else ", and camera.device"
    return f"{what}: {checks}{address}{usb if device is None or not _is_address(device) else ''} ({reason.strip()})"


def _find(device: str | None) -> "dai.DeviceInfo":
    """Return the configured camera. Raise CameraUnreachableError unless exactly one matches and is free."""
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

    device.setMaxReconnectionAttempts(0)  # a lost link must be reported, not repaired silently
    warnings = _warnings(device, settings)
    pipeline = dai.Pipeline(device)
    pipeline.setAutoCalibrationMode(dai.Pipeline.AutoCalibrationMode.OFF)
    pipeline.setStopOnDeviceLoss(True)
    cameras = [
        pipeline.create(dai.node.Camera).build(socket, sensorFps=settings.frame_rate)
        for socket in (dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C)
    ]
    if settings.exposure_us is not None:
        for camera in cameras:
            camera.initialControl.setManualExposure(settings.exposure_us, settings.iso)
    size = settings.width, settings.height
    left, right = (camera.requestOutput(size, fps=settings.frame_rate) for camera in cameras)
    depth, rectified = _depth_output(pipeline, device, left, right, settings)
    gate = _closed_gate(pipeline, rectified)
    queue = depth.createOutputQueue(maxSize=1, blocking=False)
    # images that arrive during the wait for depth are kept; when there are more, the oldest are dropped
    pictures = gate.output.createOutputQueue(maxSize=settings.exposures + SPARE_PICTURES, blocking=False)
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

    return Stream(pipeline, queue, timing, controls, describe, close, pictures, shutter, dots=dots if lit else None)


def _depth_output(
    pipeline: "dai.Pipeline",
    device: "dai.Device",
    left: "dai.Node.Output",
    right: "dai.Node.Output",
    settings: OakCamera,
) -> tuple["dai.Node.Output", "dai.Node.Output"]:
    """Return the outputs of the depth images and of the rectified left images, which match pixel for pixel."""
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


def _closed_gate(pipeline: "dai.Pipeline", output: "dai.Node.Output") -> "dai.node.Gate":
    """Return a closed gate on the camera, so that images need no bandwidth unless they are requested."""
    import depthai as dai

    gate = pipeline.create(dai.node.Gate)
    gate.initialConfig.open = False
    # images that wait at a closed gate must not block the stereo node
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
