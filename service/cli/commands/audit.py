"""`pointchain audit`: print the audit log of the service. The service may be running."""

import argparse
import json
import sys
from datetime import UTC, datetime

from service.cli.options import Commands, add_json_option, add_service_options, whole_number
from service.clock import format_utc

MAX_ENTRIES = 1_000_000
"""Maximum of --limit."""


def add_audit_command(commands: Commands) -> None:
    """Add `audit`."""
    audit = commands.add_parser(
        "audit",
        help="print the audit log: who requested what, and the outcome",
        description="Print the audit log, the newest entries last: time, client and role, request, status and problem "
        "of the answer, state of the cell, and scan. Entries of the service itself and of the command line have no "
        "status (0 in JSON).",
    )
    audit.add_argument(
        "--since",
        type=_moment,
        metavar="WHEN",
        help="entries since this time, as 2026-01-31 or 2026-01-31T08:00:00+01:00; UTC without a time zone (all)",
    )
    audit.add_argument(
        "--scan", metavar="ID", help="entries about this scan: started, stopped, kept, reprocessed (all)"
    )
    audit.add_argument(
        "--who",
        metavar="NAME",
        help="entries of this client: name of a token, local, service, console, or an address (all)",
    )
    audit.add_argument(
        "--limit",
        type=whole_number(1, MAX_ENTRIES, "entries"),
        default=100,
        metavar="N",
        help="maximum number of entries, the newest ones (%(default)s)",
    )
    add_json_option(audit, "one JSON document per line")
    add_service_options(audit)
    audit.set_defaults(run=_audit)


def _moment(text: str) -> str:
    try:
        moment = datetime.fromisoformat(text)
        moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    except (ValueError, OverflowError):
        message = f"{text!r} is not a date or time, as 2026-01-31 or 2026-01-31T08:00:00"
        raise argparse.ArgumentTypeError(message) from None
    return format_utc(moment)


def _audit(options: argparse.Namespace) -> int:
    from service.config.loader import ConfigError, load_config
    from service.security.audit.reader import AuditError, read_audit

    try:
        data_dir = load_config(options.config, data_dir=options.data_dir).data_dir
        entries = read_audit(data_dir, options.since, options.scan, options.who, options.limit + 1)
    except (ConfigError, AuditError) as error:
        print(f"pointchain audit: {error}", file=sys.stderr)
        return 1
    for entry in entries[-options.limit :]:
        if options.json:
            print(json.dumps(vars(entry)))
        else:
            result = "" if entry.result is None else f" {entry.result}"
            scan = "" if entry.scan is None else f", scan {entry.scan}"
            status = entry.status or "-"
            print(f"{entry.at}  {entry.who} ({entry.role})  {entry.what}  {status}{result}  cell {entry.cell}{scan}")
    if not entries:
        print("no entry was found", file=sys.stderr)
    if len(entries) > options.limit:
        print(f"only the newest {options.limit} entries are shown; raise --limit to see older ones", file=sys.stderr)
    return 0
