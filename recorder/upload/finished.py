"""A finished log on the disk: opened with care, and read slowly, so that the recorder has the disk."""

from __future__ import annotations

import asyncio
import fcntl
import hashlib
import os
import time
from collections.abc import AsyncIterator, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from recorder.mcap.reader import is_mcap
from recorder.reading.contents import read_contents
from recorder.record.robots import METADATA_NAME
from recorder.record.signature import SIGNATURE_MAX_BYTES, SIGNATURE_SUFFIX, LogSignature
from schemas.command_line import other_kind
from schemas.peers import RateLimit

READ_BYTES: Final = 65_536

DISK_BYTES_PER_S: Final = 8_000_000
"""Rate at which a log is read ahead, for its checksum: far below what a card or a disk can do."""

SAFELY: Final = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
"""A FIFO would be waited for, and a link leads to where this must not read."""

PART_BYTES: Final = 5 * 1024 * 1024
"""Larger logs go in parts of this length: the smallest that S3 takes."""


class UnfitLogError(Exception):
    """A file that is not uploaded: no log, or one that somebody is about to change. Says why."""


class LogDigest(msgspec.Struct, frozen=True):
    """The checksums of a file.

    Attributes:
        modified_ns: the time of its last change.
        e_tags: what stores that speak S3 call it, without quotes: by all of it, or by the parts in which it came.
    """

    bytes: int
    modified_ns: int
    sha256: str
    e_tags: frozenset[str]


class LogFacts(msgspec.Struct, frozen=True):
    """The facts that stand at a log's end; none, where it is not whole."""

    messages: int | None = None
    start_ns: int | None = None
    end_ns: int | None = None
    metadata: dict[str, str] = {}


@contextmanager
def finished_log(path: Path) -> Generator[BinaryIO, None, None]:
    """Open a log that nobody writes. Nobody recovers it meanwhile either.

    Raises:
        UnfitLogError: it is no log, or somebody has it in hand.
        OSError: it cannot be read.
    """
    if path.is_symlink():
        raise UnfitLogError("is a link")
    descriptor = os.open(path, SAFELY)
    if kind := other_kind(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise UnfitLogError(f"is {kind}")
    with os.fdopen(descriptor, "rb") as stream:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UnfitLogError("is being written or recovered") from None
        except OSError:
            pass  # This file system has no locks: what has its name is whole.
        if not is_mcap(stream):
            raise UnfitLogError("is no MCAP file")
        yield stream


def signature_of(path: Path, sha256: str) -> bytes:
    """The signature beside a log with these bytes; empty if there is none."""
    with suppress(OSError):
        descriptor = os.open(f"{path}{SIGNATURE_SUFFIX}", SAFELY)
        with os.fdopen(descriptor, "rb") as stream:
            data = stream.read(SIGNATURE_MAX_BYTES) or b""
        found = LogSignature.read(data)
        if found is not None and found.sha256 == sha256:
            return data
    return b""


async def digest(stream: BinaryIO) -> LogDigest:
    """The checksums of an open file.

    Raises:
        OSError: it cannot be read.
    """
    status = os.fstat(stream.fileno())
    whole, whole_md5, part, in_part = hashlib.sha256(), _md5(), _md5(), 0
    parts: list[bytes] = []
    async for piece in read_slowly(stream, RateLimit(DISK_BYTES_PER_S)):
        for each in (whole, whole_md5, part):
            each.update(piece)
        in_part += len(piece)
        # A part is a whole number of pieces.
        if in_part == PART_BYTES:
            parts.append(part.digest())
            part, in_part = _md5(), 0
    if in_part:
        parts.append(part.digest())
    by_parts = f"{_md5(b''.join(parts)).hexdigest()}-{len(parts)}"
    return LogDigest(
        status.st_size, status.st_mtime_ns, whole.hexdigest(), frozenset({by_parts, whole_md5.hexdigest()})
    )


def _md5(data: bytes = b"") -> hashlib._Hash:
    """S3 has no other for it."""
    return hashlib.md5(data, usedforsecurity=False)


async def read_slowly(stream: BinaryIO, pace: RateLimit) -> AsyncIterator[bytes]:
    """All bytes of a file, in pieces, at this rate. What was read does not stay in the system's memory.

    Raises:
        OSError: it cannot be read.
    """
    descriptor, at = stream.fileno(), 0
    while piece := os.pread(descriptor, READ_BYTES, at):
        with suppress(OSError):
            os.posix_fadvise(descriptor, at, len(piece), os.POSIX_FADV_DONTNEED)
        at += len(piece)
        yield piece
        await asyncio.sleep(pace.delay_s(len(piece), time.monotonic()))


def read_facts(stream: BinaryIO) -> LogFacts:
    """Read what stands at the end of an open log. Nothing in the file raises."""
    contents = read_contents(stream)
    if contents is None:
        return LogFacts()
    return LogFacts(
        sum(contents.counts.values()),
        contents.start_ns,
        contents.end_ns,
        dict(contents.metadata).get(METADATA_NAME, {}),
    )
