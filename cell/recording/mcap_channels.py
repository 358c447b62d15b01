"""Channels of an MCAP file: protobuf messages with Foxglove's types, and models as JSON."""

from typing import Any

from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set


def register_channel(writer: Writer, topic: str, message: Any) -> int:
    """Register a channel and return its id.

    Args:
        writer: Writer of the file.
        topic: Topic of the channel.
        message: First message, a protobuf message or the bytes of a model, which determines the schema.
    """
    if isinstance(message, bytes):
        schema = writer.register_schema("pointchain/2", "jsonschema", b'{"type": "object"}')
        return writer.register_channel(topic, "json", schema)
    description = build_file_descriptor_set(type(message)).SerializeToString(deterministic=True)
    schema = writer.register_schema(message.DESCRIPTOR.full_name, "protobuf", description)
    return writer.register_channel(topic, "protobuf", schema)
