"""The inputs of recognition, as the row of a scan keeps them."""

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from pydantic import TypeAdapter

from recognition.grasping.gripper import Gripper
from service.processing.worker_main import Task
from service.storage.rows import ViewRow


def recognition_inputs(
    task: Task, recording_sha256: str | None = None, views: Sequence[ViewRow] | None = None
) -> dict[str, Any]:
    """Return the inputs of a recognition task as JSON.

    Args:
        task: The task.
        recording_sha256: Hash of the recording of a replay.
        views: Views of a live scan; None until all are known.
    """
    return {
        "request": task.request.to_json(),
        "software": version("pointchain"),
        "recording_sha256": recording_sha256,
        "views": None if views is None else [_view(view) for view in views if view.state == "recorded"],
    }


def recorded_gripper(inputs: Mapping[str, Any] | None) -> Gripper | None:
    """Return the gripper of the inputs of a scan; None if they have none.

    Args:
        inputs: Inputs as `recognition_inputs` returned them.
    """
    values = (inputs or {}).get("request", {}).get("gripper")
    return None if values is None else TypeAdapter(Gripper).validate_python(values)


def _view(view: ViewRow) -> dict[str, Any]:
    return {"view": view.view, "sha256": view.sha256}
