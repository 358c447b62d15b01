"""Run a program in the root of an image as Docker does.

The root is read-only. The program has no rights, and a network, processes and mounts of its own.
"""

import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

import bare_root
from image import Image

SEE = """
mount --bind "$ROOT" "$ROOT"
{enter}
mount --bind "$DATA" "$ROOT$VOLUME"
mount -t tmpfs -o nosuid,nodev,noexec tmpfs "$ROOT/tmp"
mount -o remount,ro,bind "$ROOT"
ip link set lo up
cd "$ROOT"
exec chroot "$ROOT" "$@"
"""


class Container:
    """One that runs. Its volume is kept in `data`, what it says goes to `log`."""

    def __init__(self, image: Image, variables: Mapping[str, str], data: Path, log: IO[str]) -> None:
        """Starts the image's ENTRYPOINT with its CMD."""
        self._image, self._variables = image, {**image.variables, **variables}
        (volume,) = image.volumes
        # A new volume has what the image has at its place, and its owner.
        subprocess.run(["cp", "--archive", image.root / volume.lstrip("/"), data], check=True)
        start = ["sh", "-ec", SEE.format(enter=bare_root.ENTER), "sh", *self._as_user([*image.entry, *image.command])]
        self._process = subprocess.Popen(
            [*bare_root.APART, "--net", *start],
            env={"PATH": bare_root.PATH, "ROOT": str(image.root), "DATA": str(data), "VOLUME": volume},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        # Until it is in its root, what is run further would be run on the machine.
        while self.running() and not self._in_root():
            time.sleep(0.05)

    def running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def run(self, command: Sequence[str], more: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
        """Runs a further program in it, as `docker exec` does, to its end."""
        spaces = ("--mount", "--pid", "--ipc", "--uts", "--net", "--root", "--wd")
        enter = ["nsenter", f"--target={self._first()}", *spaces, *self._as_user(command, more)]
        return subprocess.run(enter, capture_output=True, text=True, check=False)

    def healthy(self) -> bool:
        """What the HEALTHCHECK says."""
        return self.run(self._image.health).returncode == 0

    def memory_mb(self) -> int:
        """Of all its processes; what they share is counted once."""
        pss = 0
        for process in Path("/proc").glob("[0-9]*"):
            try:
                if (process / "ns/net").readlink() == Path(f"/proc/{self._first()}/ns/net").readlink():
                    rollup = (process / "smaps_rollup").read_text()
                    pss += int(next(line.split()[1] for line in rollup.splitlines() if line.startswith("Pss:")))
            except OSError:  # it has just ended
                continue
        return pss // 1024

    def stop(self, within_s: float) -> tuple[int, float]:
        """Sends the STOPSIGNAL; its exit code and how long it took. One that takes longer is killed."""
        began_s = time.monotonic()
        subprocess.run(["kill", f"-{self._image.stop_signal.removeprefix('SIG')}", str(self._first())], check=True)
        try:
            return self._process.wait(within_s), time.monotonic() - began_s
        except subprocess.TimeoutExpired:
            self.kill()
            raise SystemExit(f"it has not ended within {within_s:.0f} s") from None

    def kill(self) -> None:
        """Ends it at once, if it runs."""
        self._process.send_signal(signal.SIGKILL)  # unshare's end is that of its child, and so of all the others
        self._process.wait()

    def _in_root(self) -> bool:
        try:
            return Path(f"/proc/{self._first()}/root").resolve() == self._image.root
        except (OSError, ValueError):  # it is only just being started
            return False

    def _first(self) -> int:
        """The number, outside, of its process 1."""
        return int(Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text())

    def _as_user(self, command: Sequence[str], more: Mapping[str, str] | None = None) -> list[str]:
        user, group = self._image.user.split(":")
        told = {**self._variables, **(more or {})}
        rights = ["--clear-groups", "--no-new-privs", "--bounding-set=-all", "--inh-caps=-all"]
        return [
            "setpriv", f"--reuid={user}", f"--regid={group}", *rights,
            "env", "-i", f"--chdir={self._image.folder}", *(f"{name}={value}" for name, value in told.items()),
            *command,
        ]  # fmt: skip
