"""Finished logs: read slowly, to leave the disk to the recorder, and their manifest and row in a store.

The manifest is created before the log, only if there is none, and marked as verified after it. So no log
overwrites another, and nothing depends on the store's lists, which may be out of date.
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

ROW_S: Final = 600.0  # time limit for a row
ROW_S_PER_BYTE: Final = 20e-6  # added for each byte of the log: 20 s a megabyte, on a busy robot

Summarize = Callable[[Path], Awaitable[bytes]]
"""Makes the row of a log; raises RowError, or OSError if the log is gone."""


class RowError(Exception):
    """The row of a log could not be made; says why in one line."""


def row_maker(module: str) -> Summarize:
    """Return a function that runs a module in another process, and reads a log's row from its standard output."""

    async def summarize(path: Path) -> bytes:
        size = path.stat().st_size  # noqa: ASYNC240 - nothing else runs here, and a log was just read there
        budget_s = ROW_S + ROW_S_PER_BYTE * size
        process = await asyncio.create_subprocess_exec(
            *module_command(module, str(path)), stdout=PIPE, stderr=PIPE
        )
        try:
            row, errors = await asyncio.wait_for(process.communicate(), budget_s)
        except TimeoutError:
            raise RowError(f"given up after {budget_s:.0f} s") from None
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode or not row:
            last = plain(errors.decode(errors="replace").strip().rpartition("\n")[2])
            raise RowError(last or f"its process ended with {process.returncode}")
        return row

    return summarize


FORMAT: Final = "cruiser.upload/1"

MANIFEST_SUFFIX: Final = ".json"  # behind the log's name
ROW_SUFFIX: Final = ".row.json.zst"  # behind the log's name: its row of the catalog
NAMESAKES_MAX: Final = 20  # different logs of one name in a store, each with a number


class UploadState(Enum):
    """The progress of an upload."""

    UPLOADING = "uploading"  # begun; the log may be missing or incomplete
    VERIFIED = "verified"  # the store's bytes equalled the disk's


class UploadManifest(msgspec.Struct, frozen=True, kw_only=True):
    """The manifest of a log.

    Attributes:
        file: its name on the disk.
        sha256: of its bytes, hexadecimal.
        robot: by the file's name; ``fleet`` for several.
        start_ns, end_ns: the first and the last log time; None without messages, or if the log is not whole.
        metadata: of its recorder: robots, versions, variants.
        verified: by ``read back``, or the store's ``checksum``; empty before.
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
    # A robot's name must not lead out of the store's directory.
    folder = robot.lstrip(".") or "_"
    yield f"{folder}/{file}"
    stem, dot, suffix = file.rpartition(".")
    for number in range(2, NAMESAKES_MAX + 1):
        yield f"{folder}/{stem}-{number}{dot}{suffix}"


def read_manifest(data: bytes) -> UploadManifest | None:
    """Read a manifest; None if it has another format."""
    try:
        found = msgspec.json.decode(data, type=UploadManifest)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return None
    return found if found.format == FORMAT else None


READ_BYTES: Final = 65_536

DISK_BYTES_PER_S: Final = 8_000_000  # rate of reading for the checksum: far below what a card or a disk can do
SAFELY: Final = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC  # no wait for a FIFO, no links
PART_BYTES: Final = 5 * 1024 * 1024  # larger logs are sent in parts of this length: the smallest that S3 accepts


class UnfitLogError(Exception):
    """A file that cannot be uploaded: no log, or being changed. Says why."""


class LogDigest(msgspec.Struct, frozen=True):
    """The checksums of a file; ``e_tags`` are those of S3 without quotes, for one upload and for parts."""

    bytes: int
    modified_ns: int
    sha256: str
    e_tags: frozenset[str]


@contextmanager
def finished_log(path: Path) -> Generator[BinaryIO, None, None]:
    """Open a finished log, and lock it against recovery."""
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
            pass  # This file system has no locks: a log with this name is finished.
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
    """All bytes of a file, in pieces, at this rate. They do not stay in the system's page cache."""
    descriptor, at = stream.fileno(), 0
    while piece := os.pread(descriptor, READ_BYTES, at):
        with suppress(OSError):
            os.posix_fadvise(descriptor, at, len(piece), os.POSIX_FADV_DONTNEED)
        at += len(piece)
        yield piece
        await asyncio.sleep(pace.delay_s(len(piece), time.monotonic()))
