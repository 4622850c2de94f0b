"""The names and locks of log files. A module of its own, because readers need nothing else of the writer."""

from __future__ import annotations

import fcntl
from typing import Final

SUFFIX: Final = ".mcap"
PART_SUFFIX: Final = ".mcap.part"
SIGNATURE_SUFFIX: Final = ".sig"  # behind the name of a signed log
INCIDENT_SUFFIX: Final = ".incident"  # before ``.mcap`` in the name of an incident, which retention protects


def is_log(name: str) -> bool:
    """True of names of logs. Hidden files are not logs: macOS puts a ``._NAME`` beside each file of a stick."""
    return name.endswith((SUFFIX, PART_SUFFIX)) and not name.startswith(".")


def lock(descriptor: int) -> bool:
    """Lock a file until it is closed. False if another process holds it; OSError without locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def lock_own(descriptor: int) -> bool:
    """As ``lock``; True also where this file system has no locks."""
    try:
        return lock(descriptor)
    except OSError:
        return True  # Without locks, no other process recovers files either.
