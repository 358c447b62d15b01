"""The parser of `pointchain doctor`. The command imports its modules when it runs."""

import argparse

from service.cli.options import Commands, add_json_option, add_service_options


def add_integrity_command(commands: Commands) -> None:
    """Add `doctor`."""
    doctor = commands.add_parser(
        "doctor",
        help="check the integrity of the data folder; repair it with --repair",
        description="Compare the database with the files: each recording, acknowledged view and result by its hash, "
        "files without a row, rows without a file, and unfinished work. Changes nothing without --repair, and may run "
        "beside the service. Exit code 1 if something is found, or remains after a repair.",
    )
    add_service_options(doctor)
    doctor.add_argument(
        "--repair",
        action="store_true",
        help="repair what can be repaired; the service must be stopped. The database is copied to DATA_DIR/lost+found "
        "first. No file that holds data is deleted: it is moved to that folder",
    )
    doctor.add_argument("--quick", action="store_true", help="compare sizes only; read no file")
    add_json_option(doctor)
    doctor.set_defaults(run=_doctor)


def _doctor(options: argparse.Namespace) -> int:
    from service.cli.commands.integrity_report import run_doctor

    return run_doctor(options.config, options.data_dir, options.repair, options.json, options.quick)
