"""What cannot be exported."""


class ExportError(ValueError):
    """A model that is none, or a file that is not written; the message says what to do."""

    slug = "export"
