"""The scene that viewers draw of a model."""

from typing import Any

import numpy as np
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from google.protobuf.timestamp_pb2 import Timestamp

from cell.recording.result_scene import scene_of_model

OPEN = {
    "id": 0,
    "closed": False,
    "radius_m": 0.004,
    "points": [[0, 0, 0.004], [0.1, 0, 0.004], [0.2, 0, 0.01]],
}
RING = {
    "id": 7,
    "closed": True,
    "radius_m": 0.003,
    "points": [[0, 0, 0.003], [1, 0, 0.003], [0, 1, 0.003]],
}
CROSSING = {
    "id": 2,
    "point": [0.1, 0.0, 0.008],
    "over": {"chain": 7, "s_m": 0.26},
    "under": {"chain": 0, "s_m": 0.1},
    "sign": -1,
}


def scene(**model: Any) -> Any:
    return scene_of_model({"frame": "base", "chains": [], "crossings": [], **model}, Timestamp(seconds=5))


def test_an_open_chain_is_a_tube_coloured_along_its_length() -> None:
    (entity,) = scene(chains=[OPEN]).entities
    (line,) = entity.lines
    assert (entity.id, entity.frame_id, entity.timestamp.seconds) == ("chain 0", "base", 5)
    assert line.type == LinePrimitive.LINE_STRIP
    assert (line.thickness, line.scale_invariant) == (0.008, False)
    np.testing.assert_array_equal([(p.x, p.y, p.z) for p in line.points], OPEN["points"])
    first, middle, last = line.colors
    assert first.r < middle.r < last.r
    assert {color.a for color in line.colors} == {1.0}


def test_a_closed_chain_is_a_loop() -> None:
    (entity,) = scene(chains=[RING]).entities
    assert entity.lines[0].type == LinePrimitive.LINE_LOOP


def test_a_crossing_is_a_sphere_around_both_strands_and_a_text() -> None:
    *_, entity = scene(chains=[OPEN, RING], crossings=[CROSSING]).entities
    (sphere,), (text,) = entity.spheres, entity.texts
    assert entity.id == "crossing 2"
    assert (sphere.pose.position.x, sphere.pose.position.z, sphere.pose.orientation.w) == (0.1, 0.008, 1)
    assert sphere.size.x == sphere.size.y == sphere.size.z == 3 * RING["radius_m"]
    assert text.text == "2: 7@0.260 m over 0@0.100 m, -1"
    assert text.pose.position.z > sphere.pose.position.z + sphere.size.z / 2


def test_no_string_is_an_empty_scene() -> None:
    assert len(scene().entities) == 0
