"""What a file that continues another begins with, so that each can be read alone. Pure."""

from __future__ import annotations

from typing import Final

from recorder.layouts.attached import COUNT as LAYOUTS
from recorder.record.effects import DeclareChannel, FileEffect, WriteAttachment, WriteMetadata
from schemas.recorder_settings import ROBOT_LIMIT

ATTACHMENTS_MAX: Final = (2 + LAYOUTS) * ROBOT_LIMIT
"""A configuration, a DBC and layouts for each robot; beyond it the oldest go, for a robot may make up names."""


class Prologue:
    """Remembers channels, and of metadata and attachments that last the newest of each name."""

    def __init__(self) -> None:
        self._channels: dict[int, DeclareChannel] = {}
        self._metadata: dict[str, WriteMetadata] = {}
        self._attachments: dict[str, WriteAttachment] = {}

    def take(self, effect: FileEffect) -> None:
        """An effect on its way into a file."""
        if isinstance(effect, DeclareChannel):
            self._channels[effect.channel.channel_id] = effect
        elif isinstance(effect, WriteMetadata) and effect.lasts:
            self._metadata[effect.name] = effect
        elif isinstance(effect, WriteAttachment):
            self._attachments.pop(effect.name, None)
            self._attachments[effect.name] = effect
            if len(self._attachments) > ATTACHMENTS_MAX:
                del self._attachments[next(iter(self._attachments))]

    @property
    def effects(self) -> list[FileEffect]:
        """The beginning of the next file."""
        return [*self._metadata.values(), *self._attachments.values(), *self._channels.values()]
