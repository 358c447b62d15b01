"""What a stranger would do, on a bare Debian 12: the README's two commands, and what docker/ is for.

Neither a Docker engine nor an image is needed: debootstrap makes what stands for both a machine and an image.
"""

import argparse
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import bare_root
import image as images
import yaml
from container import Container

PROJECT = Path(__file__).resolve().parents[2]
DOCKER = PROJECT / "docker"
SERVICE = "pointchain"
"""Of compose.yaml: the one that starts unless told otherwise."""
START_S = 90.0

ASK_MANUAL = """
from urllib.request import ProxyHandler, build_opener
opener = build_opener(ProxyHandler({}))
opener.open("http://127.0.0.1:8123/readyz", timeout=10)
page = opener.open("http://127.0.0.1:8123/manual/", timeout=10)
assert b"<title>Pointchain manual" in page.read()
"""
REPLAY = """
from pathlib import Path
from pointchain_client import Client
with Client("http://127.0.0.1:8123") as cell:
    assert len(cell.model(cell.replay(Path("knot.mcap"))).crossings) == 3
"""
INSTALLED = f"""
PATH=$PWD/.uv/bin:/root/.local/bin:$PATH
uv tool install --quiet --python '>=3.11,<3.13' --constraints requirements.lock dist/pointchain-*.whl
uv venv --quiet --python '>=3.11' /root/planner
uv pip install --quiet --python /root/planner --constraints requirements.lock dist/pointchain_client-*.whl
cd /root
pointchain --version
pointchain simulate knot.mcap --scene overhand-knot --seed 3
pointchain recognise knot.mcap > knot.json
pointchain bench && exit 1 || test $? = 2  # it needs a checkout
POINTCHAIN_DATA_DIR=/root/data POINTCHAIN_PORT=8123 pointchain serve &
service=$!
timeout 120 sh -c 'until python3 -c "$0" 2>/dev/null; do sleep 1; done' {shlex.quote(ASK_MANUAL)}
NO_PROXY=127.0.0.1 /root/planner/bin/python -c {shlex.quote(REPLAY)}
kill $service
wait $service
"""
USE = """
import json, os, subprocess, time
from pathlib import Path
from urllib.request import Request, urlopen

def call(path, body=None, kind="application/json"):
    headers = {"Authorization": "Bearer " + os.environ["TOKEN"], "Content-Type": kind}
    with urlopen(Request("http://127.0.0.1:8000" + path, body, headers), timeout=60) as answer:
        return json.load(answer)

subprocess.run(["pointchain", "simulate", "/tmp/knot.mcap", "--scene", "overhand-knot", "--seed", "3"], check=True)
recording = call("/api/recordings", Path("/tmp/knot.mcap").read_bytes(), "application/octet-stream")["id"]
for request in ({"mode": "live"}, {"mode": "replay", "recording": recording}):
    scan = call("/api/scans", json.dumps(request).encode())
    while not scan["final"]:
        time.sleep(0.2)
        scan = call(scan["links"]["self"])
    model = call(scan["links"]["model"])
    print(f"{scan['mode']}: {scan['state']}, {len(model['chains'])} chain, {len(model['crossings'])} crossings")
"""
ASK = """
import sys, urllib.error, urllib.request
try:
    print(urllib.request.urlopen("http://127.0.0.1:8000" + sys.argv[1], timeout=10).status)
except urllib.error.HTTPError as error:
    print(error.code)
"""


def main() -> int:
    parser = argparse.ArgumentParser(prog=".ci/nightly", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all of them unless told")
    parser.add_argument("--work", type=Path, help="folder to work in, kept afterwards (one in /tmp)")
    options = parser.parse_args()
    wrong = [part for part in options.parts if part not in PARTS]
    if wrong:
        parser.error(f"there is no part {', '.join(wrong)}")
    work = Path(tempfile.mkdtemp(prefix="rehearsal-")) if options.work is None else options.work.resolve()
    work.mkdir(exist_ok=True)
    try:
        bare = work / "bare"
        if not bare.exists():
            timed("a bare Debian 12", lambda: bare_root.debian(bare))
        for part in options.parts or PARTS:
            PARTS[part](bare, work)
    finally:
        if options.work is None:
            shutil.rmtree(work)
    return 0


def timed(what: str, do: Callable[[], object]) -> None:
    """Does it, and prints how long it took."""
    print(f"--- {what}", flush=True)
    began_s = time.monotonic()
    try:
        do()
    except subprocess.CalledProcessError as error:
        raise SystemExit(f"--- {what}: failed with exit code {error.returncode}") from error
    print(f"--- {what}: {time.monotonic() - began_s:.0f} s", flush=True)


def on_a_bare_machine(command: str, then: str = "") -> Callable[[Path, Path], None]:
    """The README's command on a machine that has git and make, and nothing else, in a fresh clone."""

    def part(bare: Path, work: Path) -> None:
        machine = work / f"machine-{command}"
        shutil.rmtree(machine, ignore_errors=True)
        bare_root.copy(bare, machine)
        variables = {"PATH": bare_root.PATH, "HOME": "/root", **bare_root.lent_variables()}
        install = "apt-get -qq install -y --no-install-recommends git make"
        tools = f"(apt-get -qq update && DEBIAN_FRONTEND=noninteractive {install}) >/dev/null 2>&1"
        bare_root.run(machine, ["sh", "-c", tools], variables)
        subprocess.run(
            ["git", "-c", "advice.detachedHead=false", "clone", "--quiet", PROJECT, machine / "root/pointchain"],
            check=True,
        )
        timed(f"make {command}", lambda: bare_root.run(machine, ["make", command], variables, "/root/pointchain"))
        print(f"{bare_root.megabytes(machine) - bare_root.megabytes(bare)} MB more on disk than before")
        if then:
            timed(then, lambda: bare_root.run(machine, ["sh", "-euc", then], variables, "/root/pointchain"))

    return part


def image(bare: Path, work: Path) -> None:
    """The Dockerfile's steps, then what they made, started as compose.yaml says and used."""
    for folder in [*work.glob("stage*"), work / "context", work / "volume"]:
        shutil.rmtree(folder, ignore_errors=True)
    images.context(PROJECT, DOCKER / "Dockerfile.dockerignore", work / "context")
    made: list[images.Image] = []
    timed("the image", lambda: made.append(images.build(DOCKER / "Dockerfile", work / "context", bare, work)))
    size = bare_root.megabytes(made[0].root)
    print(f"{size} MB, {size - bare_root.megabytes(bare)} MB of it on top of Debian; starts {images.shown(made[0])}")
    service = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"][SERVICE]
    log = work / "container.log"
    with log.open("w") as told:
        container = Container(made[0], service["environment"], work / "volume", told)
    try:
        use(container, log, float(service["stop_grace_period"].removesuffix("s")))
    except BaseException:
        print(log.read_text()[-8000:])
        raise
    finally:
        container.kill()


def use(container: Container, log: Path, grace_s: float) -> None:
    """Waits until it is healthy, scans, and ends it."""
    began_s = time.monotonic()
    while not (container.running() and container.healthy()):
        assert container.running(), "it has ended"
        assert time.monotonic() - began_s < START_S, "it is not healthy"
        time.sleep(0.5)
    print(f"healthy after {time.monotonic() - began_s:.1f} s, {container.memory_mb()} MB of memory")
    (token,) = re.findall(r"^pct_\S+$", log.read_text(), re.MULTILINE)
    for address, status in (("/", "200"), ("/manual/", "200"), ("/api/cell", "401")):
        asked = container.run(["python", "-c", ASK, address])
        assert asked.stdout.strip() == status, f"{address}: {asked.stdout}{asked.stderr}"
    used = container.run(["python", "-c", USE], {"TOKEN": token})
    assert used.returncode == 0, used.stderr
    print(used.stdout, end="")
    assert used.stdout.count(": succeeded, 1 chain") == 2, used.stderr
    print(f"{container.memory_mb()} MB of memory after two scans")
    code, took_s = container.stop(grace_s)
    assert code == 0, f"exit code {code}"
    print(f"shut down cleanly after {took_s:.1f} s")


PARTS = {
    "demo": on_a_bare_machine("demo"),
    "test": on_a_bare_machine("test"),
    "wheel": on_a_bare_machine("wheel", INSTALLED),
    "image": image,
}

if __name__ == "__main__":
    sys.exit(main())
