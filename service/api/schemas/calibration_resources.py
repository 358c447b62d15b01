"""Conversion of calibration rows, files and drift estimates to their JSON documents."""

import logging
import sqlite3
from collections.abc import Sequence

import numpy as np

from calibration.storage.document import CalibrationResult, FindingResource, VerificationResource
from calibration.storage.hand_eye_file import HandEye
from calibration.verification.drift import Drift
from cell.control.cell import Cell
from cell.errors import CellError
from service import clock
from service.api.schemas.addresses import RUNS
from service.api.schemas.calibration import (
    ActiveCalibration,
    CalibrationProgress,
    CalibrationView,
    CellWarning,
    DriftResource,
    RunLinks,
    RunResource,
)
from service.api.schemas.problem import problem_resource
from service.jobs.calibration_activation import why_not_activatable
from service.jobs.calibration_drift import DriftWatch
from service.states import ACTIVE_STATES
from service.storage.calibration_store import CalibrationStore
from service.storage.rows import CalibrationRow, CalibrationViewRow

log = logging.getLogger(__name__)


def usable_hand_eye(cell: Cell) -> HandEye | None:
    """Return the calibration in use from its file, or None if none is usable. Requests that need it report why."""
    try:
        return cell.hand_eye()
    except CellError:
        return None


def recent_drift(hand_eye: HandEye, watch: DriftWatch) -> Drift | None:
    """Return the drift in recent scans. None if the database fails, so that the cell is still reported."""
    try:
        return watch.drift(hand_eye)
    except sqlite3.Error:
        log.exception("cannot read the drift of the calibration")
        return None


def calibration_warnings(hand_eye: HandEye | None, drift: Drift | None, store: CalibrationStore) -> list[CellWarning]:
    """Return warnings about the calibration in use, from its last verification and from recent scans."""
    warnings = []
    verified = None if hand_eye is None else _last_verification(hand_eye, store)
    if verified is not None and verified.verification is not None and not verified.verification["passed"]:
        message = f"the verification of {verified.ended_at} failed: {verified.verification['message']}"
        warnings.append(CellWarning(code="verification-failed", message=message))
    if drift is not None and drift.drifted:
        warnings.append(CellWarning(code="calibration-drift", message=drift.message))
    return warnings


def _last_verification(hand_eye: HandEye, store: CalibrationStore) -> CalibrationRow | None:
    """Return the last verification of a calibration, or None if there is none or the database fails."""
    try:
        return store.last_verification(hand_eye.sha256)
    except sqlite3.Error:
        log.exception("cannot read the last verification of the calibration")
        return None


def active_calibration(hand_eye: HandEye, drift: Drift) -> ActiveCalibration:
    """Return the calibration in use and its drift as a document."""
    covariance, created = hand_eye.covariance, hand_eye.created
    return ActiveCalibration(
        T_flange_camera=hand_eye.T_flange_camera.tolist(),
        covariance=None if covariance is None else covariance.tolist(),
        sigma_m=None if covariance is None else float(np.sqrt(np.trace(covariance[3:, 3:]))),
        sigma_rad=None if covariance is None else float(np.sqrt(np.trace(covariance[:3, :3]))),
        repeatability_95_m=hand_eye.repeatability_95_m,
        verdict=hand_eye.verdict,
        findings=[FindingResource.model_validate(finding) for finding in hand_eye.findings],
        created_at=None if created is None else created.isoformat(),
        age_s=None if created is None else (clock.utc_now() - created).total_seconds(),
        camera_id=hand_eye.camera_id,
        robot_serial=hand_eye.robot_serial,
        board=None if hand_eye.board is None else hand_eye.board.to_json(),
        sha256=hand_eye.sha256,
        warnings=list(hand_eye.warnings),
        drift=DriftResource(
            scans=drift.scans,
            deviation_m=drift.deviation_m,
            deviation_rad=drift.deviation_rad,
            reference=drift.reference,
            p_value=drift.p_value,
            drifted=drift.drifted,
            message=drift.message,
        ),
    )


def run_resource(row: CalibrationRow, views: Sequence[CalibrationViewRow]) -> RunResource:
    """Return a run and its views as a document."""
    own = f"{RUNS}/{row.id}"
    return RunResource(
        id=row.id,
        kind=row.kind,
        board=row.board,
        poses=row.poses,
        warnings=row.warnings,
        state=row.state,
        progress=CalibrationProgress(
            stage=row.stage,
            fraction=row.fraction,
            coverage=row.coverage,
            views=[
                CalibrationView(
                    index=view.view,
                    state=view.state,
                    reason=view.reason,
                    corners=view.corners,
                    board_corners=view.board_corners,
                    rms_px=view.rms_px,
                    cells=view.cells,
                    image=f"{own}/views/{view.view}.png" if view.state == "recorded" else None,
                )
                for view in views
            ],
        ),
        created_at=row.created_at,
        started_at=row.started_at,
        ended_at=row.ended_at,
        activated_at=row.activated_at,
        calibration_sha256=row.calibration_sha256,
        result=CalibrationResult.model_validate(row.result) if row.result else None,
        verification=VerificationResource.model_validate(row.verification) if row.verification else None,
        problem=problem_resource(row.failure, own),
        links=RunLinks(
            self=own,
            cancel=f"{own}/cancel" if row.state in ACTIVE_STATES else None,
            activate=f"{own}/activate" if why_not_activatable(row) is None else None,
        ),
    )
