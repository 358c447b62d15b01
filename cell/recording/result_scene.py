"""Scene of a point chain model, for Foxglove and other MCAP viewers."""

from collections.abc import Mapping
from typing import Any

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

CROSSING_COLOUR = Color(r=0.84, g=0.15, b=0.16, a=1.0)
TEXT_COLOUR = Color(r=1.0, g=1.0, b=1.0, a=1.0)
_START, _END = (0.12, 0.47, 0.71), (1.0, 0.73, 0.15)


def scene_of_model(model: Mapping[str, Any], stamp: Timestamp) -> SceneUpdate:
    """Return the scene of a model document of schema `pointchain/2`.

    Each chain is a line of the string's thickness, coloured from its first to its last point. Each crossing is a sphere
    with a text.

    Args:
        model: Model document.
        stamp: Time stamp of the entities.
    """
    frame = model.get("frame", "base")
    entities = []
    for chain in model["chains"]:
        points = [_point(point) for point in chain["points"]]
        last = max(len(points) - 1, 1)
        line = LinePrimitive(
            type=LinePrimitive.LINE_LOOP if chain["closed"] else LinePrimitive.LINE_STRIP,
            pose=_pose((0.0, 0.0, 0.0)),
            thickness=2 * chain["radius_m"],
            points=points,
            colors=[_between(i / last) for i in range(len(points))],
        )
        entities.append(SceneEntity(timestamp=stamp, frame_id=frame, id=f"chain {chain['id']}", lines=[line]))
    for crossing in model["crossings"]:
        over, under = crossing["over"], crossing["under"]
        radius = next(chain["radius_m"] for chain in model["chains"] if chain["id"] == over["chain"])
        x, y, z = crossing["point"]
        sphere = SpherePrimitive(
            pose=_pose((x, y, z)),
            size=Vector3(x=3 * radius, y=3 * radius, z=3 * radius),
            color=CROSSING_COLOUR,
        )
        text = TextPrimitive(
            pose=_pose((x, y, z + 6 * radius)),
            billboard=True,
            font_size=2 * radius,
            color=TEXT_COLOUR,
            text=f"{crossing['id']}: {over['chain']}@{over['s_m']:.3f} m over "
            f"{under['chain']}@{under['s_m']:.3f} m, {crossing['sign']:+d}",
        )
        entities.append(
            SceneEntity(
                timestamp=stamp,
                frame_id=frame,
                id=f"crossing {crossing['id']}",
                spheres=[sphere],
                texts=[text],
            )
        )
    return SceneUpdate(entities=entities)


def _point(point: Any) -> Point3:
    x, y, z = point
    return Point3(x=x, y=y, z=z)


def _pose(position: tuple[float, float, float]) -> Pose:
    x, y, z = position
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=0, y=0, z=0, w=1))


def _between(share: float) -> Color:
    r, g, b = (start + share * (end - start) for start, end in zip(_START, _END, strict=True))
    return Color(r=r, g=g, b=b, a=1.0)
