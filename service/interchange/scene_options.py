"""Options of every `pointchain import`: string radius, table, workspace and hand-eye calibration."""

import argparse
import math
import sys
from typing import Any

BOX = ("X0", "X1", "Y0", "Y1", "Z0", "Z1")


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the scene."""
    parser.add_argument("--radius", type=float, metavar="M", help="string radius, to be kept in the recording")
    parser.add_argument("--table-z", type=float, default=0.0, metavar="M", help="height of the table (%(default)s)")
    parser.add_argument(
        "--workspace", type=float, nargs=6, metavar=BOX, help="box in the base frame, metres (default: everything)"
    )


def given_radius(options: argparse.Namespace) -> float | None:
    """Return the string radius, metres; None if the option is not given.

    Raises:
        InvalidParametersError: Recognition does not accept the radius, for example because it is in millimetres.
    """
    from recognition.parameters import ChainParameters

    return None if options.radius is None else ChainParameters.for_radius(options.radius).r


def given_box(
    options: argparse.Namespace,
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None:
    """Return the workspace ((x0, x1), (y0, y1), (z0, z1)); None if the option is not given."""
    box = options.workspace
    return None if box is None else ((box[0], box[1]), (box[2], box[3]), (box[4], box[5]))


def given_hand_eye(options: argparse.Namespace, command: str) -> dict[str, Any]:
    """Return `T_flange_camera` and `hand_eye` (its origin), or an empty dictionary if the option is not given.

    The file may have any age, because the images may be old too. Warnings about it go to stderr.

    Args:
        options: Parsed options.
        command: Name of the command, for the warnings.

    Raises:
        HandEyeError: The file cannot be used.
    """
    from calibration.storage.hand_eye_file import load_hand_eye

    if options.hand_eye is None:
        return {}
    hand_eye = load_hand_eye(options.hand_eye, math.inf)
    for warning in hand_eye.warnings:
        print(f"{command}: {warning}", file=sys.stderr)
    return {"T_flange_camera": hand_eye.T_flange_camera, "hand_eye": f"{options.hand_eye.name} {hand_eye.sha256}"}
