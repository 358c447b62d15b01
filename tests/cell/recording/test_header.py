"""The header of a recording: its fields, and the values that are refused."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from cell.recording import RecordingHeader, RecordingHeaderError
from cell.recording.header import parse_header, to_hand_eye, to_metadata

HEADER = RecordingHeader(
    depth_unit_m=1e-4,
    string_radius_m=0.0042,
    T_flange_camera=from_rotation_vector((0.03, -0.06, 0.05), (0.05, 0.02, -1.55)),
    table_z_m=-0.01,
    workspace_m=((-0.3, 0.3), (-0.2, 0.2), (0.0, 0.1)),
    provenance={"camera": "made", "seed": "3"},
)
HAND_EYE = json.dumps({"T_flange_camera": np.eye(4).tolist()}).encode()
METADATA = {"format": "1", "depth_unit_m": "0.001"}
NAN = float("nan")
MILLIMETRES = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 150], [0, 0, 0, 1]]


def test_every_field_is_read_exactly() -> None:
    got = parse_header(to_metadata(HEADER), to_hand_eye(HEADER))
    np.testing.assert_array_equal(got.T_flange_camera, HEADER.T_flange_camera)
    assert (got.depth_unit_m, got.string_radius_m, got.table_z_m) == (1e-4, 0.0042, -0.01)
    assert got.workspace_m == HEADER.workspace_m
    assert got.provenance == {"camera": "made", "seed": "3"}


@pytest.mark.parametrize(("as_needed", "text"), [(True, "true"), (False, None)])
def test_the_header_says_whether_viewpoints_were_left_out(as_needed: bool, text: str | None) -> None:
    header = replace(HEADER, views_as_needed=as_needed)
    assert to_metadata(header).get("views_as_needed") == text
    assert parse_header(to_metadata(header), HAND_EYE).views_as_needed is as_needed
    with pytest.raises(RecordingHeaderError, match="views_as_needed is '1'"):
        parse_header(METADATA | {"views_as_needed": "1"}, HAND_EYE)


@pytest.mark.parametrize(("simulated", "text"), [(True, "true"), (False, "false"), (None, None)])
def test_the_header_says_whether_the_cell_was_simulated(simulated: bool | None, text: str | None) -> None:
    header = replace(HEADER, simulated=simulated)
    assert to_metadata(header).get("simulated") == text
    assert parse_header(to_metadata(header), HAND_EYE).simulated is simulated
    with pytest.raises(RecordingHeaderError, match="simulated is 'yes'; true, false or no value is possible"):
        parse_header(METADATA | {"simulated": "yes"}, HAND_EYE)


def test_unknown_fields_are_omitted() -> None:
    header = RecordingHeader(depth_unit_m=1e-3, string_radius_m=None, T_flange_camera=np.eye(4))
    assert to_metadata(header) == {"format": "1", "depth_unit_m": "0.001", "table_z_m": "0.0"}
    got = parse_header(METADATA, HAND_EYE)
    assert (got.string_radius_m, got.workspace_m, got.table_z_m, got.provenance) == (None, None, 0.0, {})


def test_numpy_numbers_are_stored_as_plain_numbers() -> None:
    header = replace(HEADER, string_radius_m=np.float64(0.003), table_z_m=np.float64(0.5))
    assert to_metadata(header)["string_radius_m"] == "0.003"
    assert to_metadata(header)["table_z_m"] == "0.5"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth_unit_m": 1.0}, "depth_unit_m is 1; it must be from 1e-6 to 0.01"),
        ({"depth_unit_m": NAN}, "depth_unit_m is nan; a finite number"),
        ({"string_radius_m": 0.0}, "string_radius_m is 0; it must be positive"),
        ({"string_radius_m": float("inf")}, "string_radius_m is inf"),
        ({"table_z_m": 1e300}, r"table_z_m is 1e\+300; heights are metres"),
        ({"workspace_m": ((0.0, 1.0), (0.0, 1.0))}, "workspace_m is .* is needed"),
        ({"T_flange_camera": 2 * np.eye(4)}, r"hand_eye\.json: T_flange_camera has the last row"),
        ({"provenance": {"format": "2"}}, "'format' is a field of the format"),
        ({"provenance": {"seed": 3}}, "'seed' is 3; names and values are text"),
        ({"provenance": {"note": "x" * 40_000}}, "the provenance has 40012 bytes; at most 32768"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_an_invalid_header_is_not_created(change: dict[str, Any], message: str) -> None:
    with pytest.raises(RecordingHeaderError, match=message):
        replace(HEADER, **change)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"format": None}, "have format ''; '1' is read"),
        ({"format": "2"}, "have format '2'; '1' is read"),
        ({"depth_unit_m": None}, "lack depth_unit_m"),
        ({"depth_unit_m": "1 mm"}, "depth_unit_m is '1 mm'; a number is needed"),
        ({"depth_unit_m": "nan"}, "depth_unit_m is nan"),
        ({"string_radius_m": "-0.003"}, "string_radius_m is -0.003; it must be positive"),
        ({"string_radius_m": "thin"}, "string_radius_m is 'thin'; a number is needed"),
        ({"table_z_m": "-inf"}, "table_z_m is -inf"),
        ({"workspace_m": "[[0, 1]"}, "workspace_m is not JSON"),
        ({"workspace_m": "[" * 20_000}, "workspace_m is not JSON"),
        ({"workspace_m": "[[0, NaN], [0, 1], [0, 1]]"}, "workspace_m is .* x0 < x1"),
        ({"workspace_m": "[[1, 0], [0, 1], [0, 1]]"}, "workspace_m is .* x0 < x1"),
        ({"workspace_m": '{"x": 1}'}, "workspace_m is .* x0 < x1"),
        ({"workspace_m": "null"}, "workspace_m is null; omit it"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_invalid_metadata_are_refused(fields: dict[str, str | None], message: str) -> None:
    metadata = {key: value for key, value in {**METADATA, **fields}.items() if value is not None}
    with pytest.raises(RecordingHeaderError, match=message):
        parse_header(metadata, HAND_EYE)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff\xfe{", "hand_eye.json is not JSON"),
        (b"[" * 60_000, "hand_eye.json is not JSON"),
        (b"[1]", "hand_eye.json lacks T_flange_camera"),
        (b'{"T": 1}', "hand_eye.json lacks T_flange_camera"),
        (np.eye(3).tolist(), r"hand_eye.json: T_flange_camera has shape \(3, 3\)"),
        ([[1, 2], [3]], "hand_eye.json: T_flange_camera is not a matrix of numbers"),
        (None, "hand_eye.json: T_flange_camera"),
        ([[None] * 4] * 4, "hand_eye.json: T_flange_camera"),
        (np.diag([1, 1, -1, 1]).tolist(), "hand_eye.json: T_flange_camera is mirrored"),
        (np.diag([2, 2, 2, 1]).tolist(), "hand_eye.json: T_flange_camera is not rigid"),
        (np.full((4, 4), NAN).tolist(), "hand_eye.json: T_flange_camera holds NaN"),
        ([[10**400] * 4] * 4, "hand_eye.json: T_flange_camera holds NaN or infinity"),
        (MILLIMETRES, "hand_eye.json: T_flange_camera is at .* translations are metres"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_an_invalid_hand_eye_is_refused(content: Any, message: str) -> None:
    hand_eye = content if isinstance(content, bytes) else json.dumps({"T_flange_camera": content}).encode()
    with pytest.raises(RecordingHeaderError, match=message):
        parse_header(METADATA, hand_eye)
