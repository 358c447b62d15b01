"""The parser of `pointchain doctor`; what it needs is imported when it runs."""

import argparse
from pathlib import Path


def add_doctor_command(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Adds `doctor`."""
    doctor = commands.add_parser(
        "doctor",
        help="whether the data folder is whole; --repair mends it",
        description="Compares the database with the files: every recording, acknowledged view and result by its hash, "
        "files without a row, rows without a file, and what a service left unfinished. Looks only, also while the "
        "service runs. Exit code 1 when something is found, or left behind a repair.",
    )
    doctor.add_argument("--config", type=Path, metavar="TOML", help="the service's configuration file")
    doctor.add_argument("--data-dir", type=Path, metavar="DIR", help="the service's data folder")
    doctor.add_argument(
        "--repair",
        action="store_true",
        help="mend what can be; the service must be stopped. Rows are corrected; nothing that holds data is removed, "
        "but put into DATA_DIR/lost+found",
    )
    doctor.add_argument("--quick", action="store_true", help="sizes only: no file is read")
    doctor.add_argument("--json", action="store_true", help="one JSON document instead of words")
    doctor.set_defaults(run=_doctor)


def _doctor(options: argparse.Namespace) -> int:
    from service.doctor.told import doctor

    return doctor(options.config, options.data_dir, options.repair, options.json, options.quick)
