"""The settings that are tried on recorded runs."""

from __future__ import annotations

import msgspec

from recorder.reading.configurations import CONFIGURATION
from schemas.configuration import TomlSource, merge
from schemas.settings import Settings


class TriedSettings(msgspec.Struct, frozen=True):
    """The run's own configuration or a whole other one, and changes to it. Called with the recorded TOML text.

    Attributes:
        text: the other configuration as TOML; None for the run's own.
        path: the file that it is from.
        changes: values by the name of the setting, as ``command.speed_limit_mps``.
    """

    text: str | None
    path: str
    changes: dict[str, object]

    @property
    def is_own(self) -> bool:
        """Nothing else is tried than what the run had."""
        return self.text is None and not self.changes

    def __call__(self, recorded: str) -> Settings:
        """Return the settings to try.

        Raises:
            CommandError: a value is none of this version.
        """
        if self.text is None:
            source = TomlSource(CONFIGURATION, recorded, is_recorded=True)
        else:
            source = TomlSource(self.path, self.text)
        return merge(source, {}, self.changes)
