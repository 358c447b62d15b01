"""Questions to the person at the terminal."""

import sys

YES_ANSWERS = ("y", "yes")


def confirm(question: str) -> bool:
    """Ask a yes-or-no question. Return False without asking if stdin is not a terminal."""
    if not sys.stdin.isatty():
        return False
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in YES_ANSWERS
