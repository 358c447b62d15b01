"""A bare Debian 12 in a folder, as a new machine or a new image has it, and programs run in it."""

import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
# How this machine reaches its package sources. Where a file is not there, it is not needed.
LENT = (
    *("/etc/resolv.conf", "/etc/apt/sources.list", "/etc/apt/sources.list.d", "/etc/apt/apt.conf.d"),
    *("/etc/pip.conf", "/root/.config/pip", "/etc/uv", "/root/.config/uv"),
    *("/etc/npmrc", "/usr/local/etc/npmrc", "/root/.npmrc"),
)
LENT_VARIABLES = re.compile(
    r"(https?|all|no)_proxy|(pip|uv|npm_config)_.*|.*(_CERT|_CERT_FILE|_CA_CERTS|_CA_BUNDLE)", re.I
)
CERTIFICATES = "etc/ssl/certs/ca-certificates.crt"

# Each program has its own view of mounts and processes, which ends with it.
ENTER = """
mount -t proc proc "$ROOT/proc"
mount -t sysfs -o ro sysfs "$ROOT/sys"
mount --bind /dev "$ROOT/dev"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$ROOT/dev/pts"
mount -t tmpfs tmpfs "$ROOT/dev/shm"
"""
APART = ("unshare", "--mount", "--pid", "--ipc", "--uts", "--fork", "--kill-child=SIGKILL")


def debian(root: Path) -> None:
    """Makes `root` by debootstrap, from the archive that this machine's own apt uses first, and lends it the access."""
    log = root.with_suffix(".log")
    with log.open("w") as told:
        command = ["debootstrap", "--variant=minbase", "bookworm", str(root), _archive()]
        if subprocess.run(command, stdout=told, stderr=told, check=False).returncode != 0:
            raise SystemExit(f"debootstrap failed:\n{log.read_text()[-2000:]}")
    shutil.rmtree(root / "var/cache/apt/archives")
    (root / "etc/apt/sources.list").unlink()
    for name in LENT:
        there, here = Path(name), root / name.lstrip("/")
        here.parent.mkdir(parents=True, exist_ok=True)
        if there.is_dir():
            shutil.copytree(there, here, dirs_exist_ok=True)
        elif there.is_file():
            shutil.copy(there, here)
    # Beside where Debian keeps them also where the package ca-certificates, should it be installed, looks for more.
    if Path("/", CERTIFICATES).is_file():
        for place in (root / CERTIFICATES, root / "usr/local/share/ca-certificates/machine.crt"):
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(Path("/", CERTIFICATES), place)


def copy(bare: Path, root: Path) -> None:
    """Another root like `bare`."""
    subprocess.run(["cp", "--archive", "--reflink=auto", bare, root], check=True)


def lent_variables() -> dict[str, str]:
    """Of this machine's environment, what package managers need to reach their sources."""
    return {name: value for name, value in os.environ.items() if LENT_VARIABLES.fullmatch(name)}


def run(root: Path, command: Sequence[str], variables: Mapping[str, str], folder: str = "/") -> None:
    """Runs a program in `root`, as root and with the machine's network, to its end. Raises CalledProcessError."""
    inside = ["env", "-i", f"--chdir={folder}", *(f"{name}={value}" for name, value in variables.items()), *command]
    script = f'{ENTER}\nexec chroot "$ROOT" {shlex.join(inside)}'
    subprocess.run([*APART, "sh", "-ec", script], env={"PATH": PATH, "ROOT": str(root)}, check=True)


def megabytes(folder: Path) -> int:
    """What it takes on disk."""
    return int(subprocess.run(["du", "-sxm", folder], capture_output=True, text=True, check=True).stdout.split()[0])


def _archive() -> str:
    places = [Path("/etc/apt/sources.list"), *sorted(Path("/etc/apt/sources.list.d").glob("*.[ls][io][su]*"))]
    for place in places:
        if place.suffix in (".list", ".sources") and place.is_file():
            found = re.search(r"^(?:deb(?: +\[[^]]*\])? +|URIs: *)(\S+)", place.read_text(), re.MULTILINE)
            if found:
                return found[1]
    raise SystemExit("this machine's apt has no archive: /etc/apt/sources.list and sources.list.d name none")
