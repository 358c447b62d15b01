"""Sign in with a code, with a limit on wrong codes."""

import logging
import math
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path

from anyio import CapacityLimiter, Lock, to_thread

from service.clock import utc_now
from service.problems.problem_error import ProblemError
from service.security.auth.credential import unauthorized
from service.security.auth.private_file import TokensError
from service.security.auth.sessions import SESSIONS_FILE, NewSession, end_session, redeem_code
from service.security.auth.sign_in_codes import normalise_code
from service.storage.storage_errors import is_full

log = logging.getLogger(__name__)

MAX_WRONG_CODES = 10
"""Maximum number of wrong codes within `WINDOW_S`, by all clients together."""
WINDOW_S = 60.0


class WrongCodeLimit:
    """Limits how many wrong codes are checked. Not safe to use from several threads."""

    def __init__(self, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._monotonic = monotonic
        self._attempts: deque[float] = deque()
        """Times of the attempts within the window that have not succeeded, monotonic seconds."""

    def begin(self) -> None:
        """Count an attempt as a wrong code, before its outcome is known.

        Raises:
            ProblemError: There were too many (`too-many-wrong-codes`). This attempt is not counted.
        """
        now_s = self._monotonic()
        while self._attempts and now_s - self._attempts[0] >= WINDOW_S:
            self._attempts.popleft()
        if len(self._attempts) >= MAX_WRONG_CODES:
            wait_s = math.ceil(self._attempts[0] + WINDOW_S - now_s)
            detail = f"too many wrong codes were sent: send the code again in {wait_s} s, or sign in with a token"
            raise ProblemError("too-many-wrong-codes", detail, {"Retry-After": str(wait_s)})
        self._attempts.append(now_s)

    def succeed(self) -> None:
        """Do not count the newest attempt, whose code was right."""
        self._attempts.pop()


class CodeSignIn:
    """Makes sessions with codes and ends them, one at a time. No other request, such as a stop, waits for it."""

    def __init__(self, data_dir: Path) -> None:
        self._data_dir = data_dir
        self._limit = WrongCodeLimit()
        self._one_at_a_time = Lock()
        # its own thread, so that a slow disk does not take those of other requests
        self._thread = CapacityLimiter(1)

    async def sign_in(self, typed: str) -> NewSession:
        """Use a code up and return a new session.

        Args:
            typed: The code as a person typed it.

        Raises:
            ProblemError: The code is wrong, was used, or has expired (`unauthorized`); too many codes were wrong
                (`too-many-wrong-codes`); or the file of the sessions cannot be used (`damaged`).
            OSError: The disk is full.
        """
        if normalise_code(typed) is None:
            raise _wrong()  # no guess: no code has this form
        async with self._one_at_a_time:
            self._limit.begin()
            session = await to_thread.run_sync(self._redeem, typed, limiter=self._thread)
            if session is None:
                raise _wrong()
            self._limit.succeed()
        return session

    async def sign_out(self, secret: str) -> None:
        """End a session. If its file cannot be written, the log says so."""
        async with self._one_at_a_time:
            await to_thread.run_sync(self._end, secret, limiter=self._thread)

    def _end(self, secret: str) -> None:
        try:
            end_session(self._data_dir, secret, utc_now())
        except TokensError as error:
            log.error("the cookie of a session was removed, but the session has not ended: %s", error)

    def _redeem(self, typed: str) -> NewSession | None:
        try:
            return redeem_code(self._data_dir, typed, utc_now())
        except TokensError as error:
            log.error("no code can sign in: %s", error)
            if error.__cause__ is not None and is_full(error.__cause__):
                raise error.__cause__ from error
            raise ProblemError(
                "damaged",
                f"{SESSIONS_FILE} cannot be used, as the log of the service says: sign in with a token",
                file=SESSIONS_FILE,
            ) from error


def _wrong() -> ProblemError:
    return unauthorized(
        "this code is wrong, was used, or has expired: make a new one with `pointchain token code NAME`"
    )
