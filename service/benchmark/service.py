"""Measure the service under load: answers per second, idle and during a live scan, and how soon a stop stops the arm.

The simulated cell has the speed of a real one. Service, clients, controller and camera are processes on this machine
and share its cores.
"""

import json
import random
import secrets
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from cell.simulation.benchmark.tables import table
from cell.simulation.ur_controller.admin_client import AdminClient
from service.benchmark.load_generator import Load, LoadRequest, run_load
from service.benchmark.service_process import BenchmarkClient, MeasurementError, run_service

CLIENTS = 8
"""Number of clients that send requests without a pause."""
STREAMS = 200
"""Number of clients that request the event stream. Every other one never reads what it receives."""
IDLE_S = 5.0
SCANS = 2
"""Number of scans with load, and of scans without."""
STOPS = 40
SEED = 1


@dataclass(frozen=True)
class Answers:
    """Rate and times of the answers to several clients at once."""

    per_s: float
    p50_s: float
    p99_s: float


@dataclass(frozen=True)
class ServiceTimes:
    """Results. Times are in seconds."""

    idle: Answers
    scanning: Answers
    """The answers during live scans."""
    kinds: dict[str, Answers]
    """The answers during live scans, by the kind of request."""
    scan_s: float
    """A scan without load, from its start until its result is stored."""
    loaded_scan_s: float | None
    """The same under load; None when no scan succeeded."""
    failed_scans: int
    """Number of scans under load that failed."""
    stopping: Answers
    """The answers during live scans that are stopped, with the event streams too."""
    streams_let_in: int
    """Number of event streams that the service accepted. A client whose stream was dropped requests it again."""
    streams_refused: int
    """Number of event streams that the service refused."""
    wrong: list[str]
    """Unexpected answers and lost connections."""
    stops: int
    wire_p50_s: float
    """From the request for a stop until the controller receives it."""
    wire_p99_s: float
    answer_p50_s: float
    """From the request until its answer. The arm is still by then; the scan may not have ended."""
    answer_p99_s: float
    still_p99_s: float
    """From the request until the arm is still."""


def measure_service(report: Callable[[str], None]) -> ServiceTimes:
    """Measure a service with the default configuration, under load.

    Args:
        report: Called with a message on what is measured next.

    Returns:
        The results.
    """
    host = ".".join(["127", *(str(secrets.randbelow(254) + 1) for _ in range(3))])
    with tempfile.TemporaryDirectory(prefix="pointchain-") as root, run_service(Path(root), host) as service:
        report("service: first scan, whose result the clients request")
        scan = service.wait_until_succeeded(service.start_scan())
        mix = _mix(service, scan["links"]["self"])
        report("service: idle")
        with run_load(Load(service.port, CLIENTS, mix)) as idle:
            time.sleep(IDLE_S)
        scans, loaded, during = [], [], []
        for number in range(SCANS):
            report(f"service: scan {number + 1} of {SCANS}, without and with load")
            scans.append(_duration(service.wait_until_succeeded(service.start_scan())))
            location = service.start_scan()
            service.wait(location, "scanning")
            with run_load(Load(service.port, CLIENTS, mix)) as results:
                loaded.append(service.wait_until_ended(location))
            during.append(results)
        with (
            closing(AdminClient(host)) as controller,
            run_load(Load(service.port, CLIENTS, mix, streams=STREAMS)) as stopping,
        ):
            stops = _stops(service, controller, report)
    loaded_s = [_duration(scan) for scan in loaded if scan["state"] == "succeeded"]
    names = dict.fromkeys(one.name for one in mix)
    return ServiceTimes(
        idle=_answers([idle]),
        scanning=_answers(during),
        kinds={name: _answers(during, name) for name in names},
        scan_s=float(np.median(scans)),
        loaded_scan_s=float(np.median(loaded_s)) if loaded_s else None,
        failed_scans=len(loaded) - len(loaded_s),
        stopping=_answers([stopping]),
        streams_let_in=stopping["let_in"],
        streams_refused=stopping["refused"],
        wrong=[message for one in (idle, *during, stopping) for message in one["wrong"]],
        stops=len(stops),
        wire_p50_s=float(np.percentile([stop.wire_s for stop in stops], 50)),
        wire_p99_s=float(np.percentile([stop.wire_s for stop in stops], 99)),
        answer_p50_s=float(np.percentile([stop.answer_s for stop in stops], 50)),
        answer_p99_s=float(np.percentile([stop.answer_s for stop in stops], 99)),
        still_p99_s=float(np.percentile([stop.still_s for stop in stops], 99)),
    )


def service_json(times: ServiceTimes) -> dict[str, Any]:
    """Return the results for `--json`."""
    return json.loads(json.dumps(asdict(times)), parse_float=lambda text: round(float(text), 5))


def service_table(times: ServiceTimes) -> str:
    """Return one table of the answers, and one with a row for each other figure."""
    rows = [
        _row(f"idle, {CLIENTS} clients", times.idle),
        _row("during a live scan", times.scanning),
        *(_row(f"during a live scan: {name}", answers) for name, answers in times.kinds.items()),
        _row(f"during stops, {STREAMS} clients request events", times.stopping),
    ]
    more = [
        ("a live scan without load", f"{times.scan_s:.1f} s"),
        ("a live scan under load", _loaded(times)),
        ("scans that failed under load", f"{times.failed_scans} of {SCANS}"),
        ("event streams accepted", str(times.streams_let_in)),
        ("event streams refused", str(times.streams_refused)),
        ("wrong answers and lost connections", str(len(times.wrong))),
        (f"stop to the controller, 50 % and 99 % of {times.stops}", _both(times.wire_p50_s, times.wire_p99_s)),
        ("stop to its answer, 50 % and 99 %", _both(times.answer_p50_s, times.answer_p99_s)),
        ("stop to a still arm, 99 %", f"{times.still_p99_s * 1000:.0f} ms"),
    ]
    answers = table(("answers of the service", "per second", "50 %", "99 %"), rows)
    return f"{answers}\n\n{table(('the service under load', ''), more)}"


def _loaded(times: ServiceTimes) -> str:
    if times.loaded_scan_s is None:
        return "none succeeded"
    return f"{times.loaded_scan_s:.1f} s, {times.loaded_scan_s / times.scan_s:.2f} times as long"


def _row(what: str, answers: Answers) -> tuple[str, str, str, str]:
    return what, f"{answers.per_s:.0f}", f"{answers.p50_s * 1000:.1f} ms", f"{answers.p99_s * 1000:.1f} ms"


def _both(p50_s: float, p99_s: float) -> str:
    return f"{p50_s * 1000:.0f} ms, {p99_s * 1000:.0f} ms"


def _mix(service: BenchmarkClient, location: str) -> list[LoadRequest]:
    etag = service.request("GET", f"{location}/model")[1]["etag"]
    return [
        LoadRequest("a scan", location),
        LoadRequest("the cell", "/api/cell"),
        LoadRequest("twenty scans", "/api/scans?limit=20"),
        LoadRequest("a model", f"{location}/model"),
        LoadRequest("a model that the client has", f"{location}/model", 304, etag),
    ]


def _answers(results: Sequence[dict[str, Any]], kind: str | None = None) -> Answers:
    """Return the rate and times of the answers of one kind, or of all when None."""
    seconds = [s for one in results for name, times in one["seconds"].items() if kind in (None, name) for s in times]
    duration_s = sum(one["duration_s"] for one in results)
    return Answers(len(seconds) / duration_s, float(np.percentile(seconds, 50)), float(np.percentile(seconds, 99)))


def _duration(scan: dict[str, Any]) -> float:
    began, ended = (datetime.fromisoformat(scan[name]) for name in ("started_at", "ended_at"))
    return (ended - began).total_seconds()


@dataclass(frozen=True)
class Stop:
    """One stop of a moving arm, in seconds after its request."""

    wire_s: float
    answer_s: float
    still_s: float


def _stops(service: BenchmarkClient, controller: AdminClient, report: Callable[[str], None]) -> list[Stop]:
    rng, stops = random.Random(SEED), []
    for number in range(STOPS):
        if number % 10 == 0:
            report(f"service: stop {number + 1} of {STOPS} under load")
        stops.append(stop_once(service, controller, rng.uniform(0.05, 1.0)))
    return stops


def stop_once(service: BenchmarkClient, controller: AdminClient, after_s: float) -> Stop:
    """Start a scan, stop its arm while it moves, and return the times of the stop.

    Args:
        service: Client of the service.
        controller: Client of the simulated controller.
        after_s: Time between the start of the motion and the stop, seconds. If the arm then stands still at a
            viewpoint, the stop waits for the next motion.

    Raises:
        MeasurementError: The stop was refused, or the scan ended in another way.
    """
    location = service.start_scan()
    while not controller.state().moving:
        time.sleep(0.01)
    time.sleep(after_s)
    while not controller.state().moving:  # the arm stands still at a viewpoint
        time.sleep(0.002)
    begin, requested_s = controller.state().events, time.monotonic()
    status, _, body = service.request("POST", "/api/cell/stop")
    answer_s = time.monotonic() - requested_s
    if status != 200:
        raise MeasurementError(f"the answer to the stop was {status}: {body.decode()}")
    while controller.state().moving:
        time.sleep(0.01)
    ended = service.wait(location, "aborted")
    if ended["state"] != "aborted":
        raise MeasurementError(f"the state of the stopped scan is {ended['state']}, not aborted")
    # the stamps are times of the monotonic clock of this machine
    events = [event for event in controller.log(begin) if event["stamp_s"] >= requested_s]
    arrived = [event["stamp_s"] for event in events if event["kind"] in ("braking", "command", "dashboard")]
    still = [event["stamp_s"] for event in events if event["kind"] in ("still", "motion_done")]
    return Stop(min(arrived) - requested_s, answer_s, max(still, default=requested_s) - requested_s)
