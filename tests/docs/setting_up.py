"""Files of the reader that the commands of a page assume."""

import shlex
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from tests.cell.bag.bags import Recorded, one_image_each, write_bag


def prepare_page(name: str, folder: Path) -> None:
    """Write the files that a page assumes into `folder`."""
    (folder / "cell.toml").write_text("[gripper]\nstroke_m = 0.085\n")


def prepare_command(command: str, folder: Path) -> None:
    """Write the files that a command needs, and that no earlier command made, into `folder`."""
    if "session.bag" in command and not (folder / "session.bag").exists():
        views = simulate(make_scene("overhand-knot", seed=3), camera_model("ideal"), seed=3).views
        write_bag(folder / "session.bag", "ros1", one_image_each(views, Recorded(encoding="32FC1")))
    if command.startswith("pointchain doctor"):
        (folder / "data").mkdir(exist_ok=True)


_SIMULATED = TemporaryDirectory(prefix="pointchain-docs-")
"""Recordings that earlier pages have simulated. The same arguments give the same content."""
_SUFFIXES = (".mcap", ".truth.json")


def copy_simulated(command: str, folder: Path) -> bool:
    """Copy the recording of a `pointchain simulate` command into `folder`, if an earlier page has made it.

    Returns:
        Whether it was copied. It is not for other commands.
    """
    if not command.startswith("pointchain simulate"):
        return False
    out, kept = _simulated_files(command, folder)
    if not kept.with_suffix(".mcap").exists():
        return False
    for suffix in _SUFFIXES:
        shutil.copy(kept.with_suffix(suffix), out.with_suffix(suffix))
    return True


def keep_simulated(command: str, folder: Path) -> None:
    """Keep the recording that a `pointchain simulate` command has made. Other commands are ignored."""
    if command.startswith("pointchain simulate"):
        out, kept = _simulated_files(command, folder)
        for suffix in _SUFFIXES:
            shutil.copy(out.with_suffix(suffix), kept.with_suffix(suffix))


def _simulated_files(command: str, folder: Path) -> tuple[Path, Path]:
    """Return the recording that a command writes and its copy, whose name is made of the other arguments."""
    arguments = shlex.split(command)
    (out,) = (argument for argument in arguments if argument.endswith(".mcap"))
    name = "".join(argument for argument in arguments if argument != out)
    return folder / out, Path(_SIMULATED.name) / name.replace("/", "-").replace(".", "-")
