"""The limit of open files of the process. Each connection and each file of the store counts."""

import logging

log = logging.getLogger(__name__)

NO_LIMIT = 1 << 16
"""Number of files that is assumed if the system has no limit."""


def raise_file_limit() -> None:
    """Raise the limit of open files to the system's maximum; the default of most systems is small."""
    try:
        import resource
    except ImportError:  # not POSIX: there is no such limit
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    except (OSError, ValueError) as error:  # macOS reports a larger maximum than it grants
        log.warning("the limit of open files could not be raised and stays at %d: %s", soft, error)


def open_file_limit() -> int:
    """Return the number of files that the process may have open."""
    try:
        import resource
    except ImportError:
        return NO_LIMIT
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return NO_LIMIT if soft == resource.RLIM_INFINITY else soft
