"""The manifest of a log, which lies beside it in the store: made before the log, and verified after it. Pure.

The store makes a manifest only where none is. So nobody overwrites the log of somebody else, and nothing depends
on lists, which a store may answer with those of a while ago.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from typing import Final

import msgspec

FORMAT: Final = "cruiser.upload/1"

MANIFEST_SUFFIX: Final = ".json"
"""Follows the log's own name."""

ROW_SUFFIX: Final = ".row.json.zst"
"""Follows the log's own name: its row of the catalog."""

NAMESAKES_MAX: Final = 20
"""Different logs of one name that a store takes, each with a number."""


class UploadState(Enum):
    """The progress of an upload."""

    UPLOADING = "uploading"
    """Begun. The log beside it may be missing, or be wrong."""
    VERIFIED = "verified"
    """The store held what the disk held."""


class UploadManifest(msgspec.Struct, frozen=True, kw_only=True):
    """The manifest of a log.

    Attributes:
        object: the log's name in the store.
        file: its name on the disk from which it came.
        sha256: of its bytes, hexadecimal.
        robot: by the file's name; ``fleet`` where it is of several.
        start_ns, end_ns: the first and the last log time; None if it holds no message, or is not whole.
        metadata: what its recorder wrote of it: robots, versions, variants.
        verified: how: ``read back``, or by the store's own ``checksum``; empty until it is.
        recorder_version: of the software that uploaded it.
        uploaded_ns: by that machine's clock.
    """

    format: str = FORMAT
    state: UploadState
    object: str
    file: str
    bytes: int
    sha256: str
    robot: str
    is_incident: bool
    messages: int | None
    start_ns: int | None
    end_ns: int | None
    metadata: dict[str, str]
    verified: str
    recorder_version: str
    uploaded_ns: int


def object_names(robot: str, file: str) -> Iterator[str]:
    """The names that a log may get in the store, the first one first."""
    # Whoever makes up a file's name must not lead out of the store's directory.
    folder = robot.lstrip(".") or "_"
    yield f"{folder}/{file}"
    stem, dot, suffix = file.rpartition(".")
    for number in range(2, NAMESAKES_MAX + 1):
        yield f"{folder}/{stem}-{number}{dot}{suffix}"


def read_manifest(data: bytes) -> UploadManifest | None:
    """A manifest; None if it is none of this format."""
    try:
        found = msgspec.json.decode(data, type=UploadManifest)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return None
    return found if found.format == FORMAT else None
