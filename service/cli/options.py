"""Options that several commands have, with the same spelling and the same limits."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from recognition.grasping.gripper import Gripper
    from recognition.request import RecognitionRequest

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""The commands of a parser, to which one more is added."""

METHODS = ("matching", "enhanced", "graph")
"""Those of `recognition.model.model.Method`, which is not imported for --help."""


def add_config_option(parser: argparse.ArgumentParser, used: str = "the cell") -> None:
    """Add --config.

    Args:
        parser: Parser of the command.
        used: What the command uses of the file.
    """
    parser.add_argument("--config", type=Path, metavar="TOML", help=f"configuration file: {used}")


def add_service_options(parser: argparse.ArgumentParser) -> None:
    """Add --config and --data-dir of a command that works on the data folder of the service."""
    parser.add_argument("--config", type=Path, metavar="TOML", help="configuration file of the service")
    parser.add_argument("--data-dir", type=Path, metavar="DIR", help="data folder of the service")


def add_json_option(parser: argparse.ArgumentParser, printed: str = "one JSON document") -> None:
    """Add --json.

    Args:
        parser: Parser of the command.
        printed: What the command then prints.
    """
    parser.add_argument("--json", action="store_true", help=f"print {printed}")


def add_method_option(parser: argparse.ArgumentParser) -> None:
    """Add --method, the method of recognition."""
    parser.add_argument("--method", choices=METHODS, default="graph", help="method of recognition (%(default)s)")


def add_recognition_options(parser: argparse.ArgumentParser, default_radius: str) -> None:
    """Add --radius, --method and --all-grasps, which `recognition_request` reads.

    Args:
        parser: Parser of the command.
        default_radius: Which radius is used without the option.
    """
    parser.add_argument("--radius", type=float, metavar="M", help=f"radius of the strings ({default_radius})")
    add_method_option(parser)
    parser.add_argument(
        "--all-grasps", action="store_true", help="also list the grasps on parts of strings with a doubt"
    )


def recognition_request(
    options: argparse.Namespace, gripper: "Gripper", settings: "Mapping[str, float] | None" = None
) -> "RecognitionRequest":
    """Return the request of a command with `add_recognition_options`.

    Args:
        options: Parsed options.
        gripper: Configured gripper.
        settings: Parameter values by name. None: none are set.
    """
    from recognition.request import RecognitionRequest

    return RecognitionRequest(options.method, options.radius, settings or {}, gripper, options.all_grasps)


def whole_number(low: int, high: int, unit: str) -> Callable[[str], int]:
    """Return the type of an option that takes a whole number.

    Args:
        low: Smallest accepted number.
        high: Largest accepted number.
        unit: What is counted, in the plural, for the message about a refused number.
    """

    def parse(text: str) -> int:
        if not (text.isascii() and text.isdigit() and low <= int(text) <= high):
            raise argparse.ArgumentTypeError(f"{text!r}: from {low} to {high} {unit} are possible")
        return int(text)

    return parse
