"""What scans and stops add up to, for `/metrics`. Numbers in memory: telling them waits for nothing."""

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from prometheus_client import CollectorRegistry, Counter, Histogram

from service.processing.results import DONE_BEFORE
from service.processing.view_outcomes import ViewOutcome

Mode = Literal["live", "replay"]
ViewResult = Literal["recorded", "missing", "left_out"]
ViewFailure = Literal["unreachable", "camera", "nothing_seen", "contradicting"]
ENDS = ("succeeded", "partial", "failed", "aborted", "interrupted")

SCAN_S = (0.5, 1, 2, 5, 10, 15, 20, 30, 45, 60, 120, 300)
STAGE_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30)
STOP_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 1, 2, 5)
CORRECTION_M = (0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
CORRECTION_RAD = (0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05)


class ScanMetrics:
    """Counted and timed since the service's start. Safe to use from any thread."""

    def __init__(self, registry: CollectorRegistry | None = None) -> None:
        """Without a registry they are nobody's, as where there is no service."""
        kept = registry or CollectorRegistry()
        self._scans = Counter("pointchain_scans", "Scans that have ended", ("mode", "outcome"), registry=kept)
        self._seconds = Histogram(
            "pointchain_scan_seconds", "From a scan's beginning to its result", ("mode",), buckets=SCAN_S, registry=kept
        )
        self._stages = Histogram(
            "pointchain_recognition_stage_seconds", "Recognition by stage", ("stage",), buckets=STAGE_S, registry=kept
        )
        self._views = Counter(
            "pointchain_views",
            "Views: of live scans recorded or missing, of any scan left out by recognition",
            ("result",),
            registry=kept,
        )
        self._failures = Counter("pointchain_view_failures", "Views that were not used", ("reason",), registry=kept)
        self._stops = Histogram(
            "pointchain_stop_seconds",
            "From a request to stop to the arm's controller having been told",
            buckets=STOP_S,
            registry=kept,
        )
        self._corrections_m = Histogram(
            "pointchain_registration_correction_metres",
            "How far registration moved a view",
            buckets=CORRECTION_M,
            registry=kept,
        )
        self._corrections_rad = Histogram(
            "pointchain_registration_correction_radians",
            "How far registration turned a view",
            buckets=CORRECTION_RAD,
            registry=kept,
        )
        # What has not happened yet is told as 0, so that its first time is seen as a change.
        for mode in get_args(Mode):
            for end in ENDS:
                self._scans.labels(mode, end)
        for result in get_args(ViewResult):
            self._views.labels(result)
        for reason in get_args(ViewFailure):
            self._failures.labels(reason)

    def ended(self, mode: Mode, outcome: str, seconds: float) -> None:
        """A scan has come to its final state; its time counts only where it has a result."""
        self._scans.labels(mode, outcome).inc()
        if outcome in ("succeeded", "partial"):
            self._seconds.labels(mode).observe(seconds)

    def recognised(self, timing_s: Mapping[str, float], views: Sequence[ViewOutcome]) -> None:
        """Recognition gave a result."""
        for stage, seconds in timing_s.items():
            self._stages.labels(stage if stage in DONE_BEFORE else "other").observe(seconds)
        for view in views:
            if view.left_out is not None:
                self._views.labels("left_out").inc()
                self._failures.labels(view.left_out).inc()
            if view.correction_m is not None:
                self._corrections_m.observe(view.correction_m)
            if view.correction_rad is not None:
                self._corrections_rad.observe(view.correction_rad)

    def recorded(self) -> None:
        """A view of a live scan is on the disk."""
        self._views.labels("recorded").inc()

    def missing(self, reason: ViewFailure) -> None:
        """A view of a live scan is not there."""
        self._views.labels("missing").inc()
        self._failures.labels(reason).inc()

    def stopped(self, seconds: float) -> None:
        """A stop was asked for, and so much later the arm's controller had it."""
        self._stops.observe(seconds)
