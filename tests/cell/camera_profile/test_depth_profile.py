"""Profiles as JSON."""

import json

import pytest

from cell.camera_profile.depth_profile import (
    DepthProfile,
    ProfileError,
    format_quantity,
    from_document,
    to_document,
)

PROFILE = DepthProfile(
    width=640,
    height=400,
    focal_px=402.5,
    poses=2,
    exposures=5,
    table_pixels=300_000,
    distance_m=0.5,
    focal_baseline_px_m=30.0,
    temporal_m=0.0005,
    ripple_m=0.001,
    locking_m=0.0012,
    rest_m=0.0004,
    correlation_px=2.5,
    correlation_rows_px=2.0,
    warp_m=0.001,
    hole_share=0.01,
    flicker_share=0.002,
    edge_hole_share=None,
)


def test_a_profile_survives_json() -> None:
    assert from_document(json.loads(json.dumps(to_document(PROFILE)))) == PROFILE


def test_errors_are_also_in_pixels() -> None:
    document = to_document(PROFILE)
    assert document["ripple_px"] == pytest.approx(0.001 * 30 / 0.25)


def test_depth_errors_grow_with_the_square_of_the_distance() -> None:
    assert PROFILE.value_at("ripple_m", 1.0) == pytest.approx(0.004)
    assert PROFILE.value_at("correlation_px", 1.0) == 2.5
    assert PROFILE.value_at("edge_hole_share", 1.0) is None


def test_a_quantity_has_its_unit() -> None:
    shown = [
        format_quantity(*value) for value in (("warp_m", 0.00123), ("hole_share", 0.0456), ("correlation_px", 2.34))
    ]
    assert shown == ["1.23 mm", "4.6 %", "2.3 px"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ripple_m": -1.0}, "ripple_m is -1.0"),
        ({"ripple_m": None}, "ripple_m is None"),
        ({"hole_share": "many"}, "hole_share is 'many'"),
        ({"width": 640.5}, "width is 640.5; a whole number"),
        ({"poses": True}, "poses is True"),
    ],
)
def test_wrong_members_are_named(change: dict[str, object], message: str) -> None:
    with pytest.raises(ProfileError, match=message):
        from_document(to_document(PROFILE) | change)


def test_other_documents_are_rejected() -> None:
    with pytest.raises(ProfileError, match="a JSON object"):
        from_document([])
    with pytest.raises(ProfileError, match="lacks width"):
        from_document({})
