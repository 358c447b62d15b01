"""Connecting arm and camera, as far as they are not connected."""

import logging
from dataclasses import dataclass

from calibration.storage.hand_eye_file import HandEye
from cell.control.active_calibration import require_its_own
from cell.control.equipment import Equipment
from cell.devices import ArmInfo, ArmState, CameraInfo
from cell.errors import CameraLostError, StoppedError

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Connected:
    """Who answered, and where the arm is."""

    arm: ArmInfo
    arm_state: ArmState
    camera: CameraInfo


def connect_equipment(equipment: Equipment, hand_eye: HandEye | None, arm: ArmInfo | None) -> Connected:
    """Connects what is not connected. `arm`: the one that was ready when last seen, None: none was. Nothing moves.

    `hand_eye` None: there need be none, because one is to be made.

    Raises:
        CellError: arm or camera cannot be used, or the calibration is not theirs.
    """
    if arm is None or not _still_ready(equipment):
        arm = equipment.arm.connect()
    camera = _camera_info(equipment)
    state = equipment.arm.state()
    if hand_eye is not None:
        require_its_own(hand_eye, camera.device_id, arm.serial)
    return Connected(arm, state, camera)


def _still_ready(equipment: Equipment) -> bool:
    """The arm that was ready is; not when it was stopped since. Raises what else is wrong with it."""
    try:
        equipment.arm.check_ready()
    except StoppedError:
        return False
    return True


def _camera_info(equipment: Equipment) -> CameraInfo:
    camera = equipment.camera
    if camera.connected:
        try:
            return camera.info()
        except CameraLostError as error:
            log.warning("%s; connecting it once more", error)
    return camera.connect()
