"""An open bag with its topics and messages. Only this file uses `rosbags`."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cell.bag.errors import BagError
from cell.recording.errors import shown

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Message types of /tf. The second one is of the oldest ROS 1 bags."""
STORAGE_SUFFIXES = (".db3", ".mcap")


class Bag:
    """An open bag. Errors of `rosbags` in a damaged bag become BagError."""

    def __init__(self, path: Path, reader: "AnyReader") -> None:
        self._path, self._reader = path, reader
        self.ros = 2 if reader.is2 else 1
        """Version of ROS that wrote the bag."""
        self.topics: Mapping[str, str] = {
            connection.topic: connection.msgtype for connection in reader.connections if connection.msgcount
        }
        """Type of each topic with messages, in the spelling of ROS 2."""

    @property
    def name(self) -> str:
        """Name of the file or folder."""
        return self._path.name

    def topics_of(self, *types: str) -> list[str]:
        """Return the sorted topics of these types."""
        return sorted(topic for topic, kind in self.topics.items() if kind in types)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, Any]]:
        """Yield the messages on `topics` with their topic, in the order of recording. Raise BagError for damage."""
        connections = [connection for connection in self._reader.connections if connection.topic in topics]
        if not connections:  # `rosbags` would return all messages
            return
        with _describe_error(self._path):
            for connection, _, data in self._reader.messages(connections):
                yield connection.topic, self._reader.deserialize(data, connection.msgtype)


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag.

    Args:
        path: A .bag file, a folder, or a file of such a folder.

    Raises:
        BagError: There is no bag, it cannot be read, or the package `rosbags` is missing.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise BagError(
            "reading bags needs the extra `bag`: install the package with it, as 'WHEEL[bag]' in place of WHEEL"
        ) from error
    with ExitStack() as stack:
        with _describe_error(path):
            # only since Iron do bags contain the types, and the types here are the same in all versions
            reader = AnyReader([_storage(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            stack.enter_context(reader)
            bag = Bag(path, reader)
        yield bag


def _storage(path: Path) -> Path:
    """Return what `rosbags` opens. A folder without metadata, which a killed recorder leaves, has one file."""
    if not path.exists():
        raise BagError(f"there is no {path}")
    if path.is_dir() and path.suffix == ".bag":
        raise BagError(f"{path.name} is a folder, but its name ends like that of a ROS 1 bag: rename it")
    if not path.is_dir() or (path / "metadata.yaml").exists():
        if path.suffix in (".bag", *STORAGE_SUFFIXES) or path.is_dir():
            return path
        raise BagError(f"{path.name} is not a bag: name a .bag file or the folder of a ROS 2 bag")
    files = [file for file in sorted(path.iterdir()) if file.suffix in STORAGE_SUFFIXES]
    if len(files) != 1:
        raise BagError(
            f"{path.name} has no metadata.yaml and {len(files)} files of a ROS 2 bag: have it made by "
            "`ros2 bag reindex`, or name one file"
        )
    return files[0]


@contextmanager
def _describe_error(path: Path) -> Iterator[None]:
    """Turn errors of `rosbags` into BagError."""
    try:
        yield
    except BagError:
        raise
    except OSError as error:
        raise BagError(f"{path.name} cannot be read: {error.strerror or shown(error)}") from error
    except Exception as error:  # `rosbags` raises errors of any kind for a damaged bag
        why = shown(error) or type(error).__name__
        raise BagError(
            f"{path.name} cannot be read as a bag: {why} (try `ros2 bag reindex` or `rosbag reindex` "
            "if its recorder was killed)"
        ) from error
