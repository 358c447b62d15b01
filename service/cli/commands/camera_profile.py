"""The command `pointchain camera-profile`."""

import argparse
from pathlib import Path

from service.cli.options import Commands


def add_camera_profile_command(commands: Commands) -> None:
    """Add `camera-profile`."""
    profile = commands.add_parser(
        "camera-profile",
        help="make a simulated camera with the errors of the camera of a recording",
        description="Measure noise, pixel locking, correlation length, warp and holes on the table of a recording, and "
        "write a camera file for `camera.profile` and for simulate with --camera. What the recording does not show "
        "is printed, and keeps the value of the most similar simulated camera.",
    )
    profile.add_argument("recording", type=Path, metavar="SCAN.mcap", help="recording of a table")
    profile.add_argument("out", type=Path, metavar="CAMERA.json", help="camera file to write; it must not exist")
    profile.add_argument(
        "--like",
        choices=("oak-d-pro", "oak-d-sr", "d435"),
        help="camera whose values hold for what is not measured (the most similar one)",
    )
    profile.add_argument(
        "--single",
        action="store_true",
        help="each image is a single exposure, not the median of several (only those of `import frames`)",
    )
    profile.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    from service.interchange.camera_profile import profile_recording

    return profile_recording(options)
