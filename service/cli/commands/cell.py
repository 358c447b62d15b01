"""The commands for the configured cell: `pointchain scan`, `check` and `viewpoints`."""

import argparse
import sys
from pathlib import Path

from cell.config.scan_views import Views, parse_views
from service.cli.options import (
    Commands,
    add_config_option,
    add_json_option,
    add_recognition_options,
    recognition_request,
)


def add_cell_commands(commands: Commands) -> None:
    """Add `scan`, `check` and `viewpoints`."""
    scan = commands.add_parser(
        "scan",
        help="make one live scan with the configured cell: the arm moves",
        description="Move the arm through the viewpoints and recognise the strings. The model goes to stdout as one "
        "JSON document. Ctrl-C stops the arm.",
    )
    scan.add_argument("out", nargs="?", type=Path, metavar="OUT.mcap", help="new file for the recording (not kept)")
    add_config_option(scan, "the cell and the gripper")
    add_recognition_options(scan, "the configured one, else measured")
    _add_views_option(scan)
    scan.set_defaults(run=_scan)

    check = commands.add_parser(
        "check",
        help="test the configured cell step by step; nothing moves",
        description="Test configuration, robot, camera, calibration, table, viewpoints, grasps and disk, and report "
        "what is wrong and what to do. Nothing moves. Exit code 1 if a step failed.",
    )
    add_config_option(check)
    add_json_option(check)
    check.set_defaults(run=_check)

    viewpoints = commands.add_parser(
        "viewpoints",
        help="plan the viewpoints of the configured cell; nothing moves",
        description="Plan the viewpoints from the home posture of the arm and report which are reachable, in which "
        "order, and why others are not. No device is used. Exit code 1 if too few are reachable.",
    )
    add_config_option(viewpoints)
    _add_views_option(viewpoints)
    viewpoints.add_argument(
        "--picture", type=Path, metavar="OUT.png", help="write a picture of arm, workspace and cameras"
    )
    add_json_option(viewpoints, "the plan as one JSON document")
    viewpoints.set_defaults(run=_viewpoints)


def _add_views_option(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--views",
        type=_views,
        metavar="N",
        help="number of viewpoints, or auto: four, and four more only if something is doubtful (as configured)",
    )


def _views(text: str) -> Views:
    try:
        return parse_views(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error}") from error


def _scan(options: argparse.Namespace) -> int:
    from service.config.loader import ConfigError, load_config

    try:
        config = load_config(options.config)
    except ConfigError as error:
        print(f"pointchain scan: {error}", file=sys.stderr)
        return 1
    from service.cli.commands.scan import ScanOptions, run_scan

    scan_options = ScanOptions(
        recording=options.out,
        request=recognition_request(options, config.gripper.to_gripper()),
        views=options.views,
        timeout_s=config.limits.recognition_s,
    )
    return run_scan(config.cell, scan_options)


def _check(options: argparse.Namespace) -> int:
    from service.cli.commands.check import run_check

    return run_check(options.config, options.json)


def _viewpoints(options: argparse.Namespace) -> int:
    from service.cli.commands.viewpoints import plan_viewpoints

    return plan_viewpoints(options.config, options.views, options.picture, options.json)
