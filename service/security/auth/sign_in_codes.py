"""One-time codes to sign in a browser: how they are made, read as a person typed them, and hashed."""

import hashlib
import secrets
import unicodedata

ALPHABET = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
"""Crockford's base 32: without I, L and O, which look like digits, and without U."""
CODE_CHARS = 8
GROUP_CHARS = 4
MAX_MINUTES = 60

_LOOK_ALIKES = str.maketrans({"I": "1", "L": "1", "O": "0"})
_SALT = b"pointchain sign-in code"
_COST, _BLOCK_SIZE = 2**14, 8
"""Parameters of scrypt: 16 MiB and about 50 ms for each hash."""


def make_code() -> str:
    """Return a new code of 40 random bits."""
    return "".join(secrets.choice(ALPHABET) for _ in range(CODE_CHARS))


def format_code(code: str) -> str:
    """Return a code as people read it, XXXX-XXXX."""
    return f"{code[:GROUP_CHARS]}-{code[GROUP_CHARS:]}"


def normalise_code(typed: str) -> str | None:
    """Return the characters of a code, or None if the text cannot be a code.

    Lower case, white space, dashes of any kind and look-alikes are accepted.

    Args:
        typed: What a person typed.
    """
    kept = "".join(one for one in typed if not one.isspace() and unicodedata.category(one) != "Pd")
    code = kept.upper().translate(_LOOK_ALIKES)
    return code if len(code) == CODE_CHARS and all(one in ALPHABET for one in code) else None


def hash_code(code: str) -> str:
    """Return the hash of a code, as in the file.

    A fast hash of 40 bits would be reversed within the lifetime of the code by a person who can read the file. The salt
    is fixed, so that one hash is compared with all codes; codes are random and live for minutes.
    """
    return hashlib.scrypt(code.encode(), salt=_SALT, n=_COST, r=_BLOCK_SIZE, p=1, dklen=32).hex()
