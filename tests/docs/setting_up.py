"""Files of the reader that the commands of a page assume."""

from pathlib import Path

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
        views = simulate(make_scene("overhand-knot", seed=3), camera_model("oak-d-pro"), seed=3).views
        write_bag(folder / "session.bag", "ros1", one_image_each(views, Recorded(encoding="32FC1")))
    if command.startswith("pointchain doctor"):
        (folder / "data").mkdir(exist_ok=True)
