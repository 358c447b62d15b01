"""The header of a recording: its `pointchain` metadata and its hand-eye calibration."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import NotRigidError, rigid
from cell.recording.errors import RecordingHeaderError

METADATA = "pointchain"
HAND_EYE = "hand_eye.json"
FORMAT = "1"
REACH_M = 100.0
"""Largest distance of camera, table or workspace."""
PROVENANCE_BYTES = 32 << 10
"""Largest provenance, names and values together."""
_OWN = ("format", "depth_unit_m", "string_radius_m", "table_z_m", "workspace_m", "simulated", "views_as_needed")

Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class RecordingHeader:
    """The values that hold for all views of a recording. They are checked when the header is made.

    Raises:
        RecordingHeaderError: A value is not valid; the message names it.
    """

    depth_unit_m: float
    """Metres per depth count, from 1e-6 to 0.01."""
    string_radius_m: float | None
    """Radius of the string, metres, or None if not known."""
    T_flange_camera: NDArray[np.float64]
    """(4, 4) hand-eye calibration, metres."""
    table_z_m: float = 0.0
    """Height of the table in the base frame, metres."""
    workspace_m: Box | None = None
    """Box ((x0, x1), (y0, y1), (z0, z1)) in the base frame, metres. None means no limit."""
    simulated: bool | None = None
    """Whether the arm or the camera was simulated, or None if not known."""
    views_as_needed: bool = False
    """Whether the scan left viewpoints out that were not needed, so that gaps in the indices are no loss."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Further metadata, for example camera, robot or seed; at most 32 KiB."""

    def __post_init__(self) -> None:
        unit = _number("depth_unit_m", self.depth_unit_m)
        if not 1e-6 <= unit <= 0.01:
            raise RecordingHeaderError(f"depth_unit_m is {unit:g}; it must be from 1e-6 to 0.01 metres per count")
        radius = self.string_radius_m
        if radius is not None:
            radius = _number("string_radius_m", radius)
            if radius <= 0:
                raise RecordingHeaderError(f"string_radius_m is {radius:g}; it must be positive or absent")
        table_z = _number("table_z_m", self.table_z_m)
        if abs(table_z) > REACH_M:
            raise RecordingHeaderError(f"table_z_m is {table_z:g}; heights are metres")
        try:
            T = rigid(self.T_flange_camera, f"{HAND_EYE}: T_flange_camera")
        except (NotRigidError, OverflowError) as error:
            raise RecordingHeaderError(str(error)) from error
        if np.abs(T[:3, 3]).max() > REACH_M:
            raise RecordingHeaderError(
                f"{HAND_EYE}: T_flange_camera is at {T[:3, 3].tolist()} m; translations are metres"
            )
        _check_provenance(self.provenance)
        object.__setattr__(self, "depth_unit_m", unit)
        object.__setattr__(self, "string_radius_m", radius)
        object.__setattr__(self, "table_z_m", table_z)
        object.__setattr__(self, "workspace_m", _box(self.workspace_m))
        object.__setattr__(self, "T_flange_camera", T)
        object.__setattr__(self, "provenance", dict(self.provenance))


def to_metadata(header: RecordingHeader) -> dict[str, str]:
    """Return the fields of the `pointchain` metadata record, with numbers as their shortest exact decimals."""
    fields = {"format": FORMAT, "depth_unit_m": repr(header.depth_unit_m)}
    if header.string_radius_m is not None:
        fields["string_radius_m"] = repr(header.string_radius_m)
    fields["table_z_m"] = repr(header.table_z_m)
    if header.workspace_m is not None:
        fields["workspace_m"] = json.dumps(header.workspace_m)
    if header.simulated is not None:
        fields["simulated"] = json.dumps(header.simulated)
    if header.views_as_needed:
        fields["views_as_needed"] = json.dumps(True)
    return fields | dict(header.provenance)


def to_hand_eye(header: RecordingHeader) -> bytes:
    """Return the content of the attachment `hand_eye.json`."""
    return json.dumps({"T_flange_camera": header.T_flange_camera.tolist()}).encode()


def parse_header(metadata: Mapping[str, str], hand_eye: bytes) -> RecordingHeader:
    """Return the header for the fields of the metadata record and the content of the attachment.

    Args:
        metadata: Fields of the `pointchain` metadata record.
        hand_eye: Content of the attachment `hand_eye.json`.

    Raises:
        RecordingHeaderError: The format is another one, a field is missing or not valid, or T_flange_camera is not
            rigid.
    """
    if metadata.get("format") != FORMAT:
        raise RecordingHeaderError(
            f"the {METADATA!r} metadata have format {metadata.get('format', '')[:40]!r}; {FORMAT!r} is read"
        )
    if "depth_unit_m" not in metadata:
        raise RecordingHeaderError(f"the {METADATA!r} metadata lack depth_unit_m, metres per depth count")
    radius, workspace = metadata.get("string_radius_m"), metadata.get("workspace_m")
    document = _json(HAND_EYE, hand_eye)
    if not isinstance(document, dict) or "T_flange_camera" not in document:
        raise RecordingHeaderError(f"{HAND_EYE} lacks T_flange_camera, the 4x4 hand-eye calibration")
    return RecordingHeader(
        depth_unit_m=_number("depth_unit_m", metadata["depth_unit_m"]),
        string_radius_m=None if radius is None else _number("string_radius_m", radius),
        table_z_m=_number("table_z_m", metadata.get("table_z_m", "0")),
        workspace_m=None if workspace is None else _workspace(workspace),
        T_flange_camera=document["T_flange_camera"],
        simulated=_flag("simulated", metadata.get("simulated")),
        views_as_needed=bool(_flag("views_as_needed", metadata.get("views_as_needed"))),
        provenance={key: value for key, value in metadata.items() if key not in _OWN},
    )


def _check_provenance(provenance: Mapping[str, str]) -> None:
    size = 0
    for key, value in provenance.items():
        if not (isinstance(key, str) and isinstance(value, str)):
            raise RecordingHeaderError(f"provenance {key!r} is {value!r}; names and values are text")
        if key in _OWN:
            raise RecordingHeaderError(f"provenance {key!r} is a field of the format; choose another name")
        size += 8 + len(key.encode()) + len(value.encode())  # 8 bytes for the two lengths in the file
    if size > PROVENANCE_BYTES:
        raise RecordingHeaderError(f"the provenance has {size} bytes; at most {PROVENANCE_BYTES} are allowed")


def _flag(name: str, text: str | None) -> bool | None:
    values = {None: None, "true": True, "false": False}
    if text not in values:
        raise RecordingHeaderError(f"{name} is {text!r}; true, false or no value is possible")
    return values[text]


def _number(name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise RecordingHeaderError(f"{name} is {str(value)[:40]!r}; a number is needed") from error
    if not math.isfinite(number):
        raise RecordingHeaderError(f"{name} is {number}; a finite number is needed")
    return number


def _box(workspace: Any) -> Box | None:
    if workspace is None:
        return None
    wanted = "[[x0, x1], [y0, y1], [z0, z1]] with x0 < x1 and so on, in metres, is needed"
    try:
        box = np.asarray(workspace, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RecordingHeaderError(f"workspace_m is {str(workspace)[:80]}; {wanted}") from error
    if box.shape != (3, 2) or not (np.abs(box) <= REACH_M).all() or not (box[:, 0] < box[:, 1]).all():
        raise RecordingHeaderError(f"workspace_m is {str(workspace)[:80]}; {wanted}")
    (x0, x1), (y0, y1), (z0, z1) = box.tolist()
    return (x0, x1), (y0, y1), (z0, z1)


def _workspace(text: str) -> Box | None:
    workspace = _json("workspace_m", text.encode())
    if workspace is None:
        raise RecordingHeaderError("workspace_m is null; omit it when there is none")
    return _box(workspace)


def _json(name: str, data: bytes) -> Any:
    try:
        return json.loads(data, parse_int=float)
    except (ValueError, RecursionError) as error:
        raise RecordingHeaderError(f"{name} is not JSON: {error}") from error
