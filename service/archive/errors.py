"""What a run over many recordings, or a comparison, cannot go on with."""


class ArchiveError(Exception):
    """Says what is wrong and what to do."""
