"""Documents of schema `pointchain/1`, as an earlier release wrote them."""

import copy
import hashlib
import json
from collections.abc import Sequence
from typing import Any

from recognition.model.document import LATER_GRASP_MEMBERS
from service.storage.data_folder import MODEL
from service.storage.store import Store
from tests.service.conftest import ServedClient


def as_schema_1(model: dict[str, Any], ambiguities: Sequence[str] = (), warnings: Sequence[str] = ()) -> dict[str, Any]:
    """Return a model of schema `pointchain/2` in the form of `pointchain/1`, with these messages.

    Args:
        model: Document of schema `pointchain/2`, with all grasps. It is not changed.
        ambiguities: Messages about undecided results.
        warnings: Messages about excluded data, and about data that contradict the given values.
    """
    old: dict[str, Any] = copy.deepcopy(model)
    old["schema"] = "pointchain/1"
    for chain in old["chains"]:
        del chain["trust"], chain["trusted_m"]
        chain["ends"] = [_end(end) for end in chain["ends"]]
    for item in old["crossings"]:
        del item["trust"]
    for grasp in old["grasps"]:
        for name in ("id", "cluster", "trusted", *LATER_GRASP_MEMBERS):
            del grasp[name]
    for element in old["topology"]["p_data"]["elements"]:
        if element["kind"] == "end":
            element["end"] = _end(element["end"])
    views = [{name: value for name, value in view.items() if name != "code"} for view in old["quality"]["views"]]
    old["quality"] = {"views": views, "ambiguities": list(ambiguities), "warnings": list(warnings)}
    return old


def store_as_schema_1(
    client: ServedClient, scan: str, ambiguities: Sequence[str] = (), warnings: Sequence[str] = ()
) -> dict[str, Any]:
    """Replace the stored model of a scan by the same model of schema `pointchain/1`, and return it.

    Args:
        client: Client of the service. It must not have requested the model before, because answers are cached.
        scan: Id of the scan.
        ambiguities: Messages about undecided results.
        warnings: Messages about excluded data.
    """
    store: Store = client.app.state.context.store
    path = store.folder.results(scan) / MODEL
    old = as_schema_1(json.loads(path.read_bytes()), ambiguities, warnings)
    content = json.dumps(old).encode()
    path.write_bytes(content)
    row = store.scans.get(scan)
    assert row is not None
    assert row.files is not None
    files = row.files | {MODEL: {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}}
    with store.database.transaction() as db:
        db.execute("UPDATE scans SET files = ? WHERE id = ?", (json.dumps(files), scan))
    return old


def _end(end: str) -> str:
    """Return the kind of an end in `pointchain/1`, which had no touching ends."""
    return "free" if end == "free" else "unseen"
