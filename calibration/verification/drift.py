"""Whether a camera has moved since its calibration, by what the scans since then tell of it.

Each scan tells of the calibration's error as a Gaussian likelihood (`ScanError`). A cell's scans look from the same
viewpoints, where the robot errs alike each time: a hundred of them know the calibration no better than one. So they
are averaged, and the average is taken to be no surer than scans whose errors are all the same.

The error is judged twice: against what the calibration may be wrong by, and against what the first scans had it be,
which a camera that is knocked later on stands out from though its calibration was wrong to the other side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

RECENT = 20
"""So many scans are judged at most, the last ones ..."""
LATEST = 5
"""... and the last of them also by themselves: a camera that was knocked is not hidden by the scans before."""
LEAST = 3
"""So many are needed: something may have been moved during one."""
CHANCE = 0.02
"""Less likely than this to come about without a drift, an error is one. Registration takes robots and cameras to be
worse than they are, so that it comes about far more rarely: of 24 simulated cells none had less than 0.2."""
TOLD_M, TOLD_RAD = 0.005, 0.0175
"""Sigmas of a drift beforehand, for telling its size: what strings do not tell of is taken to be small."""
_BEFORE = np.diag(np.repeat([TOLD_RAD, TOLD_M], 3) ** -2.0)
UNKNOWN = 1e-6
"""Directions in which the scans know less than this share of what the calibration knows are left out."""


@dataclass(frozen=True, eq=False)
class ScanError:
    """What one scan tells of the calibration's error c (6,): rotation vector and translation in the camera's frame,
    radians and metres, `T_flange_camera_true = T_flange_camera @ from_rotation_vector(c[3:], c[:3])`. What was known
    beforehand is not in it."""

    information: NDArray[np.float64]
    """(6, 6) inverse covariance; may be singular."""
    vector: NDArray[np.float64]
    """(6,) `information @ c` at the likeliest c."""


@dataclass(frozen=True, eq=False)
class Drift:
    """What the scans tell together."""

    scans: int
    """How many were judged."""
    off: NDArray[np.float64]
    """(6,) the calibration's likeliest error, as in `ScanError`."""
    chance: float
    """How likely an error at least so large, of the calibration and the scans, is without a drift."""
    drifted: bool
    """It is too unlikely, whichever one of the scans is left out."""
    from_first: bool = False
    """The camera is not where the first scans had it, and `off` is from there; else from where the calibration has
    it."""

    @property
    def off_m(self) -> float:
        """How far the camera seems to be from where the calibration has it, or `from_first` the first scans had it."""
        return float(np.linalg.norm(self.off[3:]))

    @property
    def off_rad(self) -> float:
        """How far it seems to be turned from that."""
        return float(np.linalg.norm(self.off[:3]))

    @property
    def words(self) -> str:
        """For a person at the cell."""
        seen = f"{self.off_m * 1000:.1f} mm and {np.degrees(self.off_rad):.2f} degrees"
        scans = f"{self.scans} scans"
        if not self.drifted and self.scans < LEAST:
            there_are = f"there {'is' if self.scans == 1 else 'are'} {self.scans or 'none'}"
            by_them = f", by which the camera is {seen} off" if self.scans else ""
            return (
                f"whether the calibration has drifted is not known: {LEAST} scans with it are needed, and {there_are}"
                f"{by_them}"
            )
        if not self.drifted and self.chance < CHANCE:
            return (
                f"the last {scans} do not agree with the calibration: {seen} off, more than chance can explain, though "
                "not without one of them, during which something may have been moved: scan again"
            )
        if not self.drifted:
            return f"the last {scans} agree with the calibration: {seen} off, as chance may have it"
        return (
            f"the calibration has drifted: the last {scans} agree best with the camera {seen} from where "
            f"{'the first scans with this' if self.from_first else 'the hand-eye'} calibration put it, more than "
            "chance can explain: check that camera and bracket are tight, then calibrate anew"
        )


def judge_drift(scans: Sequence[ScanError], covariance: NDArray[np.float64], first: Sequence[ScanError] = ()) -> Drift:
    """What the last `RECENT` of the scans, or else the `LATEST`, tell of the calibration that all were made with.

    The scans are given oldest first; `covariance` (6, 6) of the calibration's error in the order of c, rad and m.
    `first` are the first scans by this calibration, none of the latest among them.
    """
    latest = _judged(scans[-LATEST:], np.zeros(6), covariance)
    if latest.drifted:
        return latest
    if len(first) >= LEAST:
        # By the first scans alone, as if there were no calibration.
        known = np.mean([scan.information for scan in first], axis=0) + _BEFORE
        was = np.linalg.solve(known, np.mean([scan.vector for scan in first], axis=0))
        knocked = _judged(scans[-LATEST:], was, np.linalg.inv(known))
        if knocked.drifted:
            return replace(knocked, from_first=True)
    return _judged(scans[-RECENT:], np.zeros(6), covariance)


def _judged(recent: Sequence[ScanError], was: NDArray[np.float64], covariance: NDArray[np.float64]) -> Drift:
    """How far these scans have the calibration's error from where it `was` (6,), known up to `covariance`."""
    informations = np.array([scan.information for scan in recent]).reshape(-1, 6, 6)
    vectors = np.array([scan.vector - scan.information @ was for scan in recent]).reshape(-1, 6)
    chance = _chance(informations, vectors, covariance)
    drifted = len(recent) >= LEAST and chance < CHANCE
    if drifted:
        # One scan that is wrong, as when something was moved during it, must not raise it alone.
        rest = [np.arange(len(recent)) != k for k in range(len(recent))]
        drifted = all(_chance(informations[some], vectors[some], covariance) < CHANCE for some in rest)
    return Drift(len(recent), _likeliest(informations, vectors), chance, drifted)


def _chance(informations: NDArray[np.float64], vectors: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """How likely, by calibration and scans that are as wrong as they say, an average as far off is."""
    if not len(informations):
        return 1.0
    from scipy.special import chdtrc

    # In units in which the calibration's error has a sigma of one in each direction ...
    L = np.linalg.cholesky(covariance)
    whitened = L.T @ informations @ L
    # ... and along the axes of what the scans know.
    known, axes = np.linalg.eigh(whitened.sum(axis=0))
    each = np.maximum(np.einsum("ia,kij,ja->ka", axes, whitened, axes), 0.0)
    enough = known > UNKNOWN
    if not enough.any():
        return 1.0
    off = (axes.T @ L.T @ vectors.sum(axis=0))[enough] / known[enough]
    # The average's variance were the scans' errors all alike, each times its own sigma.
    variance = (np.sqrt(each[:, enough]).sum(axis=0) / each[:, enough].sum(axis=0)) ** 2
    return float(chdtrc(int(enough.sum()), float((off**2 / (1 + variance)).sum())))


def _likeliest(informations: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6,) the error, given the average scan and that drifts are of some millimetres or degrees."""
    count = max(len(informations), 1)
    return np.linalg.solve(informations.sum(axis=0) / count + _BEFORE, vectors.sum(axis=0) / count)
