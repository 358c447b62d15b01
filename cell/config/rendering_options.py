"""Options of the simulated cameras whose depth is matched in rendered images."""

from dataclasses import dataclass
from typing import Literal, get_args

Sheath = Literal["speckled", "painted", "woven", "smooth"]
TableTop = Literal["printed", "grained", "bare"]

SHEATHS: tuple[Sheath, ...] = get_args(Sheath)
TABLE_TOPS: tuple[TableTop, ...] = get_args(TableTop)


class RenderingOptionsError(ValueError):
    """The camera does not have the given options."""

    slug = "camera-model"


@dataclass(frozen=True)
class RenderingOptions:
    """What the rendered images show, apart from the scene."""

    sheath: Sheath | None = None
    """Surface of all strings, or None to draw it from the seed."""
    table_top: TableTop | None = None
    """Surface of the table, or None to draw it from the seed."""
    ir_dots: float = 0.0
    """Power of the dot projector, as a share of its maximum."""

    def check(self, camera: str, has_images: bool, has_dots: bool) -> None:
        """Raise RenderingOptionsError if the camera does not have the options that differ from the default.

        Args:
            camera: Name of the camera, for the message.
            has_images: Whether its depth is matched in rendered images.
            has_dots: Whether it has a dot projector.
        """
        default = RenderingOptions()
        given = [name for name in ("sheath", "table_top", "ir_dots") if getattr(self, name) != getattr(default, name)]
        if given and not has_images:
            raise RenderingOptionsError(
                f"{' and '.join(given)} cannot be set for {camera}, which renders no images: choose oak-d-pro, "
                "oak-d-sr or d435"
            )
        if not 0 <= self.ir_dots <= 1:
            raise RenderingOptionsError(f"ir_dots is {self.ir_dots:g}; from 0 to 1 is allowed")
        if self.ir_dots > 0 and not has_dots:
            raise RenderingOptionsError(
                f"ir_dots is {self.ir_dots:g}, but {camera} has no dot projector: choose oak-d-pro or d435"
            )
