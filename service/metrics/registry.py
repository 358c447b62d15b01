"""The metrics of one service, in a Prometheus registry of their own."""

import platform
from importlib.metadata import version

from prometheus_client import CollectorRegistry, Info, ProcessCollector, generate_latest

from service.metrics.requests import RequestMetrics
from service.metrics.scans import ScanMetrics
from service.metrics.state import StateMetrics


class Metrics:
    """All metrics of one service."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        self.requests = RequestMetrics(self._registry)
        self.scans = ScanMetrics(self._registry)
        ProcessCollector(registry=self._registry)
        Info("pointchain_build", "Version of the software", registry=self._registry).info(
            {"version": version("pointchain"), "python": platform.python_version()}
        )

    def register(self, state: StateMetrics) -> None:
        """Add the metrics of the current state, once the service has started."""
        self._registry.register(state)

    def text(self) -> bytes:
        """Return all metrics in Prometheus' text format, version 0.0.4."""
        return generate_latest(self._registry)
