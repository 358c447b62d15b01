"""Errors of an export."""


class ExportError(ValueError):
    """The input is not a model, or the output cannot be written. The message says what to do."""

    slug = "export"
