"""Small pictures that are made when somebody looks at them: one at a time, and the last of them remembered."""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np
from anyio import CapacityLimiter, to_thread
from starlette.responses import Response

from service.api.etags import matches, tag_of_hash
from service.api.file_responses import not_modified
from service.problems.problem_error import ProblemError

REMEMBERED = 64
"""So many, of 200 kB at the most where they are usual ones."""


@dataclass(frozen=True)
class _Made:
    png: bytes
    etag: str


class Pictures:
    """The memory of pictures, and their one thread. Nothing that a stop waits for is done here. Belongs to the event
    loop's thread."""

    def __init__(self) -> None:
        # Now, and not when somebody looks at a moving arm: it keeps all threads waiting.
        import cv2  # noqa: F401 (whoever draws gets this one)

        self._made: OrderedDict[Hashable, _Made] = OrderedDict()
        self._one = CapacityLimiter(1)

    async def answer(self, of: Hashable, has: str | None, draw: Callable[[], bytes]) -> Response:
        """The PNG that `draw` makes, which may block; the same again without it for the same `of`, which must name all
        that it depends on. `has`: the header If-None-Match.

        Raises what `draw` raises.
        """
        made = self._made.get(of)
        if made is None:
            png = await to_thread.run_sync(draw, limiter=self._one)
            made = self._made[of] = _Made(png, tag_of_hash(hashlib.sha256(png).hexdigest()))
            if len(self._made) > REMEMBERED:
                self._made.popitem(last=False)
        self._made.move_to_end(of)
        if matches(has, made.etag):
            return not_modified(made.etag)
        return Response(made.png, media_type="image/png", headers={"ETag": made.etag})


def shrink_picture(png: bytes, width: int) -> bytes:
    """The picture, so many pixels across.

    Raises:
        ProblemError: `damaged`, it is none.
    """
    import cv2

    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR) if png else None
    if picture is None:
        raise ProblemError("damaged", "the picture is damaged, the model is not: reprocess the scan")
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    return cv2.imencode(".png", cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))[1].tobytes()
