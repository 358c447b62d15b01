"""Asks who sits at the terminal."""

import sys

AGREED = ("y", "yes")


def agreed(question: str) -> bool:
    """Whether the person says yes; where nobody can be asked, nobody agrees."""
    if not sys.stdin.isatty():
        return False
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in AGREED
