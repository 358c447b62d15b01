"""The access log and the request metrics: method, path, status, duration and caller of each request."""

import itertools
import logging
import secrets
from collections.abc import MutableMapping
from time import monotonic
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Histogram
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.logs.request_time import request_arrival
from service.logs.setup import request_log_context, scan_log_context
from service.security.auth.caller import known_caller
from service.security.middleware.request_line import printable_path, scan_id_in_path, scan_id_of_request

log = logging.getLogger("service.access")

PROBE_PATHS = frozenset({"/healthz", "/readyz", "/metrics"})
"""Paths that programs poll every few seconds. They are logged at the level debug."""
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "DELETE", "PATCH", "OPTIONS"})
"""Methods with a label of their own. The label of any other method is `other`."""
DURATION_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30)
REQUEST_ID_PREFIX = secrets.token_hex(3)
"""Prefix of request ids, which separates the requests of this process from those of another."""
CLIENT_CLOSED_REQUEST = 499
"""Logged status of a request whose client left before the answer. It is not a status of HTTP."""


class RequestMetrics:
    """Number and duration of requests.

    Their label is the template of the route, so that an arbitrary address of a client never becomes a label.
    """

    def __init__(self, registry: CollectorRegistry) -> None:
        self._requests = Counter(
            "pointchain_http_requests", "Requests answered", ("method", "route", "status"), registry=registry
        )
        self._seconds = Histogram(
            "pointchain_http_request_seconds",
            "Time from a request's arrival to the end of its answer; event streams are not included",
            ("method", "route"),
            buckets=DURATION_BUCKETS_S,
            registry=registry,
        )

    def observe(self, method: str, route: str, status: int, seconds: float | None) -> None:
        """Count one request.

        Args:
            method: Method of the request.
            route: Template of the route.
            status: Status of the answer.
            seconds: Duration. None: it is not recorded, because the answer was an event stream.
        """
        label = method if method in METHODS else "other"
        self._requests.labels(label, route, str(status)).inc()
        if seconds is not None:
            self._seconds.labels(label, route).observe(seconds)


class AccessLogMiddleware:
    """ASGI middleware that logs and counts each request. It is the outermost one, so that it sees refusals too."""

    def __init__(self, app: ASGIApp, metrics: RequestMetrics) -> None:
        self._app, self._metrics = app, metrics
        self._numbers = itertools.count(1)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and log it when it has ended."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        status, stream, scan_id = CLIENT_CLOSED_REQUEST, False, scan_id_in_path(scope["path"])

        async def observed_send(message: Message) -> None:
            nonlocal status, stream, scan_id
            if message["type"] == "http.response.start":
                status, scan_id = message["status"], scan_id_of_request(scope, message)
                stream = any(
                    name == b"content-type" and value.startswith(b"text/event-stream")
                    for name, value in message.get("headers", ())
                )
            await send(message)

        with (
            request_arrival() as arrival_s,
            request_log_context(f"{REQUEST_ID_PREFIX}-{next(self._numbers)}"),
            scan_log_context(scan_id),
        ):
            try:
                await self._app(scope, receive, observed_send)
            except Exception:
                # Starlette's outermost error handler answers and logs it
                status = 500 if status == CLIENT_CLOSED_REQUEST else status
                raise
            finally:
                with scan_log_context(scan_id):
                    self._record(scope, status, monotonic() - arrival_s, stream)

    def _record(self, scope: MutableMapping[str, Any], status: int, seconds: float, stream: bool) -> None:
        method, path = scope["method"], scope["path"]
        route = getattr(scope.get("route"), "path", "unknown")
        self._metrics.observe(method, route, status, None if stream else seconds)
        if path == "/readyz" or (path in PROBE_PATHS and status < 500):
            level = logging.DEBUG
        else:
            level = logging.WARNING if status >= 500 else logging.INFO
        if not log.isEnabledFor(level):
            return
        caller = known_caller(scope)
        shown = printable_path(path)
        access = {
            "method": method[:20],
            "path": shown,
            "status": status,
            "duration_s": round(seconds, 6),
            "who": None if caller is None else caller.name,
        }
        log.log(level, "%s %s %d in %.3f s", access["method"], shown, status, seconds, extra={"access": access})
