"""`pointchain token`: manage access tokens. Changes take effect at once, even while the service runs."""

import argparse
import sys
from pathlib import Path

from service.cli.options import Commands, add_service_options

ROLES = ("viewer", "operator", "maintainer")
"""Those of `service.security.auth.caller`, which is not imported for --help."""


def add_token_commands(commands: Commands) -> None:
    """Add `token` and its commands."""
    token = commands.add_parser(
        "token",
        help="add, list and remove access tokens",
        description="Manage access tokens. As soon as there is a token, every client needs one. A viewer may read and "
        "stop the arm, an operator may also scan, a maintainer may also acknowledge faults and calibrate. Changes "
        "take effect at once.",
    )
    kinds = token.add_subparsers(title="commands", required=True, metavar="COMMAND")

    add = kinds.add_parser("add", help="make a token and print it once", description="Make a token and print it once.")
    add.add_argument("name", metavar="NAME", help="name of the person or program, for the audit log")
    add.add_argument("--role", required=True, choices=ROLES, help="what the client may do")
    add_service_options(add)
    add.set_defaults(run=_add)

    listing = kinds.add_parser(
        "list", help="list names and roles", description="Print one line per token: name, role, date."
    )
    add_service_options(listing)
    listing.set_defaults(run=_list)

    remove = kinds.add_parser("remove", help="remove a token", description="Remove a token. It is refused from now on.")
    remove.add_argument("name", metavar="NAME", help="name of the token")
    add_service_options(remove)
    remove.set_defaults(run=_remove)


def _data_dir(options: argparse.Namespace) -> Path:
    from service.config.loader import load_config

    return load_config(options.config, data_dir=options.data_dir).data_dir


def _add(options: argparse.Namespace) -> int:
    from service.config.loader import ConfigError
    from service.security.auth.tokens import TokensError, add_token

    try:
        data_dir = _data_dir(options)
        token = add_token(data_dir, options.name, options.role)
    except (ConfigError, TokensError) as error:
        return _fail("add", error)
    print(token, flush=True)  # first, because the audit entry may fail
    print(
        f"{options.name} is now {options.role} of the service whose data folder is {data_dir}. Store the token now:\n"
        "it cannot be shown again. Send it in each request as\n"
        "  Authorization: Bearer TOKEN",
        file=sys.stderr,
    )
    _write_audit_entry(data_dir, f"token add {options.name} {options.role}")
    return 0


def _list(options: argparse.Namespace) -> int:
    from service.config.loader import ConfigError
    from service.security.auth.tokens import TOKENS_FILE, TokensError, read_tokens

    try:
        data_dir = _data_dir(options)
        tokens = read_tokens(data_dir / TOKENS_FILE)
    except (ConfigError, TokensError) as error:
        return _fail("list", error)
    for token in tokens:
        print(f"{token.name}\t{token.role}\t{token.created:%Y-%m-%dT%H:%M:%SZ}")
    if not tokens:
        print(f"there is no token in {data_dir}: every client on this machine may do everything", file=sys.stderr)
    return 0


def _remove(options: argparse.Namespace) -> int:
    from service.config.loader import ConfigError
    from service.security.auth.tokens import TokensError, remove_token

    try:
        data_dir = _data_dir(options)
        left = remove_token(data_dir, options.name)
    except (ConfigError, TokensError) as error:
        return _fail("remove", error)
    print(f"the token of {options.name} is removed and refused from now on", file=sys.stderr)
    if not left:
        print(
            "that was the last token: clients on this machine may do everything now, other clients have no access",
            file=sys.stderr,
        )
    _write_audit_entry(data_dir, f"token remove {options.name}")
    return 0


def _write_audit_entry(data_dir: Path, what: str) -> None:
    """Write an audit entry. This comes after the change, because a removal must not wait for the database."""
    from service.security.audit.cli_audit import record_command

    problem = record_command(data_dir, what)
    if problem is not None:
        print(f"the change was made, but the audit log has no entry of it: {problem}", file=sys.stderr)


def _fail(command: str, error: Exception) -> int:
    print(f"pointchain token {command}: {error}", file=sys.stderr)
    return 1
