"""Test that workers run in child processes and exit with the benchmark."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cell.simulation.benchmark.worker_pool import map_in_processes, run_in_fresh_process
from tests.processes import runs

pytestmark = pytest.mark.slow

TIMEOUT_S = 60.0
"""Timeout of a test that hangs."""

SLEEPER = """
import os, signal, time
from pathlib import Path
from cell.simulation.benchmark.worker_pool import map_in_processes

def sleep(file):
    Path(file + ".partial").write_text(str(os.getpid()))
    os.rename(file + ".partial", file)
    time.sleep(600)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell makes background processes ignore SIGINT
    list(map_in_processes(sleep, ["a", "b", "c", "d"], jobs=2))
"""
MEMORY = """
import json
from cell.simulation.benchmark.memory import current_rss_bytes, peak_rss_bytes
before = current_rss_bytes()
block = b"x" * (100 * 2**20)
held = current_rss_bytes()
del block
print(json.dumps([before, held, current_rss_bytes(), peak_rss_bytes()]))
"""


def test_results_come_in_order_from_child_processes() -> None:
    assert run_in_fresh_process(os.getpid) != os.getpid()
    assert list(map_in_processes(abs, [-3, 2, -1], jobs=2)) == [3, 2, 1]


def test_a_worker_has_one_thread_and_a_fresh_process_keeps_the_environment() -> None:
    assert list(map_in_processes(os.getenv, ["OMP_NUM_THREADS"], jobs=1)) == ["1"]
    assert run_in_fresh_process(os.getenv, "OMP_NUM_THREADS") == os.getenv("OMP_NUM_THREADS")


def test_an_error_reaches_the_caller() -> None:
    with pytest.raises(ValueError, match="'x'"):
        list(map_in_processes(int, ["1", "x"], jobs=1))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_worker_outlives_the_benchmark(how: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "sleeper.py"
    script.write_text(SLEEPER)
    # In a new session, the signal reaches only the parent process.
    parent = subprocess.Popen([sys.executable, script], cwd=tmp_path, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        begun = [tmp_path / "a", tmp_path / "b"]
        end = time.monotonic() + TIMEOUT_S
        while not all(file.exists() for file in begun):
            assert time.monotonic() < end, "the workers did not start"
            assert parent.poll() is None
            time.sleep(0.02)
        workers = [int(file.read_text()) for file in begun]
        assert all(map(runs, workers))
        parent.send_signal(how)
        assert parent.wait(TIMEOUT_S) != 0
        while any(map(runs, workers)):
            assert time.monotonic() < end, "a worker still runs"
            time.sleep(0.02)
        assert not (tmp_path / "c").exists(), "no more work is started"
    finally:
        parent.kill()
        parent.wait()


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the system does not report the current memory")
def test_the_memory_is_that_of_the_measured_process() -> None:
    # This process holds twice the memory of the measured process, which must not count.
    ours = b"x" * (200 * 2**20)
    output = subprocess.run([sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True).stdout
    del ours
    before, held, after, peak = json.loads(output)
    block = 100 * 2**20
    # The system reports the memory to some dozens of pages.
    assert held - before == pytest.approx(block, rel=0.02)
    assert after - before < 0.02 * block
    assert peak - before == pytest.approx(block, rel=0.02)
