"""How many files the process may have open: each connection is one, and each file of the store."""

import logging

log = logging.getLogger(__name__)

NO_LIMIT = 1 << 16
"""What counts where the system names none."""


def raise_open_files() -> None:
    """Takes as many as the system grants; what it gives unasked is for programs of another time."""
    try:
        import resource
    except ImportError:  # Not POSIX: there is no such limit.
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    except (OSError, ValueError) as error:  # macOS names a larger one than it grants
        log.warning("the process may have %d files open, and no more: %s", soft, error)


def open_files() -> int:
    """So many may be open at a time."""
    try:
        import resource
    except ImportError:
        return NO_LIMIT
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return NO_LIMIT if soft == resource.RLIM_INFINITY else soft
