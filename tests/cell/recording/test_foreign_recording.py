"""Recordings of other writers: forms that are read, and errors of invalid recordings."""

import io
import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from cell.recording import (
    Limits,
    RecordingContentError,
    RecordingEmptyError,
    RecordingError,
    RecordingHeaderError,
    RecordingTooLargeError,
    read_recording,
    read_result,
)
from tests.cell.recording.jpeg import JPEG

WIDTH, HEIGHT = 64, 40
Messages = list[tuple[int, str, Any]]


def depth_of(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(0, 1 << 16, (HEIGHT, WIDTH)).astype(np.uint16)


def pose(index: int) -> FrameTransform:
    message = FrameTransform(parent_frame_id="base", child_frame_id="flange")
    message.translation.x, message.translation.z = 0.1 * index, 0.4
    message.rotation.x = 1.0  # half a turn about x
    return message


def calibration() -> CameraCalibration:
    return CameraCalibration(width=WIDTH, height=HEIGHT, D=[0] * 5, K=[60, 0, 31.5, 0, 61, 19.5, 0, 0, 1])


def depth(index: int) -> RawImage:
    data = depth_of(index).astype("<u2").tobytes()
    return RawImage(width=WIDTH, height=HEIGHT, encoding="16UC1", step=2 * WIDTH, data=data)


def view_messages(index: int) -> Messages:
    return [
        (index, "/tf", pose(index)),
        (index, "/camera/calibration", calibration()),
        (index, "/camera/depth", depth(index)),
    ]


@dataclass
class Foreign:
    """Content of a file of another writer. Tests change one part of it."""

    metadata: dict[str, str] = field(
        default_factory=lambda: {"format": "1", "depth_unit_m": "0.001", "string_radius_m": "0.003"}
    )
    hand_eye: bytes = json.dumps({"T_flange_camera": np.eye(4).tolist()}).encode()
    messages: Messages = field(default_factory=lambda: [m for k in range(3) for m in view_messages(k)])
    encoding: str = "protobuf"
    metadata_records: int = 1
    attachments: int = 1
    header_last: bool = False
    times: dict[int, int] = field(default_factory=dict)
    """Log time by the index of the message."""
    writer: dict[str, Any] = field(default_factory=dict)

    def find(self, index: int, topic: str) -> Any:
        return next(message for k, name, message in self.messages if (k, name) == (index, topic))

    def bytes(self) -> bytes:
        stream = io.BytesIO()
        writer = Writer(stream, **self.writer)
        writer.start(profile="", library="another")
        if not self.header_last:
            self._write_header(writer)
        channels: dict[str, int] = {}
        for place, (index, topic, message) in enumerate(self.messages):
            if topic not in channels:
                described = build_file_descriptor_set(type(message)).SerializeToString()
                schema = writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", described)
                channels[topic] = writer.register_channel(topic, self.encoding, schema)
            time = self.times.get(place, 10**18 + index)
            writer.add_message(channels[topic], time, message.SerializeToString(), time, index)
        if self.header_last:
            self._write_header(writer)
        writer.finish()
        return stream.getvalue()

    def _write_header(self, writer: Writer) -> None:
        writer.add_metadata("other", {"note": "not ours"})
        writer.add_attachment(0, 0, "../../hand_eye.json", "application/json", b"not ours")
        for _ in range(self.metadata_records):
            writer.add_metadata("pointchain", self.metadata)
        for _ in range(self.attachments):
            writer.add_attachment(0, 0, "hand_eye.json", "application/json", self.hand_eye)


def assert_three_views(path: Path) -> None:
    recording = read_recording(path)
    assert recording.missing == ()
    assert [view.index for view in recording.views] == [0, 1, 2]
    for view in recording.views:
        np.testing.assert_array_equal(view.depth, depth_of(view.index))
        assert view.depth_unit_m == 0.001
        np.testing.assert_allclose(view.T_base_flange[:3, 3], (0.1 * view.index, 0, 0.4), rtol=0, atol=1e-15)
        np.testing.assert_allclose(view.T_base_flange[:3, :3], np.diag((1, -1, -1)), rtol=0, atol=1e-15)
        np.testing.assert_array_equal(view.K, [[60, 0, 31.5], [0, 61, 19.5], [0, 0, 1]])
        assert view.stamp_s == 1e9  # a later nanosecond is below the resolution of a double


@pytest.mark.parametrize(
    "form",
    [
        {},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"chunk_size": 1},
        {"chunk_size": 12_000},
        {"enable_crcs": False},
        {"enable_data_crcs": True},
        {
            "repeat_channels": False,
            "repeat_schemas": False,
            "use_statistics": False,
            "use_summary_offsets": False,
        },
    ],
    ids=lambda form: " ".join(f"{k}={v}" for k, v in form.items()) or "default",
)
def test_every_form_of_mcap_is_read(tmp_path: Path, form: dict[str, Any]) -> None:
    (tmp_path / "f.mcap").write_bytes(Foreign(writer=form).bytes())
    assert_three_views(tmp_path / "f.mcap")


def test_messages_outside_chunks_count_toward_the_limit(tmp_path: Path) -> None:
    (tmp_path / "f.mcap").write_bytes(Foreign(writer={"use_chunking": False}).bytes())
    with pytest.raises(RecordingTooLargeError, match="holds more than 10240 bytes"):
        read_recording(tmp_path / "f.mcap", Limits(content_bytes=2 * depth_of(0).nbytes))


def test_order_and_other_topics_do_not_matter(tmp_path: Path) -> None:
    foreign = Foreign(header_last=True)
    camera = FrameTransform(parent_frame_id="flange", child_frame_id="camera")  # without a rotation, which is invalid
    foreign.messages = [(900, "/tf", camera), *reversed(foreign.messages), (1, "/elsewhere", depth(9))]
    (tmp_path / "f.mcap").write_bytes(foreign.bytes())
    assert_three_views(tmp_path / "f.mcap")
    assert read_result(tmp_path / "f.mcap") is None


def test_padded_rows_and_mono16_are_read(tmp_path: Path) -> None:
    foreign = Foreign()
    for k in range(3):
        image = foreign.find(k, "/camera/depth")
        padded = np.full((HEIGHT, 2 * WIDTH + 5), 0xAB, dtype=np.uint8)
        padded[:, : 2 * WIDTH] = depth_of(k).astype("<u2").view(np.uint8)
        image.data, image.step, image.encoding = padded.tobytes(), 2 * WIDTH + 5, "mono16"
    (tmp_path / "f.mcap").write_bytes(foreign.bytes())
    assert_three_views(tmp_path / "f.mcap")


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (CompressedImage(format="png", data=JPEG), "has the format 'png'; only jpeg is supported"),
        (CompressedImage(format="jpeg", data=bytes(range(256))), "is no JPEG, though it has that format"),
        (CompressedImage(format="jpeg", data=b""), "is no JPEG, though it has that format"),
        (CompressedImage(format="jpeg", data=JPEG[: len(JPEG) // 2]), "is a damaged JPEG: "),
    ],
    ids=["png", "random", "empty", "truncated"],
)
def test_a_view_is_complete_without_a_colour_image_that_cannot_be_used(tmp_path: Path, image: Any, reason: str) -> None:
    foreign = Foreign()
    foreign.messages += [(0, "/camera/color", CompressedImage(format="jpeg", data=JPEG))]
    foreign.messages += [(view, "/camera/color", image) for view in (1, 2)]
    (tmp_path / "f.mcap").write_bytes(foreign.bytes())
    recording = read_recording(tmp_path / "f.mcap")
    assert [view.colour_jpeg for view in recording.views] == [JPEG, None, None]
    assert recording.missing == ()
    (message,) = recording.unusable_colour
    assert message.startswith(f"views 1, 2: the colour image {reason}")
    assert message.endswith(", so it is left out")


def test_colour_images_of_another_type_are_not_used(tmp_path: Path) -> None:
    foreign = Foreign()
    foreign.messages += [(view, "/camera/color", depth(view)) for view in range(3)]
    (tmp_path / "f.mcap").write_bytes(foreign.bytes())
    recording = read_recording(tmp_path / "f.mcap")
    assert (len(recording.views), recording.missing) == (3, ())
    reason = "is of type 'foxglove.RawImage' in encoding 'protobuf'; only 'foxglove.CompressedImage' in encoding"
    (message,) = recording.unusable_colour
    assert message.startswith(f"views 0, 1, 2: the colour image {reason}")


def test_a_colour_image_with_too_many_pixels_is_not_used(tmp_path: Path) -> None:
    foreign = Foreign()
    foreign.messages += [(0, "/camera/color", CompressedImage(format="jpeg", data=JPEG))]
    (tmp_path / "f.mcap").write_bytes(foreign.bytes())
    recording = read_recording(tmp_path / "f.mcap", Limits(colour_pixels=64 * 40 - 1))
    assert recording.views[0].colour_jpeg is None
    (message,) = recording.unusable_colour
    assert message == "view 0: the colour image has 64x40 pixels; 2559 at most are read, so it is left out"


def test_incomplete_views_are_excluded_and_reported(tmp_path: Path) -> None:
    foreign = Foreign()
    foreign.messages = [m for k in (0, 1, 2, 4) for m in view_messages(k)]
    dropped = [(0, "/tf"), (1, "/camera/depth"), (1, "/camera/calibration")]
    foreign.messages = [m for m in foreign.messages if m[:2] not in dropped]
    (tmp_path / "f.mcap").write_bytes(foreign.bytes())
    recording = read_recording(tmp_path / "f.mcap")
    assert [view.index for view in recording.views] == [2, 4]
    assert recording.missing == (
        "view 0 has no pose (/tf, base to flange)",
        "view 1 has no calibration (/camera/calibration), no depth image (/camera/depth)",
        "view 3 is not in the file",
    )


def refused(foreign: Foreign, folder: Path) -> RecordingError:
    """Return the error of reading."""
    (folder / "f.mcap").write_bytes(foreign.bytes())
    with pytest.raises(RecordingError) as caught:
        read_recording(folder / "f.mcap")
    return caught.value


def assert_error(error: RecordingError, kind: type[RecordingError], message: str) -> None:
    assert type(error) is kind, error
    assert re.search(message, str(error)), error


NAN = float("nan")
K = [60, 0, 31.5, 0, 61, 19.5, 0, 0, 1]


@pytest.mark.parametrize(
    ("topic", "fields", "message"),
    [
        ("/tf", {"translation": Vector3(x=NAN)}, "T_base_flange holds NaN or infinity"),
        ("/tf", {"rotation": Quaternion(w=float("inf"))}, "T_base_flange holds NaN or infinity"),
        ("/tf", {"rotation": Quaternion(x=2)}, "T_base_flange has a rotation quaternion of length 2"),
        ("/tf", {"rotation": Quaternion(x=1e300)}, "T_base_flange has a rotation quaternion of length inf"),
        ("/tf", {"rotation": Quaternion()}, "T_base_flange has a rotation quaternion of length 0"),
        ("/tf", {"translation": Vector3(z=400)}, "T_base_flange is at .*400.* translations are metres"),
        ("/tf", {"translation": Vector3(z=1e300)}, "T_base_flange is at .*1e.?300"),
        ("/camera/calibration", {"K": [NAN, *K[1:]]}, "K holds NaN or infinity"),
        ("/camera/calibration", {"K": K[:8]}, "/camera/calibration has 8 values of K; 9 are needed"),
        ("/camera/calibration", {"K": []}, "/camera/calibration has 0 values of K; 9 are needed"),
        ("/camera/calibration", {"K": [0, *K[1:]]}, "K has focal lengths 0, 61 pixels"),
        ("/camera/calibration", {"K": [1e-300, *K[1:]]}, "K has focal lengths 1e-300, 61 pixels"),
        ("/camera/calibration", {"K": [60, 2, *K[2:]]}, r"K is \[\[60.0, 2.0.*\[\[fx, 0, cx\]"),
        (
            "/camera/calibration",
            {"K": [60, 0, 320, *K[3:]]},
            r"K has its centre at \(320, 19.5\), outside the 64x40",
        ),
        ("/camera/calibration", {"D": [0.1, 0, 0, 0, 0]}, r"distortion \[0.1, .* rectified"),
        ("/camera/calibration", {"D": [NAN]}, r"distortion \[nan\]"),
        ("/camera/calibration", {"width": 128}, "calibration is of 128x40 pixels, the depth image of 64x40"),
        ("/camera/depth", {"encoding": "32FC1"}, "the depth image has encoding '32FC1'; only 16UC1"),
        ("/camera/depth", {"encoding": "mono8"}, "the depth image has encoding 'mono8'; only 16UC1"),
        ("/camera/depth", {"data": b"\1" * 100}, "image of 64x40 pixels, 128 bytes a row, is 100 bytes"),
        ("/camera/depth", {"step": 64}, "64 bytes a row, is 5120 bytes"),
        ("/camera/depth", {"height": 20}, "image of 64x20 pixels, 128 bytes a row, is 5120 bytes"),
        ("/camera/depth", {"width": 0, "step": 0, "data": b""}, r"the depth image is empty \(0x40\)"),
    ],
)
def test_an_invalid_view_is_named(tmp_path: Path, topic: str, fields: dict[str, Any], message: str) -> None:
    foreign = Foreign()
    wrong = foreign.find(1, topic)
    for name, value in fields.items():
        wrong.ClearField(name)
        wrong.MergeFrom(type(wrong)(**{name: value}))
    assert_error(refused(foreign, tmp_path), RecordingContentError, f"^view 1: .*{message}")


def test_messages_that_announce_too_many_bytes_are_refused(tmp_path: Path) -> None:
    foreign = Foreign()
    foreign.find(1, "/camera/depth").width = 2**31
    error = refused(foreign, tmp_path)
    assert_error(error, RecordingTooLargeError, "^view 1: the depth image announces 2147483648x40 pixels")
    foreign = Foreign()
    foreign.find(1, "/camera/calibration").D.extend([0.0] * 10_000)
    error = refused(foreign, tmp_path)
    assert_error(error, RecordingTooLargeError, "^view 1: /camera/calibration has 80... bytes; 65536 at most")


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("/tf", r"view 0, 1, 2 has no pose \(/tf, base to flange\)"),
        ("/camera/calibration", r"view 0, 1, 2 has no calibration \(/camera/calibration\)"),
        ("/camera/depth", r"view 0, 1, 2 has no depth image \(/camera/depth\)"),
        ("", "it has no message of any view"),
    ],
)
def test_a_recording_without_complete_views_reports_why(tmp_path: Path, topic: str, message: str) -> None:
    foreign = Foreign()
    foreign.messages = [m for m in foreign.messages if topic and m[1] != topic]
    assert_error(refused(foreign, tmp_path), RecordingEmptyError, f"f.mcap has no complete view: {message}$")


@pytest.mark.parametrize("encoding", ["json", "cdr"])
def test_other_encodings_are_named(tmp_path: Path, encoding: str) -> None:
    message = f"/tf has .* encoding '{encoding}'; only 'foxglove.FrameTransform' in encoding 'protobuf' is read"
    assert_error(refused(Foreign(encoding=encoding), tmp_path), RecordingContentError, message)


@pytest.mark.parametrize(
    ("messages", "kind", "message"),
    [
        (view_messages(1), RecordingContentError, "^view 1 is duplicated: it has two messages on /tf"),
        ([(1, "/camera/depth", depth(1))], RecordingContentError, "^view 1 is duplicated.*/camera/depth"),
        ([(64, "/tf", pose(0))], RecordingTooLargeError, r"^view 64 \(/tf\): .* are from 0 to 63"),
        ([(2**32 - 1, "/tf", pose(0))], RecordingTooLargeError, "^view 4294967295"),
    ],
)
def test_too_many_views_are_refused(
    tmp_path: Path, messages: Messages, kind: type[RecordingError], message: str
) -> None:
    foreign = Foreign()
    foreign.messages += messages
    assert_error(refused(foreign, tmp_path), kind, message)


def test_parts_with_different_times_or_types_are_refused(tmp_path: Path) -> None:
    error = refused(Foreign(times={5: 10**18 + 50}), tmp_path)
    assert_error(error, RecordingContentError, "^view 1: its messages have different times.*/camera/depth")
    error = refused(Foreign(messages=[(0, "/camera/depth", pose(0))]), tmp_path)
    assert_error(error, RecordingContentError, "/camera/depth has messages of type 'foxglove.FrameTransform'")


@pytest.mark.parametrize(
    ("foreign", "message"),
    [
        (Foreign(metadata_records=0), r"f\.mcap has no 'pointchain' metadata: it is not a recording of a scan"),
        (Foreign(metadata_records=2), r"f\.mcap has its 'pointchain' metadata twice"),
        (Foreign(attachments=0), r"f\.mcap has no attachment hand_eye\.json: the pose of the camera is unknown"),
        (Foreign(attachments=2), r"f\.mcap has its attachment hand_eye\.json twice"),
    ],
)
def test_the_header_must_exist_once(tmp_path: Path, foreign: Foreign, message: str) -> None:
    assert_error(refused(foreign, tmp_path), RecordingHeaderError, message)


@pytest.mark.parametrize("stored", [b"[1]", b'{"a": NaN}', b"{", b"[" * 100_000])
def test_a_result_that_is_not_a_json_object_is_refused(tmp_path: Path, stored: bytes) -> None:
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start()
    channel = writer.register_channel("/result/model", "json", 0)
    writer.add_message(channel, 0, stored, 0)
    writer.finish()
    (tmp_path / "f.mcap").write_bytes(stream.getvalue())
    with pytest.raises(RecordingContentError, match=r"/result/model in f\.mcap is"):
        read_result(tmp_path / "f.mcap")


def intensity(index: int) -> RawImage:
    grey = (depth_of(index) >> 8).astype(np.uint8)
    return RawImage(width=WIDTH, height=HEIGHT, encoding="mono8", step=WIDTH, data=grey.tobytes())


def test_a_recording_without_intensity_images_is_read(tmp_path: Path) -> None:
    (tmp_path / "f.mcap").write_bytes(Foreign().bytes())
    assert [view.intensity for view in read_recording(tmp_path / "f.mcap").views] == [None, None, None]


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_an_intensity_image_with_padding_is_read(tmp_path: Path, encoding: str) -> None:
    foreign, image = Foreign(), intensity(1)
    grey = np.frombuffer(image.data, dtype=np.uint8).reshape(HEIGHT, WIDTH)
    image.step = WIDTH + 3
    image.encoding = encoding
    image.data = np.pad(grey, ((0, 0), (0, 3)), constant_values=255).tobytes()
    foreign.messages.append((1, "/camera/intensity", image))
    (tmp_path / "f.mcap").write_bytes(foreign.bytes())
    first, second, _ = read_recording(tmp_path / "f.mcap").views
    assert first.intensity is None
    np.testing.assert_array_equal(second.intensity, grey)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"width": 32, "step": 32, "height": 80}, RecordingContentError, r"is uint8 \(80, 32\); uint8 of 64x40"),
        ({"encoding": "rgb8"}, RecordingContentError, "view 1: the intensity image has encoding 'rgb8'; only mono8"),
        ({"encoding": "16UC1"}, RecordingContentError, "the intensity image has encoding '16UC1'"),
        ({"step": 32}, RecordingContentError, "intensity image of 64x40 pixels, 32 bytes a row, is 2560 bytes"),
        ({"height": 41}, RecordingContentError, "intensity image of 64x41 pixels, 64 bytes a row, is 2560 bytes"),
        ({"height": 0}, RecordingContentError, "the intensity image is empty"),
        ({"width": 1 << 20, "height": 1 << 11}, RecordingTooLargeError, "the intensity image announces 1048576x2048"),
    ],
)
def test_an_intensity_image_that_does_not_fit_is_refused(
    tmp_path: Path, change: dict[str, Any], error: type[RecordingError], message: str
) -> None:
    foreign, image = Foreign(), intensity(1)
    for name, value in change.items():
        setattr(image, name, value)
    foreign.messages.append((1, "/camera/intensity", image))
    (tmp_path / "f.mcap").write_bytes(foreign.bytes())
    with pytest.raises(error, match=message):
        read_recording(tmp_path / "f.mcap")


def test_two_intensity_images_of_a_view_are_refused(tmp_path: Path) -> None:
    foreign = Foreign()
    foreign.messages += [(1, "/camera/intensity", intensity(k)) for k in range(2)]
    (tmp_path / "f.mcap").write_bytes(foreign.bytes())
    with pytest.raises(RecordingContentError, match="view 1 is duplicated: it has two messages on /camera/intensity"):
        read_recording(tmp_path / "f.mcap")
