"""Entity tags (RFC 9110): a client that has the current version of a file gets 304 in place of the file."""

import os
import re

TAG = re.compile(r'(?:W/)?("[\x21\x23-\x7e\x80-\xff]*")')


def matches(if_none_match: str | None, etag: str) -> bool:
    """Whether the header If-None-Match lists the strong tag `etag`. Weak comparison, as the RFC requires."""
    if if_none_match is None:
        return False
    return if_none_match.strip() == "*" or etag in TAG.findall(if_none_match)


def tag_of_hash(sha256: str) -> str:
    """Return the entity tag of content with a known hash."""
    return f'"{sha256}"'


def tag_of_file(stat: os.stat_result) -> str:
    """Return the entity tag of a file that is written once, from its size and its modification time."""
    return f'"{stat.st_size:x}-{stat.st_mtime_ns:x}"'
