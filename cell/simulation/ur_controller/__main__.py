"""The virtual controller as a process, `python -m cell.simulation.ur_controller --host 127.0.0.2`."""

import argparse
import asyncio
import contextlib
import json
import os
import signal
import socket
import sys

from cell.process.python_process import exit_with_parent
from cell.simulation.ur_controller.servers.sockets import listening

FIRST, LAST = 2, 250
"""Range of the addresses 127.0.0.x that are tried by default. ur_rtde omits a check for 127.0.0.1."""


def main() -> int:
    """Run until interrupted. Print the address as one line of JSON on standard output."""
    parser = argparse.ArgumentParser(
        prog="python -m cell.simulation.ur_controller", description="A virtual UR controller."
    )
    parser.add_argument("--model", default="ur5e", help="ur3e, ur5e or ur10e")
    parser.add_argument("--host", help="loopback address (default: the first free one from 127.0.0.2)")
    parser.add_argument("--time-factor", type=float, default=1.0, help="factor on the speed of the arm")
    parser.add_argument("--q-rad", type=float, nargs=6, help="joint angles at the start")
    parser.add_argument("--table-z-m", type=float, help="safety plane that the flange must not come below")
    parser.add_argument("--software", default="5.25.1", help="reported software version")
    parser.add_argument("--pose-error-m", type=float, default=0.0, help="rms error of the position (%(default)s)")
    parser.add_argument("--pose-error-rad", type=float, default=0.0, help="rms error of the orientation (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of these errors (%(default)s)")
    parser.add_argument("--with-parent", action="store_true", help="exit when standard input is closed")
    options = parser.parse_args()
    try:
        major, minor, bugfix = (int(part) for part in options.software.split("."))
    except ValueError:
        parser.error(f"--software {options.software}: three numbers are needed, as 5.25.1")
    if not (options.pose_error_m >= 0 and options.pose_error_rad >= 0 and options.seed >= 0):
        parser.error("--pose-error-m, --pose-error-rad and --seed must not be negative")
    if not options.time_factor > 0:
        parser.error("--time-factor must be positive")
    try:
        host, sockets = _listen(options.host)
    except OSError as error:
        where = options.host or f"any address 127.0.0.{FIRST} to 127.0.0.{LAST}"
        reason = f"a virtual controller can't listen on {where}: {error.strerror or error}"
        print(json.dumps({"error": reason}), flush=True)
        return 1

    # imported only now, so that an address in use is reported before the slow imports
    from cell.kinematics.ur_kinematics import ARMS
    from cell.simulation.ur_controller.controller import HOME_Q_RAD, ControllerOptions, serve

    if options.model not in ARMS:
        parser.error(f"--model {options.model}: one of {', '.join(ARMS)} is needed")
    made = ControllerOptions(
        options.model,
        tuple(options.q_rad or HOME_Q_RAD),
        options.time_factor,
        options.table_z_m,
        (major, minor, bugfix, 0),
        options.pose_error_m,
        options.pose_error_rad,
        options.seed,
    )
    if options.with_parent:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
        exit_with_parent()
    print(json.dumps({"host": host, "pid": os.getpid()}), flush=True)
    asyncio.run(serve(made, sockets))
    return 0


def _listen(host: str | None) -> tuple[str, dict[int, socket.socket]]:
    """Return the address and its listening sockets. Raise OSError if no address is free."""
    last: OSError | None = None
    for candidate in [host] if host else [f"127.0.0.{k}" for k in range(FIRST, LAST + 1)]:
        try:
            return candidate, listening(candidate)
        except OSError as error:
            last = error
    assert last is not None
    raise last


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        sys.exit(main())
