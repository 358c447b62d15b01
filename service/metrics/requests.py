"""Each request in the log and in the metrics: what was asked, what came of it, how long it took, who asked."""

import itertools
import logging
import secrets
from collections.abc import MutableMapping
from time import monotonic
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Histogram
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.logs.request_time import arriving
from service.logs.setup import log_request, log_scan
from service.security.auth.caller import known_caller
from service.security.middleware.request_line import scan_in, scan_of, shown_path

log = logging.getLogger("service.access")

QUIET = frozenset({"/healthz", "/readyz", "/metrics"})
"""Asked every few seconds by machines: told when somebody wants every detail."""
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "DELETE", "PATCH", "OPTIONS"})
SECONDS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30)
STARTED = secrets.token_hex(3)
"""Tells the requests of this process from those of another."""
GONE = 499
"""For a request whose client left before it was answered; no status of HTTP."""


class RequestMetrics:
    """Requests by what they asked for: by the route's own template, so that nobody's made-up address becomes a
    label."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._requests = Counter(
            "pointchain_http_requests", "Requests answered", ("method", "route", "status"), registry=registry
        )
        self._seconds = Histogram(
            "pointchain_http_request_seconds",
            "From a request's arrival to the end of its answer; event streams, which have none, do not count",
            ("method", "route"),
            buckets=SECONDS,
            registry=registry,
        )

    def answered(self, method: str, route: str, status: int, seconds: float | None) -> None:
        """One request; `seconds` None: how long it took says nothing."""
        told = method if method in METHODS else "other"
        self._requests.labels(told, route, str(status)).inc()
        if seconds is not None:
            self._seconds.labels(told, route).observe(seconds)


class RequestWatch:
    """ASGI middleware, outside of all others: refusals are seen too."""

    def __init__(self, app: ASGIApp, metrics: RequestMetrics) -> None:
        self._app, self._metrics = app, metrics
        self._numbers = itertools.count(1)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Passes the request on, and tells of it when it is over."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        status, stream, about = GONE, False, scan_in(scope["path"])

        async def seen(message: Message) -> None:
            nonlocal status, stream, about
            if message["type"] == "http.response.start":
                status, about = message["status"], scan_of(scope, message)
                stream = any(
                    name == b"content-type" and value.startswith(b"text/event-stream")
                    for name, value in message.get("headers", ())
                )
            await send(message)

        with (
            arriving() as arrived,
            log_request(f"{STARTED}-{next(self._numbers)}"),
            log_scan(about),
        ):
            try:
                await self._app(scope, receive, seen)
            except Exception:
                status = 500 if status == GONE else status  # whoever is further out answers and logs it
                raise
            finally:
                with log_scan(about):
                    self._tell(scope, status, monotonic() - arrived, stream)

    def _tell(self, scope: MutableMapping[str, Any], status: int, seconds: float, stream: bool) -> None:
        method, path = scope["method"], scope["path"]
        route = getattr(scope.get("route"), "path", "unknown")
        self._metrics.answered(method, route, status, None if stream else seconds)
        if path == "/readyz" or (path in QUIET and status < 500):
            level = logging.DEBUG
        else:
            level = logging.WARNING if status >= 500 else logging.INFO
        if not log.isEnabledFor(level):
            return
        caller = known_caller(scope)
        shown = shown_path(path)
        access = {
            "method": method[:20],
            "path": shown,
            "status": status,
            "duration_s": round(seconds, 6),
            "who": None if caller is None else caller.name,
        }
        log.log(level, "%s %s %d in %.3f s", access["method"], shown, status, seconds, extra={"access": access})
