"""Addresses for virtual controllers of concurrent tests."""

import secrets


def free_host() -> str:
    """Return a random one of sixteen million loopback addresses, so that no two tests use the same."""
    a, b, c = (secrets.randbelow(254) + 1 for _ in range(3))
    return f"127.{a}.{b}.{c}"
