"""The inputs of recognition, as the row of a scan keeps them."""

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from service.storage.rows import ViewRow


def recognition_inputs(recording_sha256: str | None = None, views: Sequence[ViewRow] | None = None) -> dict[str, Any]:
    """Return the inputs of a recognition beside its request, as JSON.

    Args:
        recording_sha256: Hash of the recording of a replay.
        views: Views of a live scan; None until all are known.
    """
    return {
        "software": version("pointchain"),
        "recording_sha256": recording_sha256,
        "views": None if views is None else [_view(view) for view in views if view.state == "recorded"],
    }


def _view(view: ViewRow) -> dict[str, Any]:
    return {"view": view.view, "sha256": view.sha256}
