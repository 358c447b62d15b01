"""The check that the service may listen on an address with the tokens that there are."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from service.security.auth.allowed_hosts import ANY_ADDRESS, is_loopback
from service.security.auth.tokens import TOKENS_FILE, TokensError, read_tokens


@dataclass(frozen=True)
class Binding:
    """The result of the check."""

    refusal: str | None = None
    """Why the service may not listen there and what to do, or None if it may."""
    note: str | None = None
    """A further message for the person who starts the service."""


def check_binding(host: str, data_dir: Path, allowed_hosts: Sequence[str]) -> Binding:
    """Check that the service may listen on an address. Except on loopback, there must be a token.

    Args:
        host: The listen address.
        data_dir: The data folder with the token file.
        allowed_hosts: The configured host names.
    """
    try:
        tokens = read_tokens(data_dir / TOKENS_FILE)
    except TokensError as error:
        return Binding(f"{error}; repair the file, or remove it and make new tokens with `pointchain token add`")
    if is_loopback(host):
        return Binding()
    if not tokens:
        command = f"pointchain token add NAME --role maintainer --data-dir {shlex.quote(str(data_dir))}"
        return Binding(f"other machines can reach {host}, but there is no token: make one first with `{command}`")
    if host in ANY_ADDRESS and not allowed_hosts:
        return Binding(
            note=f"listening on {host}, but only the names localhost and 127.0.0.1 are allowed: add the other names "
            "of this machine to security.allowed_hosts"
        )
    return Binding()
