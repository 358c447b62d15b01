"""Drift of the hand-eye calibration, estimated from live scans."""

import threading

import numpy as np
from numpy.typing import NDArray

from calibration.storage.hand_eye_file import HandEye
from calibration.verification.drift import LATEST_SCANS, MAX_SCANS, Drift, ScanLikelihood, judge_drift
from recognition.registration.hand_eye_error import HandEyeErrorEstimate
from recognition.registration.pose_prior import PoseSigmas
from service.storage.calibration_store import CalibrationStore
from service.storage.rows import ScanErrorRow


class DriftWatch:
    """Keeps the hand-eye error that each live scan estimates, and judges the recent ones.

    Safe to use from any thread.
    """

    def __init__(self, store: CalibrationStore) -> None:
        self._store = store
        self._lock = threading.Lock()
        """Never held during a database query."""
        self.scans = 0
        """Number of scans added since the start."""
        self._latest: tuple[str, int, Drift] | None = None
        """Hash of the calibration, number of scans and result of the last judgement."""

    def add(self, scan_id: str, calibration_sha256: str, error: HandEyeErrorEstimate) -> None:
        """Keep the error that a scan with this calibration estimates."""
        row = ScanErrorRow(
            scan_id,
            calibration_sha256,
            error.posterior_mean.tolist(),
            error.information.tolist(),
            error.vector.tolist(),
        )
        self._store.add_scan_error(row)
        with self._lock:
            self.scans += 1

    def drift(self, hand_eye: HandEye) -> Drift:
        """Judge the recent scans with this calibration. The database is queried only after a further scan."""
        with self._lock:
            added = self.scans
            if self._latest is not None and self._latest[:2] == (hand_eye.sha256, added):
                return self._latest[2]
        drift = self._judge(hand_eye)
        with self._lock:
            self._latest = hand_eye.sha256, added, drift
        return drift

    @property
    def latest(self) -> Drift | None:
        """The last judgement, from memory. Does not block."""
        latest = self._latest
        return None if latest is None else latest[2]

    def _judge(self, hand_eye: HandEye) -> Drift:
        rows = self._store.scan_errors(hand_eye.sha256, MAX_SCANS)
        latest = {row.scan for row in rows[-LATEST_SCANS:]}
        first = [row for row in self._store.first_scan_errors(hand_eye.sha256, LATEST_SCANS) if row.scan not in latest]
        covariance = _assumed_covariance() if hand_eye.covariance is None else hand_eye.covariance
        return judge_drift(list(map(_scan_error, rows)), covariance, list(map(_scan_error, first)))


def _scan_error(row: ScanErrorRow) -> ScanLikelihood:
    return ScanLikelihood(np.array(row.information), np.array(row.vector))


def _assumed_covariance() -> NDArray[np.float64]:
    """Return the (6, 6) covariance that registration assumes for a calibration without one."""
    sigmas = PoseSigmas()
    return np.diag(np.repeat([sigmas.hand_eye_rad, sigmas.hand_eye_m], 3) ** 2)
