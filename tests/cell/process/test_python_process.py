"""Python child processes: start, end, and the end of the parent."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cell.process.python_process import end_process, start_python
from tests.processes import runs

pytestmark = pytest.mark.slow

ROOT = str(Path(__file__).parents[3])
TIMEOUT_S = 20.0


def wait_for_end(pid: int) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while runs(pid):
        assert time.monotonic() < deadline, "the process still runs"
        time.sleep(0.02)


def test_the_child_imports_like_the_parent_and_not_from_its_folder(tmp_path: Path) -> None:
    (tmp_path / "cell.py").write_text("raise SystemExit(3)")
    process = start_python("-c", "import cell.process", cwd=tmp_path)
    assert end_process(process, TIMEOUT_S) == 0


def test_the_child_has_the_given_environment_and_a_new_session(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTCHAIN_SECRET", "1")
    program = "import os; print('POINTCHAIN_SECRET' in os.environ, os.environ['GIVEN'], os.getsid(0) == os.getpid())"
    process = start_python("-c", program, environment={"GIVEN": "2"}, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.read() == b"False 2 True\n"
    assert end_process(process, TIMEOUT_S) == 0
    assert process.stdout.closed


@pytest.mark.parametrize(("handler", "code"), [("SIG_DFL", -signal.SIGTERM), ("SIG_IGN", -signal.SIGKILL)])
def test_a_child_that_ignores_sigterm_is_killed(handler: str, code: int) -> None:
    program = f"import signal, time; signal.signal(signal.SIGTERM, signal.{handler}); print(flush=True); time.sleep(60)"
    process = start_python("-c", program, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    assert end_process(process, 0.3, terminate=True) == code
    assert end_process(process) == code, "a second call does nothing"


PARENT = '''
import os, subprocess, sys, time
sys.path.insert(0, {root!r})
from cell.process.python_process import start_python
program = """import os, time
from cell.process.python_process import exit_with_parent
os.dup2(0, {pipe})
exit_with_parent({pipe})
print("ready", flush=True)
time.sleep(60)"""
child = start_python("-c", program, stdin=subprocess.PIPE)
fork = os.fork() if {forks} else None
if fork == 0:
    time.sleep(60)
    os._exit(0)
print(child.pid, fork or 0, flush=True)
time.sleep(60)
'''


@pytest.mark.parametrize(("forks", "pipe"), [(False, 0), (True, 0), (False, 1500)])
def test_the_child_exits_with_its_parent_even_if_a_fork_holds_the_pipe(forks: bool, pipe: int) -> None:
    # a service with many connections gives its children pipes with large numbers
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if limit != resource.RLIM_INFINITY and limit <= pipe:
        pytest.skip("the limit of open files is too low on this machine")
    script = PARENT.format(root=ROOT, forks=forks, pipe=pipe)
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        lines = {parent.stdout.readline() for _ in range(2)}
        child, fork = map(int, (lines - {"ready\n"}).pop().split())
        try:
            parent.kill()
            parent.wait(TIMEOUT_S)
            wait_for_end(child)
        finally:
            if fork:
                os.kill(fork, signal.SIGKILL)
