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

MAX_BYTES = 8 << 20
"""Bytes of images and clouds that are kept: those of two scans of eight views, of at most 200 kB each, and a page of
100 thumbnails."""


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
        """The images, the one that was requested last at the end."""
        self._bytes = 0
        self._drawing = CapacityLimiter(1)

    @property
    def kept_bytes(self) -> int:
        """Size of all kept images, at most `MAX_BYTES`."""
        return self._bytes

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
            image = _Image(content, tag_of_hash(hashlib.sha256(content).hexdigest()))
            self._keep(key, image)
        else:
            self._images.move_to_end(key)
        if matches(if_none_match, image.etag):
            return not_modified_response(image.etag)
        return Response(image.content, media_type=media_type, headers={"ETag": image.etag})

    def _keep(self, key: Hashable, image: _Image) -> None:
        """Keep an image in place of those that were not requested for longest. One above `MAX_BYTES` is not kept."""
        self._remove(key)  # another request may have drawn it meanwhile
        if len(image.content) > MAX_BYTES:
            return
        self._images[key] = image
        self._bytes += len(image.content)
        while self._bytes > MAX_BYTES:
            self._remove(next(iter(self._images)))

    def _remove(self, key: Hashable) -> None:
        image = self._images.pop(key, None)
        if image is not None:
            self._bytes -= len(image.content)


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
