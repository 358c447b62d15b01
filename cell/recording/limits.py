"""Limits on reading a recording, so that no file can exhaust memory or time."""

from dataclasses import dataclass

MIB = 1 << 20


@dataclass(frozen=True)
class Limits:
    """Limits for reading a recording.

    The defaults take 64 views of 1280x800 with intensity images, or ten of 4 megapixels.
    """

    file_bytes: int = 256 * MIB
    """Size of the file, bytes."""
    content_bytes: int = 224 * MIB
    """Size of all messages, decompressed, bytes. Reading needs about this memory."""
    chunk_bytes: int = 32 * MIB
    """Size of one chunk, decompressed, bytes."""
    record_bytes: int = 32 * MIB
    """Size of any record as it is stored, bytes."""
    records: int = 100_000
    """Number of records, including those in chunks."""
    metadata_bytes: int = 64 << 10
    """Size of a metadata or channel record, or of a pose or calibration message, bytes."""
    attachment_bytes: int = 64 << 10
    """Size of the hand-eye calibration, bytes."""
    views: int = 64
    """Number of views; all indices are smaller."""
    image_pixels: int = 4 * MIB
    """Width times height of a depth or intensity image, pixels."""
    colour_pixels: int = 16 * MIB
    """Width times height of a colour image, pixels."""


DEFAULT_LIMITS = Limits()
