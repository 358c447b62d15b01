"""`pointchain doctor`: check the integrity of the data folder, and repair it if requested."""

import argparse
import json
import sys

from service.cli.options import Commands, add_json_option, add_service_options


def add_doctor_command(commands: Commands) -> None:
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
    import sqlite3

    from service.cli.commands.doctor_report import format_report, report_document
    from service.config.loader import ConfigError, load_config
    from service.integrity.check import check_store, check_target
    from service.integrity.repair import repair
    from service.storage.data_folder import DataFolderError

    try:
        store = check_target(load_config(options.config, data_dir=options.data_dir), options.quick)
    except ConfigError as error:
        print(f"pointchain doctor: {error}", file=sys.stderr)
        return 1
    repaired: list[str] = []
    try:
        if options.repair and store.root.is_dir():

            def report(message: str) -> None:
                repaired.append(message)
                print(f"pointchain doctor: {message}", file=sys.stderr, flush=True)

            found = repair(store, report)
        else:
            found = check_store(store)
    except (DataFolderError, OSError, sqlite3.Error) as error:
        print(f"pointchain doctor: {error}", file=sys.stderr)
        return 1
    print(json.dumps(report_document(store.root, found, repaired)) if options.json else format_report(found))
    return 1 if found.findings else 0
