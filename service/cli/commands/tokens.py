"""`pointchain token ...`: who may speak to the service. Works while it runs, and is good at once."""

import argparse
import sys
from pathlib import Path

ROLES = ("viewer", "operator", "maintainer")  # as in `service.security.auth.caller`, which is not imported for --help


def add_token_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Adds `token` and its commands."""
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
    _add_place(add)
    add.set_defaults(run=_add)

    listing = kinds.add_parser(
        "list", help="list names and roles", description="Print one line per token: name, role, date."
    )
    _add_place(listing)
    listing.set_defaults(run=_list)

    remove = kinds.add_parser("remove", help="remove a token", description="Remove a token. It is refused from now on.")
    remove.add_argument("name", metavar="NAME", help="name of the token")
    _add_place(remove)
    remove.set_defaults(run=_remove)


def _add_place(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=Path, metavar="TOML", help="configuration file of the service")
    parser.add_argument("--data-dir", type=Path, metavar="DIR", help="data folder of the service")


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
        return _failed("add", error)
    print(token, flush=True)  # whatever comes of the entry
    print(
        f"{options.name} is {options.role} of the service with its data in {data_dir}. The token is kept nowhere:\n"
        "store it now, and send it in each request as\n"
        "  Authorization: Bearer TOKEN",
        file=sys.stderr,
    )
    _note(data_dir, f"token add {options.name} {options.role}")
    return 0


def _list(options: argparse.Namespace) -> int:
    from service.config.loader import ConfigError
    from service.security.auth.tokens import FILE, TokensError, read_tokens

    try:
        data_dir = _data_dir(options)
        tokens = read_tokens(data_dir / FILE)
    except (ConfigError, TokensError) as error:
        return _failed("list", error)
    for token in tokens:
        print(f"{token.name}\t{token.role}\t{token.created:%Y-%m-%dT%H:%M:%SZ}")
    if not tokens:
        said = f"there is no token in {data_dir}: of its service, everybody on this machine may do everything"
        print(said, file=sys.stderr)
    return 0


def _remove(options: argparse.Namespace) -> int:
    from service.config.loader import ConfigError
    from service.security.auth.tokens import TokensError, remove_token

    try:
        data_dir = _data_dir(options)
        left = remove_token(data_dir, options.name)
    except (ConfigError, TokensError) as error:
        return _failed("remove", error)
    print(f"{options.name} is refused from now on", file=sys.stderr)
    if not left:
        print(
            "that was the last token: on loopback, everybody on this machine may do everything now; elsewhere, nobody",
            file=sys.stderr,
        )
    _note(data_dir, f"token remove {options.name}")
    return 0


def _note(data_dir: Path, what: str) -> None:
    """Behind the deed: a token that is not good any more is not to wait for the database."""
    from service.security.audit.cli_audit import note_from_console

    lacking = note_from_console(data_dir, what)
    if lacking is not None:
        print(f"the audit log has no entry of it: {lacking}", file=sys.stderr)


def _failed(command: str, error: Exception) -> int:
    print(f"pointchain token {command}: {error}", file=sys.stderr)
    return 1
