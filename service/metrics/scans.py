"""Counters and histograms of scans and stops for `/metrics`. They are in memory, so that reading them never blocks."""

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

from prometheus_client import CollectorRegistry, Counter, Histogram

from recognition.model.finding_types import FINDING_TYPES
from recognition.model.findings import Finding
from recognition.model.trust import Verdict
from service.processing.results import STAGE_START_FRACTION
from service.processing.view_outcomes import ViewOutcome

Mode = Literal["live", "replay"]
ViewResult = Literal["recorded", "missing", "excluded"]
ViewFailure = Literal["unreachable", "camera", "empty", "inconsistent"]
OUTCOMES = ("succeeded", "partial", "failed", "aborted", "interrupted")

SCAN_BUCKETS_S = (0.5, 1, 2, 5, 10, 15, 20, 30, 45, 60, 120, 300)
STAGE_BUCKETS_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30)
STOP_BUCKETS_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 1, 2, 5)
CORRECTION_BUCKETS_M = (0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
CORRECTION_BUCKETS_RAD = (0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05)


class ScanMetrics:
    """Metrics of scans and stops since the start of the service. Safe to use from any thread."""

    def __init__(self, registry: CollectorRegistry | None = None) -> None:
        """Create the metrics.

        Args:
            registry: Registry that publishes them. None: nothing publishes them, as without a service.
        """
        registry = registry or CollectorRegistry()
        self._scans = Counter("pointchain_scans", "Scans that have ended", ("mode", "outcome"), registry=registry)
        self._seconds = Histogram(
            "pointchain_scan_seconds",
            "Time from a scan's start to its result",
            ("mode",),
            buckets=SCAN_BUCKETS_S,
            registry=registry,
        )
        self._stages = Histogram(
            "pointchain_recognition_stage_seconds",
            "Duration of each stage of recognition",
            ("stage",),
            buckets=STAGE_BUCKETS_S,
            registry=registry,
        )
        self._views = Counter(
            "pointchain_views",
            "Views recorded or missing in live scans, and views that recognition excluded in any scan",
            ("result",),
            registry=registry,
        )
        self._findings = Counter(
            "pointchain_findings",
            "Findings of the models, by code and severity",
            ("code", "severity"),
            registry=registry,
        )
        self._verdicts = Counter("pointchain_verdicts", "Models by their verdict", ("verdict",), registry=registry)
        self._failures = Counter("pointchain_view_failures", "Views that were not used", ("reason",), registry=registry)
        self._stops = Histogram(
            "pointchain_stop_seconds",
            "Time from a stop request to the stop command at the arm's controller",
            buckets=STOP_BUCKETS_S,
            registry=registry,
        )
        self._corrections_m = Histogram(
            "pointchain_registration_correction_metres",
            "Distance by which registration moved a view",
            buckets=CORRECTION_BUCKETS_M,
            registry=registry,
        )
        self._corrections_rad = Histogram(
            "pointchain_registration_correction_radians",
            "Angle by which registration turned a view",
            buckets=CORRECTION_BUCKETS_RAD,
            registry=registry,
        )
        # Every label starts at 0, so that Prometheus sees the first event as an increase.
        for mode in get_args(Mode):
            for outcome in OUTCOMES:
                self._scans.labels(mode, outcome)
        for result in get_args(ViewResult):
            self._views.labels(result)
        for reason in get_args(ViewFailure):
            self._failures.labels(reason)
        for code, finding_type in FINDING_TYPES.items():
            self._findings.labels(code, finding_type.severity)
        for verdict in get_args(Verdict):
            self._verdicts.labels(verdict)

    def observe_scan(self, mode: Mode, outcome: str, seconds: float) -> None:
        """Count a scan in its final state. Its duration is recorded only if it has a result."""
        self._scans.labels(mode, outcome).inc()
        if outcome in ("succeeded", "partial"):
            self._seconds.labels(mode).observe(seconds)

    def observe_recognition(self, timing_s: Mapping[str, float], views: Sequence[ViewOutcome]) -> None:
        """Record the stages and the views of a recognition that gave a result.

        Args:
            timing_s: Duration of each stage, seconds. The label of an unknown stage is `other`.
            views: Outcome of each view.
        """
        for stage, seconds in timing_s.items():
            self._stages.labels(stage if stage in STAGE_START_FRACTION else "other").observe(seconds)
        for view in views:
            if view.exclusion_reason is not None:
                self._views.labels("excluded").inc()
                self._failures.labels(view.exclusion_reason).inc()
            if view.correction_m is not None:
                self._corrections_m.observe(view.correction_m)
            if view.correction_rad is not None:
                self._corrections_rad.observe(view.correction_rad)

    def observe_findings(self, verdict: Verdict, findings: Sequence[Finding]) -> None:
        """Count the verdict and the findings of a model."""
        self._verdicts.labels(verdict).inc()
        for finding in findings:
            self._findings.labels(finding.code, finding.severity).inc()

    def count_recorded_view(self) -> None:
        """Count a view of a live scan that is on the disk."""
        self._views.labels("recorded").inc()

    def count_missing_view(self, reason: ViewFailure) -> None:
        """Count a view of a live scan that was not recorded."""
        self._views.labels("missing").inc()
        self._failures.labels(reason).inc()

    def observe_stop(self, seconds: float) -> None:
        """Record the time from a stop request until the arm's controller had the command."""
        self._stops.observe(seconds)
