"""JSON document of a request for a scan that was only checked."""

from typing import Literal

from recognition.model.model import Method
from service.api.schemas.base import ApiModel
from service.api.schemas.cell import ViewpointsResource
from service.api.schemas.scans import Id


class ScanValidation(ApiModel):
    """What a scan would use. No scan was started, nothing was stored, and no device was contacted.

    The same request without `validate_only` can still be refused, for example because the cell is busy then, and what
    arm and camera say becomes the `problem` of the scan.
    """

    valid: Literal[True]
    mode: Literal["replay", "live"]
    recording: Id | None
    method: Method
    string_radius_m: float | None
    """The radius that recognition would use. Null if it would be measured."""
    all_grasps: bool
    viewpoints: ViewpointsResource | None
    """Viewpoints of a live scan, planned from the arm's last known posture. Null for a replay."""
