"""Entity tags: a client that has a file already is told so, instead of being sent it again (RFC 9110)."""

import os
import re

TAG = re.compile(r'(?:W/)?("[\x21\x23-\x7e\x80-\xff]*")')


def matches(if_none_match: str | None, etag: str) -> bool:
    """Whether the strong tag `etag` is among those of the header If-None-Match, compared weakly, as it says."""
    if if_none_match is None:
        return False
    return if_none_match.strip() == "*" or etag in TAG.findall(if_none_match)


def tag_of_hash(sha256: str) -> str:
    """Of a content whose hash is known."""
    return f'"{sha256}"'


def tag_of_file(stat: os.stat_result) -> str:
    """Of a file that is written once: by its size and the moment of its writing."""
    return f'"{stat.st_size:x}-{stat.st_mtime_ns:x}"'
