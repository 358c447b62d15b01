"""Whether the service may listen where it is to, as far as its tokens go."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from service.security.auth.allowed_hosts import ANY_ADDRESS, is_loopback
from service.security.auth.tokens import FILE, TokensError, read_tokens


@dataclass(frozen=True)
class Binding:
    """What is told of it."""

    refusal: str | None = None
    """Why not, and what to do; None: it may."""
    note: str | None = None
    """What else whoever starts it should know."""


def check_binding(host: str, data_dir: Path, allowed_hosts: Sequence[str]) -> Binding:
    """Elsewhere than on loopback, nobody may ask without a token, so there must be one."""
    try:
        tokens = read_tokens(data_dir / FILE)
    except TokensError as error:
        return Binding(f"{error}; mend it, or remove it and make the tokens anew by `pointchain token add`")
    if is_loopback(host):
        return Binding()
    if not tokens:
        command = f"pointchain token add NAME --role maintainer --data-dir {shlex.quote(str(data_dir))}"
        return Binding(f"other machines can reach {host}, and there is no token yet: make one first, by `{command}`")
    if host in ANY_ADDRESS and not allowed_hosts:
        return Binding(
            note=f"listening on {host}, and called by the names localhost and 127.0.0.1 alone: name in "
            "security.allowed_hosts the others by which this machine may be called"
        )
    return Binding()
