"""The minimum role for each call of the API. A call that is not listed here does not exist."""

import re
from dataclasses import dataclass
from typing import Literal

from starlette.routing import compile_path

from service.security.auth.caller import Role

DOCS = "/docs"
MANUAL = "/manual"
DOCS_FILES = "/static-offline-docs"
CONSOLE_FILES = "/console"

MIN_ROLE: dict[str, Role | Literal["open"]] = {
    # Liveness, readiness and the description of the API. They reveal nothing about the cell or its strings.
    "GET /healthz": "open",
    "GET /readyz": "open",
    "GET /docs": "open",
    "GET /docs/start.js": "open",
    f"GET {DOCS_FILES}/{{path:path}}": "open",
    "GET /openapi.json": "open",
    # The manual is public text, which people also need before they sign in.
    f"GET {MANUAL}": "open",
    f"GET {MANUAL}/{{path:path}}": "open",
    # The operator's console, which has the page to sign in.
    "GET /": "open",
    f"GET {CONSOLE_FILES}/{{path:path}}": "open",
    "GET /api/session": "open",
    "POST /api/session": "open",
    "DELETE /api/session": "open",
    # Reading.
    "GET /metrics": "viewer",
    "GET /api/events": "viewer",
    "GET /api/cell": "viewer",
    "GET /api/cell/geometry": "viewer",
    "GET /api/recordings": "viewer",
    "GET /api/recordings/{id}": "viewer",
    "GET /api/recordings/{id}/file": "viewer",
    "GET /api/scans": "viewer",
    "GET /api/scans/{id}": "viewer",
    "GET /api/scans/{id}/events": "viewer",
    "GET /api/scans/{id}/model": "viewer",
    "GET /api/scans/{id}/grasps": "viewer",
    "GET /api/scans/{id}/height-map": "viewer",
    "GET /api/scans/{id}/height-map.png": "viewer",
    "GET /api/scans/{id}/cloud.ply": "viewer",
    "GET /api/scans/{id}/preview.png": "viewer",
    "GET /api/scans/{id}/thumbnail.png": "viewer",
    "GET /api/scans/{id}/views": "viewer",
    "GET /api/scans/{id}/views/{index}.png": "viewer",
    "GET /api/scans/{id}/views/{index}.ply": "viewer",
    "GET /api/scans/{id}/plan": "viewer",
    "GET /api/scans/{id}/recording": "viewer",
    "GET /api/calibration": "viewer",
    "GET /api/calibration/runs": "viewer",
    "GET /api/calibration/runs/{id}": "viewer",
    "GET /api/calibration/runs/{id}/views/{index}.png": "viewer",
    # Stopping. Everyone who sees a danger must be able to.
    "POST /api/cell/stop": "viewer",
    "POST /api/scans/{id}/cancel": "viewer",
    "POST /api/calibration/runs/{id}/cancel": "viewer",
    # Scanning, and its preparation.
    "POST /api/cell/connect": "operator",
    "POST /api/cell/release": "operator",
    "POST /api/viewpoints/plan": "operator",
    "GET /api/viewpoints/plan.png": "operator",
    "POST /api/recordings": "operator",
    "POST /api/scans": "operator",
    "POST /api/scans/{id}/reprocess": "operator",
    "PUT /api/scans/{id}/keep": "operator",
    "DELETE /api/scans/{id}": "operator",
    # Acknowledging that the cell is safe, and calibrating the camera.
    "POST /api/cell/acknowledge": "maintainer",
    "POST /api/calibration/runs": "maintainer",
    "POST /api/calibration/verify": "maintainer",
    "POST /api/calibration/runs/{id}/activate": "maintainer",
}
"""Minimum role by method and path. An `open` call needs no token. A HEAD request counts as GET."""

STOP_CALLS = frozenset(call for call in MIN_ROLE if call.endswith(("/stop", "/cancel")))
"""Calls that must never be delayed."""


@dataclass(frozen=True)
class Call:
    """A call in the table."""

    name: str
    """Method and path, such as `GET /api/scans/{id}`."""
    min_role: Role | None
    """Minimum role, or None if the call is public."""


@dataclass(frozen=True)
class OtherMethods:
    """The methods of the calls at an address that has no call with the requested method."""

    methods: tuple[str, ...]


def _build_tables() -> tuple[dict[tuple[str, str], Call], list[tuple[str, re.Pattern[str], Call]]]:
    """Return the calls with a fixed path, and those with a pattern, which is the same as the router's."""
    fixed, patterns = {}, []
    for name, role in MIN_ROLE.items():
        method, _, path = name.partition(" ")
        call = Call(name, None if role == "open" else role)
        if "{" in path:
            patterns.append((method, compile_path(path)[0], call))
        else:
            fixed[method, path] = call
    return fixed, patterns


_FIXED, _PATTERNS = _build_tables()


def find_call(method: str, path: str) -> Call | OtherMethods | None:
    """Return the call of a request, or the methods at its address, or None if there is nothing at the address."""
    if (call := _FIXED.get((method, path))) is not None:
        return call
    others = {known for known, fixed in _FIXED if fixed == path}
    for known, pattern, call in _PATTERNS:
        if pattern.match(path):
            if known == method:
                return call
            others.add(known)
    if "GET" in others:
        others.add("HEAD")
    return OtherMethods(tuple(sorted(others))) if others else None
