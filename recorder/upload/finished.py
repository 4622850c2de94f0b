"""Finished logs: read slowly, so that the recorder has the disk, and their manifest and row in a store.

The manifest is made before the log, and verified after it; the store makes it only where none is. So nobody
overwrites the log of somebody else, and nothing depends on lists, which may be of a while ago.
"""

from __future__ import annotations

import asyncio
import fcntl
import hashlib
import os
import time
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Awaitable, Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from enum import Enum
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from recorder.disk.log_names import SIGNATURE_SUFFIX
from recorder.mcap.reader import is_mcap
from recorder.record.signed_mode import SIGNATURE_MAX_BYTES, LogSignature
from schemas.command_line import module_command, other_kind, plain
from schemas.peers import RateLimit

ROW_S: Final = 600.0  # making a row is given up after this time

ROW_S_PER_BYTE: Final = 20e-6
"""...and this much for each byte of the log: 20 s a megabyte, on a robot that has other things to do."""

Summarize = Callable[[Path], Awaitable[bytes]]
"""Makes the row of a log; raises RowError, or OSError where the log is gone."""


class RowError(Exception):
    """The row of a log could not be made: in a line."""


def row_maker(module: str) -> Summarize:
    """Return what runs a module of this Python with a log's path, and takes the row from its standard output."""

    async def summarize(path: Path) -> bytes:
        size = path.stat().st_size  # noqa: ASYNC240 - nothing else runs here, and a log was just read there
        budget_s = ROW_S + ROW_S_PER_BYTE * size
        process = await asyncio.create_subprocess_exec(
            *module_command(module, str(path)), stdout=PIPE, stderr=PIPE
        )
        try:
            row, said = await asyncio.wait_for(process.communicate(), budget_s)
        except TimeoutError:
            raise RowError(f"given up after {budget_s:.0f} s") from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode or not row:
            last = plain(said.decode(errors="replace").strip().rpartition("\n")[2])
            raise RowError(last or f"its process ended with {process.returncode}")
        return row

    return summarize


FORMAT: Final = "cruiser.upload/1"

MANIFEST_SUFFIX: Final = ".json"  # follows the log's own name
ROW_SUFFIX: Final = ".row.json.zst"  # follows the log's own name: its row of the catalog
NAMESAKES_MAX: Final = 20  # different logs of one name that a store takes, each with a number


class UploadState(Enum):
    """The progress of an upload."""

    UPLOADING = "uploading"  # Begun. The log beside it may be missing, or be wrong.
    VERIFIED = "verified"  # the store held what the disk held


class UploadManifest(msgspec.Struct, frozen=True, kw_only=True):
    """The manifest of a log.

    Attributes:
        file: its name on the disk from which it came.
        sha256: of its bytes, hexadecimal.
        robot: by the file's name; ``fleet`` where it is of several.
        start_ns, end_ns: the first and the last log time; None if it holds no message, or is not whole.
        metadata: what its recorder wrote of it: robots, versions, variants.
        verified: how: ``read back``, or by the store's own ``checksum``; empty until it is.
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


READ_BYTES: Final = 65_536

DISK_BYTES_PER_S: Final = 8_000_000
"""Rate at which a log is read ahead, for its checksum: far below what a card or a disk can do."""

SAFELY: Final = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
"""A FIFO would be waited for, and a link leads to where this must not read."""

PART_BYTES: Final = 5 * 1024 * 1024  # larger logs go in parts of this length: the smallest that S3 takes


class UnfitLogError(Exception):
    """A file that is not uploaded: no log, or one that somebody is about to change. Says why."""


class LogDigest(msgspec.Struct, frozen=True):
    """The checksums of a file.

    Attributes:
        e_tags: what stores that speak S3 call it, without quotes: by all of it, or by the parts in which it came.
    """

    bytes: int
    modified_ns: int
    sha256: str
    e_tags: frozenset[str]


@contextmanager
def finished_log(path: Path) -> Generator[BinaryIO, None, None]:
    """Open a log that nobody writes. Nobody recovers it meanwhile either."""
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
    return hashlib.md5(data, usedforsecurity=False)


async def read_slowly(stream: BinaryIO, pace: RateLimit) -> AsyncIterator[bytes]:
    """All bytes of a file, in pieces, at this rate. What was read does not stay in the system's memory."""
    descriptor, at = stream.fileno(), 0
    while piece := os.pread(descriptor, READ_BYTES, at):
        with suppress(OSError):
            os.posix_fadvise(descriptor, at, len(piece), os.POSIX_FADV_DONTNEED)
        at += len(piece)
        yield piece
        await asyncio.sleep(pace.delay_s(len(piece), time.monotonic()))
