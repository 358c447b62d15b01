"""The commands for recordings and their models: `pointchain recognise` and `compare`."""

import argparse
import math
import sys
from pathlib import Path

from service.cli.options import (
    Commands,
    add_config_option,
    add_json_option,
    add_recognition_options,
    recognition_request,
    whole_number,
)

SUFFIXES = (".jsonl", ".parquet")
"""Those of `service.batch.formats`, which is not imported for --help."""
MAX_JOBS = 512
"""Maximum number of processes."""


def add_batch_commands(commands: Commands) -> None:
    """Add `recognise` and `compare`."""
    recognise = commands.add_parser(
        "recognise",
        help="recognise recordings and print one JSON document per line",
        description="Recognise the strings in recordings. Print one JSON document per line on stdout, in the order "
        "given. A file that fails gives a document with `error` on its line, and exit code 1 at the end. With --out a "
        "run that was stopped or killed continues with the same command.",
    )
    recognise.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="recording (MCAP), or folder with recordings, including its subfolders",
    )
    add_recognition_options(recognise, "the one in the recording, else measured")
    recognise.add_argument(
        "--set",
        action="append",
        type=_setting,
        default=[],
        dest="settings",
        metavar="NAME=VALUE",
        help="set a parameter of the method in place of its value for the radius, as r_cn=0.013; lengths in metres; "
        "may be repeated",
    )
    add_config_option(recognise, "the gripper")
    recognise.add_argument(
        "--out", type=_output, metavar="FILE", help="write to FILE.jsonl or FILE.parquet instead of stdout"
    )
    mode = recognise.add_mutually_exclusive_group()
    jobs = whole_number(1, MAX_JOBS, "processes")
    mode.add_argument("--jobs", type=jobs, metavar="N", help="use N processes of this machine (1)")
    mode.add_argument(
        "--cluster", metavar="ADDRESS", help="use the workers of this Dask scheduler, which must see the same files"
    )
    mode.add_argument(
        "--trace", type=Path, metavar="DIR", help="write a picture of each stage, into a folder per recording"
    )
    recognise.set_defaults(run=_recognise)

    compare = commands.add_parser(
        "compare",
        help="compare two runs over the same recordings",
        description="Compare the models of two outputs of `recognise`, recording by recording: topology, over and "
        "under, and how far the lines moved. Exit code 0: nothing changed, 1: something changed, 2: the comparison "
        "failed.",
    )
    compare.add_argument("before", type=Path, metavar="A", help="first output of `recognise` (JSON lines or .parquet)")
    compare.add_argument("after", type=Path, metavar="B", help="second output")
    compare.add_argument(
        "--tolerance",
        type=float,
        default=1e-5,
        metavar="M",
        help="distance below which a moved line is not reported (%(default)s)",
    )
    add_json_option(compare)
    compare.set_defaults(run=_compare)


def _output(text: str) -> Path:
    path = Path(text)
    if path.suffix not in SUFFIXES:
        raise argparse.ArgumentTypeError(f"{text!r} does not end in {' or '.join(SUFFIXES)}")
    return path


def _setting(text: str) -> tuple[str, float]:
    """Parse NAME=VALUE. The name is checked later, because the parameters are not imported for --help."""
    name, separator, value = text.partition("=")
    if not (separator and name):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE, as in r_cn=0.013")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{name} is {value!r}; a finite number is needed")
    return name, number


def _recognise(options: argparse.Namespace) -> int:
    from recognition.errors import InvalidParametersError
    from service.config.loader import ConfigError, load_config

    try:
        settings = _settings(options)
        gripper = load_config(options.config).gripper.to_gripper()
    except (ConfigError, InvalidParametersError) as error:
        print(f"pointchain recognise: {error}", file=sys.stderr)
        return 1
    from service.batch.recognise import RunOptions, recognise

    request = recognition_request(options, gripper, settings)
    return recognise(options.files, request, RunOptions(options.out, options.jobs, options.cluster, options.trace))


def _settings(options: argparse.Namespace) -> dict[str, float]:
    """Return the values of --set by name.

    Raises:
        InvalidParametersError: A name is unknown or given twice, or a value is not accepted.
    """
    from recognition.errors import InvalidParametersError
    from recognition.parameters import ChainParameters, check_settings

    names = [name for name, _ in options.settings]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidParametersError(f"--set gives {twice[0]} more than once: give it once")
    if "r" in names:
        raise InvalidParametersError("--set does not take r, the string radius: use --radius")
    settings = dict(sorted(options.settings))
    check_settings(settings, options.method)
    if settings and options.radius is not None:
        ChainParameters.for_radius(options.radius).with_settings(settings)
    return settings


def _compare(options: argparse.Namespace) -> int:
    from service.batch.compare import compare

    return compare(options.before, options.after, options.tolerance, options.json)
