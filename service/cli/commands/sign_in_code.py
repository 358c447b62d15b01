"""How `pointchain token code` prints a code: for people with address and QR code, or as JSON."""

import json
import sys
from dataclasses import dataclass
from urllib.parse import urlsplit

import segno

from service.clock import format_utc
from service.config.loader import ServiceConfig
from service.security.auth.allowed_hosts import ANY_ADDRESS, AllowedHosts, is_loopback, local_address
from service.security.auth.sessions import NewCode

SIGN_IN = "/#/sign-in/"
"""Part of the address between the console and the code. A browser does not send what follows a #."""
MANUAL_SECTION = "the page Security of the manual, section TLS and the proxy"
QUIET_ZONE = 4
"""Width of the white margin around a QR code, modules."""
_BLACK_ON_WHITE, _RESET = "\x1b[30;107m", "\x1b[0m"
_HALF_BLOCKS = {(False, False): " ", (True, False): "▀", (False, True): "▄", (True, True): "█"}
"""Characters by the modules of the upper and the lower row."""


@dataclass(frozen=True)
class ConsoleAddress:
    """The address at which a browser opens the console."""

    url: str | None
    """The address, or None if the configuration does not contain it."""
    remote: bool = True
    """Whether other devices can use the address, as far as the configuration says."""
    note: str | None = None
    """What to do so that other devices can use it, or None."""


def parse_address(text: str) -> str:
    """Return scheme, host and port of an address.

    Raises:
        ValueError: The text is not the address of a console.
    """
    parts = urlsplit(text)
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.port == 0:
        raise ValueError("the scheme, the host or the port is not possible")
    if "@" in parts.netloc or parts.path.strip("/") or parts.query or parts.fragment:
        raise ValueError("only scheme, host and port are possible")
    return f"{parts.scheme}://{parts.netloc}"


def console_address(config: ServiceConfig, given: str | None) -> ConsoleAddress:
    """Return the address of the console for other devices.

    Args:
        config: Configuration of the service.
        given: Address on the command line, which precedes that of the configuration.
    """
    names = config.security.allowed_hosts
    example = f"--address https://{names[0] if names else 'cell.example.com'}"
    if given is not None:
        netloc = urlsplit(given).netloc
        refused = netloc not in AllowedHosts(config.host, names)
        note = f"The service refuses the name {netloc}: add it to security.allowed_hosts." if refused else None
        return ConsoleAddress(given, note=note)
    if config.port == 0:
        note = f"The port is chosen when the service starts: give the address, as by {example}."
        return ConsoleAddress(None, remote=False, note=note)
    if is_loopback(config.host):
        return ConsoleAddress(
            _url(config.host, config.port),
            remote=False,
            note=f"The service listens on {config.host}, which a phone or a tablet cannot reach. To make it reachable, "
            f"see {MANUAL_SECTION}. If a proxy makes it reachable, give the address of the proxy, as by {example}.",
        )
    if config.host not in ANY_ADDRESS:
        return ConsoleAddress(_url(config.host, config.port))
    if not names:
        return ConsoleAddress(
            _url(local_address(config.host), config.port),
            remote=False,
            note="The service accepts no name that other devices can use: add the name or the address of this machine "
            "to security.allowed_hosts.",
        )
    return ConsoleAddress(_url(names[0].strip("[]"), config.port))


def print_code(made: NewCode, minutes: int, address: ConsoleAddress, as_json: bool) -> None:
    """Print a code.

    Args:
        made: The code.
        minutes: Its lifetime.
        address: Address of the console.
        as_json: Whether to print one JSON document instead of text for people.
    """
    sign_in = None if address.url is None else f"{address.url}{SIGN_IN}{made.code}"
    if as_json:
        document = {
            "code": made.code,
            "name": made.token.name,
            "role": made.token.role,
            "expires": format_utc(made.expires),
            "address": sign_in,
            "message": address.note,
        }
        print(json.dumps(document), flush=True)
        return
    print(made.code, flush=True)
    until = f"{made.expires.astimezone():%H:%M:%S}"
    print(
        f"This code signs one browser in as {made.token.name} ({made.token.role}). It is valid once, until {until} "
        f"({minutes} min).",
        file=sys.stderr,
    )
    if address.url is not None:
        where = "Open" if address.remote else "On this machine, open"
        print(f"{where} {address.url} and enter the code.", file=sys.stderr)
    if address.note is not None:
        print(address.note, file=sys.stderr)
    if sign_in is not None and address.remote:
        print(f"Or scan this QR code of {sign_in} and press Sign in:", file=sys.stderr)
        _print_qr_code(sign_in)


def qr_code_lines(text: str) -> list[str]:
    """Return a QR code as lines of half blocks, black on white in every colour scheme of a terminal."""
    code = segno.make_qr(text, error="l")
    rows = [[bool(module) for module in row] for row in code.matrix_iter(border=QUIET_ZONE)]
    if len(rows) % 2:
        rows.append([False] * len(rows[0]))
    return [
        _BLACK_ON_WHITE + "".join(_HALF_BLOCKS[pair] for pair in zip(upper, lower, strict=True)) + _RESET
        for upper, lower in zip(rows[::2], rows[1::2], strict=True)
    ]


def _print_qr_code(text: str) -> None:
    try:
        "".join(_HALF_BLOCKS.values()).encode(sys.stderr.encoding)
    except UnicodeEncodeError:
        print("(this terminal cannot show it, because its text is not Unicode)", file=sys.stderr)
    else:
        print("\n".join(qr_code_lines(text)), file=sys.stderr)


def _url(host: str, port: int) -> str:
    name = f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}"
