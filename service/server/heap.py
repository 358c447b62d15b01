"""The heap of the service's process: all threads share one, and it returns freed memory to the system.

By default glibc gives the threads up to eight heaps for each core. Memory that one thread has freed in its heap serves
no other thread. Any thread of the service may draw a view or build a long response, so each heap grows to the largest
need of any thread: after 25 scans, two thirds of the heaps were free. A single heap grows to what is in use at once.
"""

import ctypes

M_TRIM_THRESHOLD = -1
"""Parameter of mallopt(3): free memory at the end of the heap from which it is returned to the system."""
M_MMAP_THRESHOLD = -3
"""Parameter of mallopt(3): size from which a block has a mapping of its own, which is returned when it is freed."""
M_ARENA_MAX = -8
"""Parameter of mallopt(3): maximum number of heaps."""

MAX_HEAPS = 1
"""Number of heaps. Threads hardly wait for one another: nearly all allocate while they hold the interpreter."""
MMAP_THRESHOLD_BYTES = 4 << 20
"""Twice the largest array of a view of 640x400 pixels, 2 MB, so that the arrays of the next view reuse its memory.

With a mapping for each array, drawing a view takes a third more CPU time. Unless it is set, the threshold rises to
the size of the largest freed block, up to 32 MiB.
"""
TRIM_THRESHOLD_BYTES = 2 * MMAP_THRESHOLD_BYTES
"""Free memory that the heap keeps at its end. glibc derives it from the other threshold in the same way."""


def share_one_heap() -> None:
    """Set up the heap of this process. Call it before the process starts threads. It has no effect without glibc."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # musl, macOS; TypeError on Windows
        return
    mallopt(M_ARENA_MAX, MAX_HEAPS)
    mallopt(M_MMAP_THRESHOLD, MMAP_THRESHOLD_BYTES)
    mallopt(M_TRIM_THRESHOLD, TRIM_THRESHOLD_BYTES)
