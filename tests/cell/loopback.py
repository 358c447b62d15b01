"""Addresses for virtual controllers in tests that run side by side."""

import secrets


def free_host() -> str:
    """A loopback address of its own: of sixteen million, so that no two tests meet."""
    a, b, c = (secrets.randbelow(254) + 1 for _ in range(3))
    return f"127.{a}.{b}.{c}"
