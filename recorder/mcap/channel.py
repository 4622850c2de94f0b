"""A channel of an MCAP file, with its schema. Pure."""

from __future__ import annotations

import msgspec


class LogChannel(msgspec.Struct, frozen=True):
    """A channel of a log; ``schema_data`` is the serialised descriptor set of ``schema_name``.

    What others have recorded may be in any encoding that MCAP's registry names, have metadata of its own, and no
    schema at all: then the schema's encoding is empty, and so are its name and data.
    """

    channel_id: int
    topic: str
    schema_name: str
    schema_data: bytes
    schema_encoding: str = "protobuf"
    message_encoding: str = "protobuf"
    metadata: dict[str, str] = {}

    @property
    def has_schema(self) -> bool:
        """True if there is one, were it empty."""
        return bool(self.schema_name or self.schema_data or self.schema_encoding)
