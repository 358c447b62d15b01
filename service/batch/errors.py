"""Errors of a batch run or comparison."""

INSTALL_EXTRA = "install the package with it, as 'WHEEL[archive]' in place of WHEEL"
"""Advice if packages are missing."""


class BatchError(Exception):
    """A run or comparison cannot continue. The message says why and what to do."""
