"""The commands for the configured cell: `pointchain scan`, `check` and `viewpoints`."""

import argparse
import sys
from pathlib import Path

METHODS = ("matching", "enhanced", "graph")
"""Those of `recognition.model.model.Method`, which is not imported for --help."""
MIN_VIEWS, MAX_VIEWS = 2, 32
"""Limits of --views: those of `cell.config.cell_config.ScanSettings`, which is not imported for --help."""


def add_cell_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `scan`, `check` and `viewpoints`."""
    scan = commands.add_parser(
        "scan",
        help="make one live scan with the configured cell: the arm moves",
        description="Move the arm through the viewpoints and recognise the strings. The model goes to stdout as one "
        "JSON document. Ctrl-C stops the arm.",
    )
    scan.add_argument("out", nargs="?", type=Path, metavar="OUT.mcap", help="new file for the recording (not kept)")
    scan.add_argument("--config", type=Path, metavar="TOML", help="configuration file: the cell and the gripper")
    scan.add_argument(
        "--radius", type=float, metavar="M", help="radius of the strings (the configured one, else measured)"
    )
    scan.add_argument("--method", choices=METHODS, default="graph", help="method of recognition (%(default)s)")
    scan.add_argument("--views", type=_views, metavar="N", help="number of viewpoints (the configured one)")
    scan.set_defaults(run=_scan)

    check = commands.add_parser(
        "check",
        help="test the configured cell step by step; nothing moves",
        description="Test configuration, robot, camera, calibration, table, viewpoints and disk, and report what is "
        "wrong and what to do. Nothing moves. Exit code 1 if a step failed.",
    )
    check.add_argument("--config", type=Path, metavar="TOML", help="configuration file: the cell")
    check.add_argument("--json", action="store_true", help="print one JSON document")
    check.set_defaults(run=_check)

    viewpoints = commands.add_parser(
        "viewpoints",
        help="plan the viewpoints of the configured cell; nothing moves",
        description="Plan the viewpoints from the home posture of the arm and report which are reachable, in which "
        "order, and why others are not. No device is used. Exit code 1 if too few are reachable.",
    )
    viewpoints.add_argument("--config", type=Path, metavar="TOML", help="configuration file: the cell")
    viewpoints.add_argument("--views", type=_views, metavar="N", help="number of viewpoints (the configured one)")
    viewpoints.add_argument(
        "--picture", type=Path, metavar="OUT.png", help="write a picture of arm, workspace and cameras"
    )
    viewpoints.add_argument("--json", action="store_true", help="print the plan as one JSON document")
    viewpoints.set_defaults(run=_viewpoints)


def _views(text: str) -> int:
    if not (text.isascii() and text.isdigit() and MIN_VIEWS <= int(text) <= MAX_VIEWS):
        raise argparse.ArgumentTypeError(f"{text!r}: from {MIN_VIEWS} to {MAX_VIEWS} views are possible")
    return int(text)


def _scan(options: argparse.Namespace) -> int:
    from service.config.loader import ConfigError, load_config

    try:
        config = load_config(options.config)
    except ConfigError as error:
        print(f"pointchain scan: {error}", file=sys.stderr)
        return 1
    from service.cli.commands.scan import ScanOptions, run_scan

    scan_options = ScanOptions(
        options.out, options.radius, options.method, options.views, config.gripper.value, config.limits.recognition_s
    )
    return run_scan(config.cell, scan_options)


def _check(options: argparse.Namespace) -> int:
    from service.cli.commands.check import run_check

    return run_check(options.config, options.json)


def _viewpoints(options: argparse.Namespace) -> int:
    from service.cli.commands.viewpoints import plan_viewpoints

    return plan_viewpoints(options.config, options.views, options.picture, options.json)
