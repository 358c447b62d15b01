"""What recognition of a scan is begun with, as it is kept in the scan's row."""

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from service.processing.worker_main import Task
from service.storage.rows import ViewRow


def recognition_inputs(
    task: Task, recording_sha256: str | None = None, views: Sequence[ViewRow] | None = None
) -> dict[str, Any]:
    """As JSON: what was asked for, by which software, and from which bytes: a whole recording, or the `views` of a live
    scan that are recorded; null as long as they are not all known."""
    return {
        "method": task.method,
        "string_radius_m": task.radius_m,
        "gripper": vars(task.gripper),
        "software": version("pointchain"),
        "recording_sha256": recording_sha256,
        "views": None if views is None else [_view(view) for view in views if view.state == "recorded"],
    }


def _view(view: ViewRow) -> dict[str, Any]:
    return {"view": view.view, "sha256": view.sha256}
