"""Cache of small images and clouds, which are made on request, one at a time.

Reading and drawing a view takes 0.1 to 0.2 s. Most of this time the interpreter is busy, and a stop would wait for it.
Each image is therefore made once for all clients.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import numpy as np
from anyio import CapacityLimiter, to_thread
from starlette.responses import Response

from service.api.file_responses import matches, not_modified_response, tag_of_hash
from service.problems.problem_error import ProblemError

MAX_IMAGES = 64
"""Number of images and clouds that are kept. A usual one has at most 200 kB."""


@dataclass(frozen=True)
class _Image:
    content: bytes
    etag: str


class ImageCache:
    """A cache with one drawing thread, for use in the event loop's thread. Stops do not pass through it."""

    def __init__(self) -> None:
        # imported now, because the import blocks all threads and the arm may move at the first request
        import cv2  # noqa: F401 (`draw_depth` and `shrink_image` use it)

        self._images: OrderedDict[Hashable, _Image] = OrderedDict()
        self._drawing = CapacityLimiter(1)

    async def respond(
        self, key: Hashable, if_none_match: str | None, draw: Callable[[], bytes], media_type: str = "image/png"
    ) -> Response:
        """Return the cached image for `key`, or the one that `draw` returns, or 304 if the client has it.

        Args:
            key: Names everything that the image depends on.
            if_none_match: The request's header If-None-Match.
            draw: Makes the image. It may block. Its exceptions reach the caller.
            media_type: Media type of the image.
        """
        image = self._images.get(key)
        if image is None:
            content = await to_thread.run_sync(draw, limiter=self._drawing)
            image = self._images[key] = _Image(content, tag_of_hash(hashlib.sha256(content).hexdigest()))
            if len(self._images) > MAX_IMAGES:
                self._images.popitem(last=False)
        self._images.move_to_end(key)
        if matches(if_none_match, image.etag):
            return not_modified_response(image.etag)
        return Response(image.content, media_type=media_type, headers={"ETag": image.etag})


def shrink_image(png: bytes, width: int) -> bytes:
    """Return a PNG scaled to a width in pixels.

    Raises:
        ProblemError: `damaged`: The bytes are not an image.
    """
    import cv2

    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR) if png else None
    if image is None:
        raise ProblemError("damaged", "the picture is damaged, the model is not: reprocess the scan")
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return cv2.imencode(".png", cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))[1].tobytes()
