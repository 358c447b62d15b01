"""The commands that are about recordings and their models: `pointchain recognise` and `compare`."""

import argparse
import sys
from pathlib import Path

from service.cell_cli import METHODS

SUFFIXES = (".jsonl", ".parquet")
"""As of `service.archive.formats`, which is not imported for --help."""
MOST_JOBS = 512


def add_archive_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Adds `recognise` and `compare`."""
    recognise = commands.add_parser(
        "recognise",
        help="recordings to point chain models, one JSON document a line",
        description="Recognises the strings in recordings. One JSON document a line on stdout, in the order given; "
        "a file that fails gives a document with `error` on its line and exit code 1 at the end. With --out a run can "
        "be stopped, or killed, and gone on with by the same command.",
    )
    recognise.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="recording (MCAP), or a folder of them, however deep"
    )
    recognise.add_argument(
        "--radius", type=float, metavar="M", help="string radius in metres (the recording's own, else measured)"
    )
    recognise.add_argument("--method", choices=METHODS, default="graph", help="default: %(default)s")
    recognise.add_argument("--config", type=Path, metavar="TOML", help="configuration file: the gripper")
    recognise.add_argument(
        "--out", type=_output, metavar="FILE", help="keep the lines in FILE.jsonl or FILE.parquet instead"
    )
    how = recognise.add_mutually_exclusive_group()
    how.add_argument("--jobs", type=_jobs, metavar="N", help="by N processes of this machine at once")
    how.add_argument(
        "--cluster", metavar="ADDRESS", help="by the workers of this Dask scheduler, who must see the same files"
    )
    how.add_argument(
        "--trace", type=Path, metavar="DIR", help="write a picture of every stage, in a folder for each recording"
    )
    recognise.set_defaults(run=_recognise)

    compare = commands.add_parser(
        "compare",
        help="what changed between two runs over the same recordings",
        description="Compares the models of two outputs of `recognise`, recording by recording: topology, over and "
        "under, and by how much the lines moved. Exit code 0: nothing changed, 1: something did, 2: it cannot be told.",
    )
    compare.add_argument("before", type=Path, metavar="A", help="output of `recognise` (JSON lines or .parquet)")
    compare.add_argument("after", type=Path, metavar="B", help="another one")
    compare.add_argument(
        "--tolerance", type=float, default=1e-5, metavar="M", help="lines may move so far unsaid (%(default)s)"
    )
    compare.add_argument("--json", action="store_true", help="one JSON document instead of words")
    compare.set_defaults(run=_compare)


def _output(text: str) -> Path:
    path = Path(text)
    if path.suffix not in SUFFIXES:
        raise argparse.ArgumentTypeError(f"{text!r} ends neither in {' nor in '.join(SUFFIXES)}")
    return path


def _jobs(text: str) -> int:
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= MOST_JOBS):
        raise argparse.ArgumentTypeError(f"{text!r}: from 1 to {MOST_JOBS} processes are possible")
    return int(text)


def _recognise(options: argparse.Namespace) -> int:
    from service.config import ConfigError, load_config

    try:
        gripper = load_config(options.config).gripper.value
    except ConfigError as error:
        print(f"pointchain recognise: {error}", file=sys.stderr)
        return 1
    from service.archive.one_file import Asked
    from service.archive.recognise import Where, recognise

    asked = Asked(options.method, options.radius, gripper)
    return recognise(options.files, asked, Where(options.out, options.jobs, options.cluster, options.trace))


def _compare(options: argparse.Namespace) -> int:
    from service.archive.compare import compare

    return compare(options.before, options.after, options.tolerance, options.json)
