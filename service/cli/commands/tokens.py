"""`pointchain token`: manage access tokens. Changes take effect at once, even while the service runs."""

import argparse
import sys
from pathlib import Path

from service.cli.options import Commands, add_json_option, add_service_options, whole_number

ROLES = ("viewer", "operator", "maintainer")
"""Those of `service.security.auth.caller`, which is not imported for --help."""
DEFAULT_CODE_MINUTES, MAX_CODE_MINUTES = 10, 60
"""Lifetimes of a code. The maximum is that of `service.security.auth.sign_in_codes`, which is not imported either."""


def add_token_commands(commands: Commands) -> None:
    """Add `token` and its commands."""
    token = commands.add_parser(
        "token",
        help="add, list and remove access tokens, and make sign-in codes",
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

    code = kinds.add_parser(
        "code",
        help="make a short code that signs one browser in",
        description="Make a code with which one browser can sign in to the console as the holder of a token. The code "
        "is valid once and for some minutes. It is printed with the address to open and a QR code of that address. A "
        "new code replaces an earlier one of the same token.",
    )
    code.add_argument("name", metavar="NAME", help="name of the token")
    code.add_argument(
        "--minutes",
        type=whole_number(1, MAX_CODE_MINUTES, "minutes"),
        default=DEFAULT_CODE_MINUTES,
        metavar="N",
        help=f"lifetime of the code, 1 to {MAX_CODE_MINUTES} (%(default)s)",
    )
    code.add_argument(
        "--address",
        type=_address,
        metavar="URL",
        help="address of the console in the QR code, as http://cell.example.com:8000; needed behind a proxy, in a "
        "container, or after `serve` with other options (host and port of the configuration)",
    )
    add_json_option(code, "one JSON document, without a QR code")
    add_service_options(code)
    code.set_defaults(run=_code)

    listing = kinds.add_parser(
        "list",
        help="list names and roles",
        description="Print one line per token: name, role, date, and the number of browsers that have signed in with a "
        "code.",
    )
    add_service_options(listing)
    listing.set_defaults(run=_list)

    remove = kinds.add_parser(
        "remove",
        help="remove a token",
        description="Remove a token. It is refused from now on, and its browsers are signed out.",
    )
    remove.add_argument("name", metavar="NAME", help="name of the token")
    add_service_options(remove)
    remove.set_defaults(run=_remove)


def _data_dir(options: argparse.Namespace) -> Path:
    from service.config.loader import load_config

    return load_config(options.config, data_dir=options.data_dir).data_dir


def _address(text: str) -> str:
    from service.cli.commands.sign_in_code import parse_address

    try:
        return parse_address(text)
    except ValueError:
        message = f"{text!r} is not the address of a console, as http://cell.example.com:8000"
        raise argparse.ArgumentTypeError(message) from None


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


def _code(options: argparse.Namespace) -> int:
    from service.cli.commands.sign_in_code import console_address, print_code
    from service.clock import utc_now
    from service.config.loader import ConfigError, load_config
    from service.security.auth.sessions import add_code
    from service.security.auth.tokens import TokensError

    try:
        config = load_config(options.config, data_dir=options.data_dir)
        made = add_code(config.data_dir, options.name, options.minutes, utc_now())
    except (ConfigError, TokensError) as error:
        return _fail("code", error)
    print_code(made, options.minutes, console_address(config, options.address), options.json)
    _write_audit_entry(config.data_dir, f"token code {options.name}")
    return 0


def _list(options: argparse.Namespace) -> int:
    from service.clock import utc_now
    from service.config.loader import ConfigError
    from service.security.auth.sessions import SESSIONS_FILE, read_sessions
    from service.security.auth.tokens import TOKENS_FILE, TokensError, read_tokens

    try:
        data_dir = _data_dir(options)
        tokens = read_tokens(data_dir / TOKENS_FILE)
        sessions = read_sessions(data_dir / SESSIONS_FILE).sessions
    except (ConfigError, TokensError) as error:
        return _fail("list", error)
    now = utc_now()
    for token in tokens:
        count = sum(one.token_sha256 == token.sha256 and now < one.expires for one in sessions)
        print(f"{token.name}\t{token.role}\t{token.created:%Y-%m-%dT%H:%M:%SZ}\t{count}")
    if not tokens:
        print(f"there is no token in {data_dir}: every client on this machine may do everything", file=sys.stderr)
    return 0


def _remove(options: argparse.Namespace) -> int:
    from service.clock import utc_now
    from service.config.loader import ConfigError
    from service.security.auth.sessions import remove_outdated
    from service.security.auth.tokens import TokensError, remove_token

    try:
        data_dir = _data_dir(options)
        left = remove_token(data_dir, options.name)
    except (ConfigError, TokensError) as error:
        return _fail("remove", error)
    print(
        f"the token of {options.name} is removed and refused from now on; its browsers are signed out", file=sys.stderr
    )
    try:
        remove_outdated(data_dir, utc_now())  # only to tidy up: without their token, sessions are refused
    except TokensError as error:
        print(f"entries of ended sessions stay on the disk: {error}", file=sys.stderr)
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
        print(f"the change was made; the audit log has no entry of it: {problem}", file=sys.stderr)


def _fail(command: str, error: Exception) -> int:
    print(f"pointchain token {command}: {error}", file=sys.stderr)
    return 1
