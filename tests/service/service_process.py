"""A service in a separate process, for tests that end it."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx2

ROOT = Path(__file__).resolve().parents[2]
SERVE = "import sys; from service.cli.main import main; sys.exit(main(['serve', '--unsupervised']))"


@contextmanager
def process(data_dir: Path, log: Path, **variables: str) -> Iterator[tuple[subprocess.Popen[bytes], httpx2.Client]]:
    """Start a service in a separate process, and yield the process and a client."""
    environment = os.environ | {"POINTCHAIN_DATA_DIR": str(data_dir), "POINTCHAIN_PORT": "0"} | variables
    with log.open("wb") as output:
        running = subprocess.Popen(
            [sys.executable, "-c", SERVE], cwd=ROOT, env=environment, stdout=output, stderr=output
        )
    try:
        while not (address := re.search(r"pointchain: (http://\S+) \(API", log.read_text())):
            assert running.poll() is None, log.read_text()
            time.sleep(0.02)
        with httpx2.Client(base_url=address[1], timeout=60) as client:
            yield running, client
    finally:
        running.kill()
        running.wait()


def answers(client: httpx2.Client) -> bool:
    """Return whether the service answers. Its port may be open before that."""
    try:
        return client.get("/api/scans?limit=1").status_code == 200
    except httpx2.TransportError:
        return False
