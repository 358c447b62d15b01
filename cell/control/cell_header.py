"""What the recording of a live scan says of the cell that made it."""

from cell.config.cell_config import CellSettings
from cell.control.status import CellStatus
from cell.recording.header import RecordingHeader


def scan_header(
    status: CellStatus, settings: CellSettings, depth_unit_m: float, radius_m: float | None
) -> RecordingHeader:
    """The header for a cell that is connected. `radius_m`: the string's, metres; None: not known."""
    assert status.hand_eye is not None
    assert status.arm is not None
    assert status.camera is not None
    return RecordingHeader(
        depth_unit_m=depth_unit_m,
        string_radius_m=radius_m,
        T_flange_camera=status.hand_eye.T_flange_camera,
        table_z_m=settings.mounting.table_z_m,
        workspace_m=settings.workspace_m,
        provenance={
            "camera": f"{status.camera.product} {status.camera.device_id}",
            "robot": f"{status.arm.model} {status.arm.serial}, software {status.arm.software}",
            "calibration_sha256": status.hand_eye.sha256,
        },
    )
