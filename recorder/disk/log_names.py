"""The names of log files. Kept apart: a question needs them, and nothing else of what writes a log."""

from __future__ import annotations

from typing import Final

SUFFIX: Final = ".mcap"
PART_SUFFIX: Final = ".mcap.part"
SIGNATURE_SUFFIX: Final = ".sig"  # follows the name of a log that its recorder has signed

INCIDENT_SUFFIX: Final = ".incident"
"""Stands before ``.mcap`` in the name of an incident: such a file is never deleted for want of room."""


def is_log(name: str) -> bool:
    """True of the names of logs. Hidden files are none: macOS puts a ``._NAME`` beside each file of a stick."""
    return name.endswith((SUFFIX, PART_SUFFIX)) and not name.startswith(".")
