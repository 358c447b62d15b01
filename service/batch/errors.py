"""What a run over many recordings, or a comparison, cannot go on with."""

EXTRA = "install the package with it, as 'WHEEL[archive]' in place of WHEEL"
"""What to do where packages are missing."""


class ArchiveError(Exception):
    """Says what is wrong and what to do."""
