"""Run code with the real ur_rtde in a separate process, because it may hang, crash or hold the GIL."""

import json
import subprocess
import sys
from typing import Any

TIMEOUT_S = 60.0

CONNECT = """
receive = rtde_receive.RTDEReceiveInterface(host)
control = rtde_control.RTDEControlInterface(host)
"""

_HEAD = """
import json, os, sys, time
import rtde_control, rtde_receive
host, arguments = sys.argv[1], json.loads(sys.argv[2])
def answer(**values):
    print("ANSWER" + json.dumps(values), flush=True)
    os._exit(0)  # the destructors wait half a second each
def say(word):
    print(word, flush=True)
    sys.stdin.readline()
"""


def _command(host: str, code: str, arguments: dict[str, Any]) -> list[str]:
    return [sys.executable, "-c", _HEAD + code, host, json.dumps(arguments)]


def run(host: str, code: str, **arguments: Any) -> dict[str, Any]:
    """Run the code, which has `host` and `arguments`, and return the values that it passes to `answer`."""
    done = subprocess.run(_command(host, code, arguments), capture_output=True, timeout=TIMEOUT_S, check=False)
    lines = [line for line in done.stdout.decode().splitlines() if line.startswith("ANSWER")]
    assert lines, f"exit code {done.returncode}, no answer:\n{done.stdout.decode()}\n{done.stderr.decode()}"
    return json.loads(lines[-1].removeprefix("ANSWER"))


class Talk:
    """Running code that calls `say(word)` and waits there until the block ends its process."""

    def __init__(self, host: str, code: str, **arguments: Any) -> None:
        self.process = subprocess.Popen(
            _command(host, code, arguments), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )

    def __enter__(self) -> "Talk":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()

    def hear(self, word: str) -> None:
        """Wait until the code says the word."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.decode().strip() == word:
                return
        raise AssertionError(f"the client ended (exit code {self.process.wait()}) before it said {word!r}")
