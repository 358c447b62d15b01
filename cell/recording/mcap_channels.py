"""How our messages are declared in an MCAP file: protobuf ones by Foxglove's types, models as JSON."""

from typing import Any

from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set


def register_channel(writer: Writer, topic: str, message: Any) -> int:
    """Declares a topic of messages like this one, a protobuf message or the bytes of a model; its channel's id."""
    if isinstance(message, bytes):
        schema = writer.register_schema("pointchain/1", "jsonschema", b'{"type": "object"}')
        return writer.register_channel(topic, "json", schema)
    description = build_file_descriptor_set(type(message)).SerializeToString(deterministic=True)
    schema = writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", description)
    return writer.register_channel(topic, "protobuf", schema)
