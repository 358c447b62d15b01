"""Activation of the result of a calibration run."""

from calibration.dataset.folder import HAND_EYE_FILE
from calibration.storage.hand_eye_file import HandEyeError, activate
from cell.control.cell import Cell
from service.errors import ServiceError
from service.jobs.calibration_job import run_folder
from service.states import ACTIVE_STATES
from service.storage.calibration_store import CalibrationStore
from service.storage.database import now
from service.storage.rows import CalibrationRow
from service.storage.storage_errors import is_full


def why_not_activatable(row: CalibrationRow) -> ServiceError | None:
    """Return the error with which an activation of the result is refused; None if it can be used."""
    if row.kind == "verification":
        message = f"{row.id} is a verification: it gives no calibration to activate"
        return ServiceError("not-activatable", message, calibration=row.id)
    if row.state in ACTIVE_STATES:
        message = f"calibration {row.id} is {row.state}; wait for its end"
        return ServiceError("result-not-ready", message, calibration=row.id, state=row.state)
    if row.result is None:
        message = f"calibration {row.id} is {row.state}: it has no result to activate"
        return ServiceError("not-activatable", message, calibration=row.id, state=row.state)
    if row.result["verdict"] == "refuse":
        why = "; ".join(finding["message"] for finding in row.result["findings"] if finding["blocking"])
        message = f"the result of calibration {row.id} must not be used: {why}"
        return ServiceError("calibration-refused", message, calibration=row.id)
    return None


def activate_result(row: CalibrationRow, store: CalibrationStore, cell: Cell) -> None:
    """Make the result of the run the active calibration, in one step, and write the time of activation.

    Raises:
        ServiceError: The result cannot be used; the error has the reason.
        OSError: The disk is full. The former calibration stays active.
    """
    refusal = why_not_activatable(row)
    if refusal is not None:
        raise refusal
    active_file = cell.settings.hand_eye.active_file
    assert active_file is not None, "the service's configuration always names a folder"
    try:
        activate(run_folder(cell, row.id) / HAND_EYE_FILE, active_file)
    except HandEyeError as error:
        raise ServiceError(error.slug, str(error)) from error
    except OSError as error:
        if is_full(error):
            raise
        message = f"{active_file} cannot be written: {error.strerror or error}; the former calibration stays in use"
        raise ServiceError("calibration", message, file=str(active_file)) from error
    cell.calibration_changed()
    store.update(row.id, ("succeeded",), activated_at=now())
