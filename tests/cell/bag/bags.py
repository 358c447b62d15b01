"""Bags of ROS 1 and ROS 2 of scans with known truth, written by rosbags."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from calibration.geometry.transforms import to_quaternion
from cell.devices import View

Kind = Literal["ros1", "sqlite3", "mcap"]
KINDS: tuple[Kind, ...] = ("ros1", "sqlite3", "mcap")
DEPTH, INFO, TF, TF_STATIC = "/camera/depth/image_rect_raw", "/camera/depth/camera_info", "/tf", "/tf_static"
CAMERA = "camera_depth_optical_frame"
START_NS = 1_767_225_600_000_000_000

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Moment:
    """Message of a bag."""

    topic: str
    stamp_ns: int
    make: Callable[["Ros"], Any]


class Ros:
    """The message types of one version of ROS."""

    def __init__(self, version: int) -> None:
        self.version = version
        self.store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_JAZZY)
        if version == 1:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))

    def new(self, kind: str, **values: Any) -> Any:
        return self.store.types[kind](**values)

    def header(self, stamp_ns: int, frame: str) -> Any:
        stamp = self.new("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        more = {"seq": 0} if self.version == 1 else {}
        return self.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def tf(self, stamp_ns: int, edges: Mapping[tuple[str, str], Matrix]) -> Any:
        transforms = []
        for (parent, child), T in edges.items():
            x, y, z = T[:3, 3]
            qx, qy, qz, qw = to_quaternion(T)
            transform = self.new(
                "geometry_msgs/msg/Transform",
                translation=self.new("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                rotation=self.new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
            )
            header = self.header(stamp_ns, parent)
            transforms.append(
                self.new("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=transform)
            )
        return self.new("tf2_msgs/msg/TFMessage", transforms=transforms)

    def image(self, stamp_ns: int, pixels: NDArray[Any], encoding: str, frame: str, changes: Mapping[str, Any]) -> Any:
        height, width = pixels.shape
        values = {
            "header": self.header(stamp_ns, frame),
            "height": height,
            "width": width,
            "encoding": encoding,
            "is_bigendian": int(pixels.dtype.byteorder == ">"),
            "step": width * pixels.itemsize,
            "data": np.frombuffer(pixels.tobytes(), np.uint8),
        }
        return self.new("sensor_msgs/msg/Image", **(values | dict(changes)))

    def info(self, stamp_ns: int, K: Matrix, size: tuple[int, int], frame: str, changes: Mapping[str, Any]) -> Any:
        values: dict[str, Any] = {
            "D": np.zeros(5),
            "K": K.ravel(),
            "R": np.eye(3).ravel(),
            "P": np.column_stack([K, np.zeros(3)]).ravel(),
        } | dict(changes)
        names = {name: values[name] for name in "DKRP"} if self.version == 1 else {n.lower(): values[n] for n in "DKRP"}
        roi = self.new("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self.new(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, frame),
            width=size[0],
            height=size[1],
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=roi,
            **names,
        )


@dataclass(frozen=True)
class Recorded:
    """How a scan is recorded in a bag."""

    encoding: str = "16UC1"
    edges: Callable[[Matrix], Mapping[tuple[str, str], Matrix]] = lambda T: {("base", "tool0"): T}
    """Transforms in /tf for a flange pose."""
    static: Mapping[tuple[str, str], Matrix] | None = None
    """Transforms in /tf_static. None: the camera is on tool0."""
    frame: str = CAMERA
    image: Mapping[str, Any] = field(default_factory=dict)
    """Changed fields of each image."""
    info: Mapping[str, Any] = field(default_factory=dict)
    """Changed matrices of each CameraInfo."""

    def pixels(self, view: View) -> NDArray[Any]:
        if self.encoding == "32FC1":
            metres = view.depth.astype(np.float32) * np.float32(view.depth_unit_m)
            metres[view.depth == 0] = np.nan
            return metres
        return view.depth

    def beginning(self, view: View) -> Iterator[Moment]:
        static = {("tool0", self.frame): view.T_flange_camera} if self.static is None else self.static
        if static:
            yield Moment(TF_STATIC, START_NS, lambda ros: ros.tf(START_NS, static))
        yield self.intrinsics(view, START_NS)

    def intrinsics(self, view: View, at_ns: int) -> Moment:
        height, width = view.depth.shape
        return Moment(INFO, at_ns, lambda ros: ros.info(at_ns, view.K, (width, height), self.frame, self.info))

    def pose(self, T_base_flange: Matrix, at_ns: int) -> Moment:
        return Moment(TF, at_ns, lambda ros: ros.tf(at_ns, self.edges(T_base_flange)))

    def depth(self, pixels: NDArray[Any], at_ns: int) -> Moment:
        return Moment(DEPTH, at_ns, lambda ros: ros.image(at_ns, pixels, self.encoding, self.frame, self.image))


def one_image_each(views: Iterable[View], how: Recorded) -> Iterator[Moment]:
    """Yield the messages of a bag with one image and one pose per view, three seconds apart."""
    for k, view in enumerate(views):
        if k == 0:
            yield from how.beginning(view)
        at_ns = round(view.stamp_s * 1e9)
        yield how.pose(view.T_base_flange, at_ns)
        yield how.depth(how.pixels(view), at_ns)


def write_bag(path: Path, kind: Kind, moments: Iterable[Moment]) -> Path:
    """Write a bag and return its path: a file for ROS 1, a folder for ROS 2."""
    ros = Ros(1 if kind == "ros1" else 2)
    with _writer(path, kind) as writer:
        connections: dict[str, Any] = {}
        for moment in moments:
            message = moment.make(ros)
            if moment.topic not in connections:
                connections[moment.topic] = writer.add_connection(
                    moment.topic, message.__msgtype__, typestore=ros.store
                )
            serialise = ros.store.serialize_ros1 if kind == "ros1" else ros.store.serialize_cdr
            writer.write(connections[moment.topic], moment.stamp_ns, serialise(message, message.__msgtype__))
    return path


@contextmanager
def _writer(path: Path, kind: Kind) -> Iterator[Any]:
    if kind == "ros1":
        with Writer1(path) as writer:
            yield writer
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        with Writer2(path, version=9, storage_plugin=plugin) as writer:
            yield writer
