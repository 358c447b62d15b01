"""How much of a recording is read, so that no file can take the machine's memory or time."""

from dataclasses import dataclass

MIB = 1 << 20


@dataclass(frozen=True)
class Limits:
    """Bounds that a recording is held to. The defaults take 64 views of 1280x800, or ten of 4 megapixels."""

    file_bytes: int = 256 * MIB
    """Size of the file."""
    content_bytes: int = 160 * MIB
    """All messages together, decompressed: about the memory that reading takes."""
    chunk_bytes: int = 32 * MIB
    """One chunk, decompressed."""
    record_bytes: int = 32 * MIB
    """Any one record as it is stored."""
    records: int = 100_000
    """Number of records, those in chunks among them."""
    metadata_bytes: int = 64 << 10
    """One metadata or channel record, one pose or calibration message."""
    attachment_bytes: int = 64 << 10
    """The hand-eye calibration."""
    views: int = 64
    """Number of views; their indices lie below it."""
    image_pixels: int = 4 * MIB
    """Width times height of one depth image."""


DEFAULT_LIMITS = Limits()
