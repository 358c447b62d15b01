"""Run a service in its own process, for `pointchain bench`, with a client."""

import http.client
import json
import os
import re
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from cell.process.python_process import end_process, start_python
from service.benchmark.load_generator import HOST
from service.config.loader import FILE_VARIABLE, PREFIX

ROOT = Path(__file__).resolve().parents[2]
SERVE = (
    "import sys; from cell.process.python_process import exit_with_parent; exit_with_parent(); "
    "from service.cli.main import main; sys.exit(main(['serve', '--unsupervised']))"
)
"""Program of the service. The benchmark holds its standard input open."""
SCAN = {"mode": "live", "string_radius_m": 0.0042}
START_S = 60.0
"""Timeout for the service to listen, and for each answer."""
SHUTDOWN_S = 60.0
"""Timeout for the service to end after SIGTERM. It is killed after that."""


class MeasurementError(RuntimeError):
    """A scan, a stop or the service failed, so there is nothing to measure."""


class BenchmarkClient:
    """A client of the service in the other process."""

    def __init__(self, port: int) -> None:
        self.port = port
        self._connection = http.client.HTTPConnection(HOST, port, timeout=START_S)

    def request(self, method: str, path: str, body: dict[str, Any] | None = None) -> tuple[int, dict[str, str], bytes]:
        """Send a request, and return the status, the headers by their names in lower case, and the body.

        Args:
            method: HTTP method.
            path: Path of the request.
            body: Members of the JSON body. None: no body.
        """
        text = None if body is None else json.dumps(body)
        self._connection.request(method, path, text, {} if text is None else {"Content-Type": "application/json"})
        answer = self._connection.getresponse()
        headers = {name.lower(): value for name, value in answer.getheaders()}
        return answer.status, headers, answer.read()

    def start_scan(self) -> str:
        """Start a live scan as soon as the last one has ended, and return its path.

        Raises:
            MeasurementError: The service started no scan.
        """
        while True:
            status, headers, body = self.request("POST", "/api/scans", SCAN)
            if status == 202:
                return headers["location"]
            problem = json.loads(body)["type"]
            if problem == "urn:pointchain:acknowledge-required":  # the last scan failed
                self.request("POST", "/api/cell/acknowledge")
            elif problem != "urn:pointchain:cell-busy":
                raise MeasurementError(f"the service started no scan: {body.decode()}")
            time.sleep(0.05)

    def scan(self, location: str) -> dict[str, Any]:
        """Return the current state of a scan."""
        return json.loads(self.request("GET", location)[2])

    def wait(self, location: str, state: str) -> dict[str, Any]:
        """Wait until a scan has reached a state or has ended, and return it."""
        while (scan := self.scan(location))["state"] != state and scan["ended_at"] is None:
            time.sleep(0.05)
        return scan

    def wait_until_ended(self, location: str) -> dict[str, Any]:
        """Wait until a scan has ended, and return it."""
        return self.wait(location, "succeeded")

    def wait_until_succeeded(self, location: str) -> dict[str, Any]:
        """Wait until a scan has ended, and return it.

        Raises:
            MeasurementError: The scan did not succeed.
        """
        scan = self.wait_until_ended(location)
        if scan["state"] != "succeeded":
            raise MeasurementError(f"the scan ended {scan['state']}: {scan['problem'] or scan['summary']}")
        return scan

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


@contextmanager
def run_service(data_dir: Path, controller_host: str) -> Iterator[BenchmarkClient]:
    """Run a service with the default configuration, and yield a client of it.

    The configuration in the environment variables is ignored.

    Args:
        data_dir: Folder for the data folder and the log of the service.
        controller_host: Address at which the service starts its simulated controller.

    Raises:
        MeasurementError: The service did not start, or the connection to it was lost.
    """
    environment = {name: value for name, value in os.environ.items() if not name.upper().startswith(PREFIX)}
    environment |= {
        f"{PREFIX}DATA_DIR": str(data_dir / "data"),
        f"{PREFIX}PORT": "0",
        f"{PREFIX}ARM__HOST": controller_host,
    }
    environment.pop(FILE_VARIABLE, None)
    log = data_dir / "log"
    with log.open("wb") as output:
        process = start_python(
            "-c", SERVE, environment=environment, cwd=ROOT, stdin=subprocess.PIPE, stdout=output, stderr=output
        )
    try:
        service = BenchmarkClient(_wait_for_port(process, log))
        with closing(service):
            while service.request("GET", "/readyz")[0] != 200:
                time.sleep(0.1)
            yield service
    except OSError as error:
        raise MeasurementError(f"the service failed: {error}; its log ends with\n{log.read_text()[-2000:]}") from error
    finally:
        end_process(process, SHUTDOWN_S, terminate=True)


def _wait_for_port(process: "subprocess.Popen[bytes]", log: Path) -> int:
    deadline = time.monotonic() + START_S
    while not (found := re.search(r"pointchain: http://[\d.]+:(\d+) ", log.read_text())) or not _listens(found[1]):
        if process.poll() is not None or time.monotonic() > deadline:
            raise MeasurementError(f"the service did not start; this is its log:\n{log.read_text()}")
        time.sleep(0.05)
    return int(found[1])


def _listens(port: str) -> bool:
    connection = http.client.HTTPConnection(HOST, int(port), timeout=1.0)
    try:
        connection.request("GET", "/healthz")
        return connection.getresponse().status == 200
    except OSError:
        return False
    finally:
        connection.close()
