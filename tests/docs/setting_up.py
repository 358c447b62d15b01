"""What the commands of a page take for granted: files of the reader's own."""

from pathlib import Path

from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from tests.cell.bag.bags import Recorded, one_image_each, write_bag


def page(name: str, folder: Path) -> None:
    """Put what a page takes for granted into `folder`."""
    (folder / "cell.toml").write_text("[gripper]\nstroke_m = 0.085\n")


def before(command: str, folder: Path) -> None:
    """Put what a command needs beside what those before it have made into `folder`."""
    if "session.bag" in command and not (folder / "session.bag").exists():
        views = simulate(make_scene("overhand-knot", seed=3), camera_model("oak-d-pro"), seed=3).views
        write_bag(folder / "session.bag", "ros1", one_image_each(views, Recorded(encoding="32FC1")))
    if command.startswith("pointchain doctor"):
        (folder / "data").mkdir(exist_ok=True)
