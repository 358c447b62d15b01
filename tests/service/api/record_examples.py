"""Record the examples of the OpenAPI document from a service with a simulated cell: `make api-examples`."""

import re
import socket
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
from starlette.routing import compile_path

from cell.simulation.ur_controller.admin_client import AdminClient
from service.api.examples import EXAMPLES_FILE
from service.api.openapi import format_json
from service.app import create_app
from service.clock import utc_now
from service.config.loader import ServiceConfig
from service.problems.document import PREFIX
from service.security.auth.caller import Role
from service.security.auth.sessions import add_code
from service.security.auth.tokens import PREFIX as TOKEN_PREFIX
from service.security.auth.tokens import add_token
from service.states import ACTIVE_STATES
from tests.cell.loopback import free_host
from tests.service.conftest import wait_until
from tests.service.service_process import ROOT, process

FAST_CELL = {
    "POINTCHAIN_ARM__TIME_FACTOR": "20",
    "POINTCHAIN_CAMERA__MODEL": "ideal",
    "POINTCHAIN_CAMERA__SCENE": "figure-eight",
    "POINTCHAIN_CAMERA__FPS": "30",
    "POINTCHAIN_CAMERA__SETTLE_S": "0",
}
"""A fast simulated cell with one string that crosses itself."""
MAX_NUMBERS, KEPT_NUMBERS = 16, 3
"""Longer lists of numbers or points keep this many, evenly distributed from the first to the last."""
MAX_OBJECTS = 6
"""Longer lists of objects keep only the first one."""
METRICS_LINES = 12
SHORTENED = " (lists shortened)"
UNKNOWN_ID = "20260102t030405-678901-9f86d081"


class Recorder:
    """Client of the service that keeps requests and answers as examples."""

    def __init__(self, client: httpx2.Client, tokens: Mapping[Role, str]) -> None:
        self.client = client
        self._tokens = tokens
        self.examples: dict[str, dict[str, Any]] = {}
        self._operations = [
            (method.upper(), compile_path(path)[0], operation)
            for path, item in create_app(ServiceConfig()).openapi()["paths"].items()
            for method, operation in item.items()
        ]

    def record(
        self,
        name: str,
        summary: str,
        method: str,
        path: str,
        body: Any = None,
        *,
        shown_body: Any = None,
        content: bytes | None = None,
        role: Role | None = "operator",
        keep_answer: bool = True,
    ) -> httpx2.Response:
        """Send a request that succeeds, and keep its JSON body and its answer as an example of the operation.

        Args:
            name: Name of the example, unique in its operation.
            summary: Summary of the example.
            method: HTTP method.
            path: Path and query.
            body: JSON body.
            shown_body: Body in the example in place of `body`, to hide a secret.
            content: Body that is not JSON.
            role: Role of the token. None: no token.
            keep_answer: False: the answer is no example, because it hardly differs from another one.
        """
        answer = self.client.request(method, path, json=body, content=content, headers=self._headers(role))
        assert answer.is_success, answer.text
        if body is not None:
            request = body if shown_body is None else shown_body
            self._examples(answer).setdefault("request", {})[name] = {"summary": summary, "value": request}
        if keep_answer:
            self._keep(answer, name, summary, answer.json())
        return answer

    def record_refusal(
        self, method: str, path: str, body: Any = None, *, content: bytes | None = None, role: Role | None = "operator"
    ) -> httpx2.Response:
        """Send a request that is refused, and keep the problem as an example, with the slug as its name."""
        answer = self.client.request(method, path, json=body, content=content, headers=self._headers(role))
        assert answer.is_error, answer.text
        problem = answer.json()
        self._keep(answer, problem["type"].removeprefix(PREFIX), problem["title"], problem)
        return answer

    def get(self, path: str) -> dict[str, Any]:
        """Return a document, which becomes no example."""
        answer = self.client.get(path, headers=self._headers("operator"))
        answer.raise_for_status()
        return answer.json()

    def get_content(self, path: str) -> bytes:
        """Return a file, which becomes no example."""
        answer = self.client.get(path, headers=self._headers("operator"))
        answer.raise_for_status()
        return answer.content

    def wait_for_end(self, answer: httpx2.Response) -> dict[str, Any]:
        """Wait until the scan or calibration that the answer has started is final, and return its document."""
        path = answer.headers["Location"]
        wait_until(lambda: _is_final(self.get(path)))
        return self.get(path)

    @contextmanager
    def stream(self, path: str) -> Iterator["Stream"]:
        """Open an event stream."""
        timeout = httpx2.Timeout(60)
        with self.client.stream("GET", path, headers=self._headers("operator"), timeout=timeout) as answer:
            assert answer.status_code == 200, answer.read()
            yield Stream(answer)

    def keep_events(self, stream: "Stream", name: str, summary: str) -> None:
        """Keep some events of a stream: the first two of each name, and the last one."""
        counts: dict[str, int] = {}
        kept = []
        for event in stream.received:
            kind = _event_name(event)
            counts[kind] = counts.get(kind, 0) + 1
            if counts[kind] <= 2 or event is stream.received[-1]:
                kept.append(event)
        note = "" if len(kept) == len(stream.received) else " (some events left out)"
        self._keep(stream.answer, name, summary + note, "".join(f"{event}\n\n" for event in kept))

    def keep_metrics(self) -> None:
        """Keep the first lines of the metrics."""
        answer = self.client.get("/metrics", headers=self._headers("operator"))
        lines = answer.text.splitlines(keepends=True)[:METRICS_LINES]
        self._keep(answer, "start", "The first lines", "".join(lines))

    def _keep(self, answer: httpx2.Response, name: str, summary: str, value: Any) -> None:
        short = shorten(value)
        note = "" if short == value else SHORTENED
        responses = self._examples(answer).setdefault("responses", {})
        described = self._operation(answer)["responses"]
        status = str(answer.status_code) if str(answer.status_code) in described else "default"
        responses.setdefault(status, {})[name] = {"summary": summary + note, "value": short}

    def _examples(self, answer: httpx2.Response) -> dict[str, Any]:
        return self.examples.setdefault(self._operation(answer)["operationId"], {})

    def _operation(self, answer: httpx2.Response) -> dict[str, Any]:
        method, path = answer.request.method, answer.request.url.path
        return next(found for known, form, found in self._operations if known == method and form.match(path))

    def _headers(self, role: Role | None) -> dict[str, str]:
        return {} if role is None else {"Authorization": f"Bearer {self._tokens[role]}"}


class Stream:
    """An open event stream."""

    def __init__(self, answer: httpx2.Response) -> None:
        self.answer = answer
        self.received: list[str] = []
        """The events so far, each as its lines."""
        self._lines = answer.iter_lines()

    def read_until(self, *parts: str) -> None:
        """Read events until one contains all parts, or until the stream ends."""
        lines: list[str] = []
        for line in self._lines:
            if line:
                lines.append(line)
                continue
            event, lines = "\n".join(lines), []
            if _event_name(event):  # neither a comment nor `retry` alone
                self.received.append(event)
                if parts and all(part in event for part in parts):
                    return


def _event_name(event: str) -> str:
    return next((line.partition(": ")[2] for line in event.splitlines() if line.startswith("event:")), "")


def _is_final(document: dict[str, Any]) -> bool:
    return document.get("final", document["state"] not in ACTIVE_STATES)


def shorten(value: Any) -> Any:
    """Return a document with shorter lists. Parallel lists of numbers, as those of a chain, keep the same elements."""
    match value:
        case dict():
            return {name: shorten(member) for name, member in value.items()}
        case [dict(), *_] if len(value) > MAX_OBJECTS:
            return [shorten(member) for member in value[:1]]
        case list() if len(value) > MAX_NUMBERS:
            last = len(value) - 1
            return [shorten(value[round(index * last / (KEPT_NUMBERS - 1))]) for index in range(KEPT_NUMBERS)]
        case list():
            return [shorten(member) for member in value]
    return value


def record_session(recorder: Recorder, data: Path, planner: str) -> None:
    recorder.record("none", "Nobody is signed in", "GET", "/api/session", role=None)
    recorder.record("operator", "Signed in with a token", "GET", "/api/session")
    sign_in = ("POST", "/api/session")
    recorder.record(
        *("operator", "Sign in with a token", *sign_in),
        {"token": planner},
        shown_body={"token": "TOKEN"},
        role=None,
    )
    recorder.record(
        *("code", "Sign in with a code", *sign_in),
        {"code": add_code(data, "planner", 10, utc_now()).code},
        shown_body={"code": "7K3M-Q9TX"},
        role=None,
        keep_answer=False,
    )
    recorder.record_refusal(*sign_in, {"token": "TOKEN"}, role=None)
    recorder.record("none", "Nobody is signed in any more", "DELETE", "/api/session")


def record_cell(recorder: Recorder) -> None:
    recorder.record("alive", "The service runs", "GET", "/healthz", role=None)
    wait_until(lambda: recorder.client.get("/readyz").is_success)  # recognition is starting
    recorder.record("ready", "The service can run a scan", "GET", "/readyz", role=None)
    recorder.record_refusal("GET", "/api/cell", role=None)
    recorder.record("cell", "A cell with a UR5e", "GET", "/api/cell/geometry")
    recorder.record("ready", "Arm and camera are ready", "POST", "/api/cell/connect")
    recorder.record("ready", "Arm and camera are ready", "GET", "/api/cell")
    recorder.record_refusal("POST", "/api/cell/acknowledge")
    recorder.record_refusal("POST", "/api/cell/acknowledge", role="maintainer")
    recorder.record("two", "Two viewpoints", "POST", "/api/viewpoints/plan", {"views": 2})


def record_live_scans(recorder: Recorder) -> dict[str, Any]:
    """Record two scans by the arm, and return the document of the one that succeeds."""
    start = ("POST", "/api/scans")
    with recorder.stream("/api/events") as all_events:
        live = {"mode": "live"}
        answer = recorder.record("live", "A scan by the arm, as configured", *start, live)
        scan = answer.json()
        recorder.record_refusal(*start, live)
        recorder.record_refusal("GET", f"{scan['links']['self']}/model")
        with recorder.stream(scan["links"]["events"]) as scan_events:
            scan_events.read_until()
        recorder.keep_events(scan_events, "live", "A scan by the arm, from its start to its end")
        all_events.read_until('"succeeded"')
    recorder.keep_events(all_events, "live", "A scan by the arm")
    wait_until(lambda: recorder.get("/api/cell")["state"] != "busy")

    checked = {"mode": "live", "views": 4, "validate_only": True}
    recorder.record("validated", "A request that is only checked", *start, checked)
    radius = {"mode": "live", "views": 6, "string_radius_m": 0.004}
    answer = recorder.record("radius", "A string of known radius, 6 viewpoints", *start, radius, keep_answer=False)
    address = answer.headers["Location"]
    wait_until(lambda: any(view["state"] == "recorded" for view in recorder.get(address)["progress"]["views"]))
    recorder.record("live", "Plan of a running scan", "GET", f"{address}/plan")
    recorder.record("scanning", "A scan during its motion", "GET", address)
    recorder.record("cancelled", "The arm is stopped, and the scan ends", "POST", f"{address}/cancel")
    recorder.wait_for_end(answer)
    recorder.record("aborted", "A cancelled scan", "GET", address)
    recorder.record_refusal("POST", f"{scan['links']['self']}/cancel")
    recorder.record("ready", "The arm is stopped", "POST", "/api/cell/stop")

    recorder.record_refusal(*start, {"mode": "replay", "recording": UNKNOWN_ID})
    recorder.record_refusal(*start, {"mode": "live", "string_radius_m": "4 mm"})
    recorder.record_refusal("GET", f"/api/scans/{UNKNOWN_ID}")
    return recorder.get(scan["links"]["self"])


def record_results(recorder: Recorder, scan: dict[str, Any]) -> None:
    links = scan["links"]
    recorder.record("succeeded", "A succeeded scan", "GET", links["self"])
    recorder.record("figure-eight", "One string that crosses itself", "GET", links["model"])
    recorder.record("figure-eight", "Grasps on one string, with their reach", "GET", links["grasps"])
    recorder.record_refusal("GET", links["grasps"] + "?chain=7")
    recorder.record("figure-eight", "A table with one string", "GET", links["height_map"])
    recorder.record("live", "Views of a scan by the arm", "GET", links["views"])
    recorder.record("page", "The newest scan, and the address of the next page", "GET", "/api/scans?limit=1")


def record_replays(recorder: Recorder, scan: dict[str, Any]) -> None:
    mcap = recorder.get_content(scan["links"]["recording"])
    recorder.record_refusal("POST", "/api/recordings", content=b"no MCAP file")
    upload = recorder.record(
        "uploaded", "A recording of a simulated scan", "POST", "/api/recordings?name=eight.mcap", content=mcap
    )
    recorder.record("uploaded", "An uploaded recording", "GET", upload.headers["Location"])
    recorder.record_refusal("GET", f"/api/recordings/{UNKNOWN_ID}")
    recorder.record("page", "The newest recording, and the address of the next page", "GET", "/api/recordings?limit=1")

    replay = {"mode": "replay", "recording": upload.json()["id"]}
    answer = recorder.record("replay", "An uploaded recording", "POST", "/api/scans", replay, keep_answer=False)
    address = recorder.wait_for_end(answer)["links"]["self"]
    again = f"{address}/reprocess"
    measured = recorder.record("measured", "Measure the radius of the string", "POST", again, {"string_radius_m": None})
    recorder.wait_for_end(measured)
    other = {"method": "enhanced", "all_grasps": True}
    method = recorder.record("method", "Use another method, return all grasps", "POST", again, other, keep_answer=False)
    recorder.wait_for_end(method)
    keep = ("PUT", f"{address}/keep")
    recorder.record("keep", "Keep the scan at any age", *keep, {"kept": True})
    recorder.record_refusal("DELETE", address)
    recorder.record("remove-mark", "Remove the mark", *keep, {"kept": False}, keep_answer=False)


def record_calibration(recorder: Recorder) -> None:
    runs = "/api/calibration/runs"
    first = recorder.record(
        "default", "Calibrate with the default board", "POST", runs, {"poses": 12}, role="maintainer"
    )
    run = recorder.wait_for_end(first)
    address = first.headers["Location"]
    recorder.record("succeeded", "A calibration that can be used", "GET", address)
    recorder.record("active", "The result is the calibration in use", "POST", f"{address}/activate", role="maintainer")
    recorder.record("active", "The activated calibration", "GET", "/api/calibration")
    check = recorder.record(
        "started", "Verify the calibration in use", "POST", "/api/calibration/verify", role="maintainer"
    )
    recorder.wait_for_end(check)
    recorder.record_refusal("POST", f"{check.headers['Location']}/activate", role="maintainer")

    board = {name: run["board"][name] for name in ("kind", "columns", "rows", "pitch_m")}
    second = recorder.record(
        "board", "Calibrate with a given board", "POST", runs, {"board": board}, role="maintainer", keep_answer=False
    )
    recorder.record("cancelled", "The arm is stopped", "POST", f"{second.headers['Location']}/cancel")
    recorder.wait_for_end(second)
    recorder.record("newest", "The newest run", "GET", f"{runs}?limit=1")
    recorder.record_refusal("GET", f"{runs}/{UNKNOWN_ID}")


def record_fault(recorder: Recorder, controller: AdminClient) -> None:
    """Record a protective stop and its acknowledgement, then the release of the arm."""
    recorder.record("ready", "Arm and camera are ready", "POST", "/api/cell/connect")
    controller.protective_stop()
    wait_until(lambda: recorder.get("/api/cell")["state"] == "fault")
    recorder.record("fault", "A protective stop, which a person must acknowledge", "GET", "/api/cell")
    recorder.record_refusal("POST", "/api/cell/connect")

    acknowledge = ("POST", "/api/cell/acknowledge")
    too_early = recorder.record_refusal(*acknowledge, role="maintainer")
    time.sleep(float(too_early.headers["Retry-After"]))
    recorder.record("acknowledged", "The fault is acknowledged", *acknowledge, role="maintainer")
    recorder.record("released", "Other programs can move the arm", "POST", "/api/cell/release")


def record(data: Path, log: Path) -> dict[str, dict[str, Any]]:
    """Run a service, and return the examples of its operations."""
    host = free_host()
    with process(data, log, POINTCHAIN_ARM__HOST=host, **FAST_CELL) as (_, client):
        tokens: dict[Role, str] = {
            "operator": add_token(data, "planner", "operator"),
            "maintainer": add_token(data, "integrator", "maintainer"),
        }
        recorder = Recorder(client, tokens)
        record_session(recorder, data, tokens["operator"])
        record_cell(recorder)
        scan = record_live_scans(recorder)
        record_results(recorder, scan)
        record_replays(recorder, scan)
        record_calibration(recorder)
        record_fault(recorder, AdminClient(host))
        recorder.keep_metrics()
        return recorder.examples


def main() -> int:
    """Write the examples; return the exit status."""
    with tempfile.TemporaryDirectory() as folder:
        examples = record(Path(folder) / "data", Path(folder) / "log")
    ordered = {name: examples[name] for name in sorted(examples)}
    text = format_json(ordered)
    secrets = (folder, str(ROOT), str(Path.home()), socket.gethostname(), TOKEN_PREFIX)
    if found := [word for word in secrets if re.search(rf"(?<!\w){re.escape(word)}", text)]:
        print(f"the examples contain {', '.join(found)}; they are not written", file=sys.stderr)
        return 1
    EXAMPLES_FILE.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
