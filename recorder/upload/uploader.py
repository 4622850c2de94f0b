"""Upload of finished logs to a store (S3, GCS, Azure, a directory) by obstore, one by one, incidents first.

For each log: create the manifest, upload and verify the log, add its recorder's signature, mark the manifest as
verified, and add a line to the note beside the logs. After an interruption the log is done again from its
beginning: a store shows an object whole or not at all.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import os
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Generator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any, BinaryIO, Final

import msgspec
import obstore
from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError
from obstore.store import LocalStore, ObjectStore

from recorder.disk.files import UploadedLog, UploadNote
from recorder.disk.keeper import read_entries
from recorder.disk.log_names import SIGNATURE_SUFFIX, SUFFIX
from recorder.objects.address import StoredObject, StoreError
from recorder.objects.store import line_of, open_store
from recorder.reading.rows import read_contents
from recorder.record.retention import LogEntry
from recorder.record.robots import METADATA_NAME
from recorder.upload.finished import (
    MANIFEST_SUFFIX,
    PART_BYTES,
    ROW_SUFFIX,
    LogDigest,
    RowError,
    Summarize,
    UnfitLogError,
    UploadManifest,
    UploadState,
    digest,
    finished_log,
    object_names,
    read_manifest,
    read_slowly,
    signature_of,
)
from schemas.command_line import plain
from schemas.peers import RateLimit

READ_BACK_BYTES: Final = 1024 * 1024  # length of a range that is read back at once
SMALL_MAX_BYTES: Final = 4 * 1024 * 1024  # limit of a manifest, to protect the robot's memory
PART_S: Final = timedelta(minutes=5)  # time limit of a request: a part over a link of 18 kB/s
REQUEST_S: Final = timedelta(minutes=3)  # longest outage of a link after which a part continues


class LogStore:
    """The store at a URL of obstore. Methods raise StoreError if it does not respond, or refuses."""

    def __init__(self, url: str, options: Mapping[str, Any]) -> None:
        self._store: ObjectStore = open_store(
            url, options, {"timeout": PART_S}, {"retry_timeout": REQUEST_S}, may_make=True
        )

    async def create(self, name: str, data: bytes) -> bool:
        with _store_errors():
            try:
                await obstore.put_async(self._store, name, data, mode="create")
            except (AlreadyExistsError, PreconditionError, FileExistsError):
                return False
            except BaseError:
                # A disk without hard links, such as FAT, cannot create a file atomically.
                if not isinstance(self._store, LocalStore):
                    raise
                if await self.look(name) is not None:
                    return False
                await self.replace(name, data)
        return True

    async def replace(self, name: str, data: bytes) -> None:
        with _store_errors():
            await obstore.put_async(self._store, name, data)

    async def read(self, name: str) -> bytes | None:
        with _store_errors():
            try:
                found = await obstore.get_async(self._store, name)
            except FileNotFoundError:
                return None
            data = b""
            async for piece in found.stream(SMALL_MAX_BYTES):
                data += piece
                if len(data) > SMALL_MAX_BYTES:
                    raise StoreError(f"{plain(name)} is larger than {SMALL_MAX_BYTES} bytes")
        return data

    async def write(self, name: str, pieces: AsyncIterator[bytes], size: int) -> None:
        """Write a log, which appears when it is complete."""
        with _store_errors():
            if size <= PART_BYTES:
                whole = b"".join([piece async for piece in pieces])
                await obstore.put_async(self._store, name, whole, use_multipart=False)
            else:
                await obstore.put_async(self._store, name, pieces, chunk_size=PART_BYTES, max_concurrency=1)

    async def look(self, name: str) -> StoredObject | None:
        with _store_errors():
            try:
                found = await obstore.head_async(self._store, name)
            except FileNotFoundError:
                return None
        return StoredObject(found["size"], (found["e_tag"] or "").strip('"'))

    async def read_back(self, name: str, size: int) -> AsyncIterator[bytes]:
        """The bytes of a log of this size."""
        for start in range(0, size, READ_BACK_BYTES):
            end = min(start + READ_BACK_BYTES, size)
            with _store_errors():
                found = await obstore.get_async(self._store, name, options={"range": (start, end)})
                # One byte more shows an answer that is too long.
                piece = bytes(await anext(aiter(found.stream(end - start + 1)), b""))
            yield piece


@contextmanager
def _store_errors() -> Generator[None, None, None]:
    """Turn the library's errors into a StoreError."""
    try:
        yield
    except (BaseError, OSError) as error:
        raise StoreError(line_of(error)) from error


log = logging.getLogger(__name__)

TRIES: Final = 2  # uploads of a log that fails verification, before it has to wait
RETRY_S: Final = 600.0  # pause before a log that cannot be uploaded is tried again; others go first
STORE_RETRY_S: Final = 60.0  # the pause after an error of the store
AWAY_AFTER: Final = 2  # errors of the store in a row from which it counts as unreachable

READ_BACK: Final = "read back"
CHECKSUM: Final = "checksum"


class UploadPlan(msgspec.Struct, frozen=True):
    """The settings of an upload.

    Attributes:
        only_incidents: upload no other logs.
        reads_back: verify a log by reading it back; else by the store's checksum, if it has one.
    """

    directory: Path
    url: str
    only_incidents: bool
    reads_back: bool
    version: str


class UploadTotals(msgspec.Struct):
    """The result of an upload.

    Attributes:
        uploaded: logs uploaded and verified; ``bytes`` is their total size.
        rows: logs with a row of the catalog.
        faults: a line for each waiting log that failed.
    """

    uploaded: int = 0
    bytes: int = 0
    rows: int = 0
    waiting: list[str] = []
    faults: dict[str, str] = {}


class Uploader:
    """Uploads finished logs; ``pace`` limits the rate of sending and of reading back."""

    def __init__(
        self,
        plan: UploadPlan,
        store: LogStore,
        note: UploadNote,
        pace: RateLimit,
        summarize: Summarize | None = None,
    ) -> None:
        self._plan = plan
        self._store = store
        self._note = note
        self._pace = pace
        self._retry_s: dict[str, float] = {}  # logs that could not be uploaded, and when to try again
        self._failures = 0  # errors of the store in a row
        self._summarize = summarize
        self._rowless: deque[tuple[str, str]] = deque()  # uploaded logs without a row: file and object
        self.totals = UploadTotals()

    async def upload_all(self, may_go_on: Callable[[], bool]) -> bool:
        """Upload all finished logs; look for incidents before each. Returns True if the store is reachable."""
        self._failures = 0
        self._note.forget({entry.name for entry in read_entries(self._plan.directory)})
        while True:
            entries = self.waiting()
            self.totals.waiting = [entry.name for entry in entries]
            # Forget the faults of logs deleted or uploaded since.
            faults = self.totals.faults
            self.totals.faults = {name: faults[name] for name in self.totals.waiting if name in faults}
            now_s = time.monotonic()
            due = [entry for entry in entries if self._retry_s.get(entry.name, now_s) <= now_s]
            is_away = self._failures == AWAY_AFTER
            if is_away or not may_go_on() or not (due or self._rowless):
                return not is_away
            if due:
                await self._upload_one(due[0])
            elif self._summarize is not None:
                # After all logs: a row can also be made from the log in the store.
                await self._add_row(self._summarize, *self._rowless.popleft())

    def waiting(self) -> list[LogEntry]:
        """Return the finished logs not yet uploaded: incidents first, then by age."""
        entries = [
            entry
            for entry in read_entries(self._plan.directory, safe=self._note.safe())
            if entry.name.endswith(SUFFIX)
            and not entry.is_safe
            and (entry.is_incident or not self._plan.only_incidents)
        ]
        return sorted(entries, key=lambda one: (not one.is_incident, one.started, one.number, one.name))

    async def _upload_one(self, entry: LogEntry) -> None:
        try:
            with finished_log(self._plan.directory / entry.name) as stream:
                found = await digest(stream)
                name, how = await self._send(entry, stream, found)
        except FileNotFoundError:
            return  # Retention was faster.
        except StoreError as error:
            self._failures += 1
            self._put_off(entry.name, str(error), STORE_RETRY_S)
            return
        except (UnfitLogError, _WrongLogError, OSError) as error:
            self._put_off(entry.name, (isinstance(error, OSError) and error.strerror) or str(error), RETRY_S)
            return
        self._failures = 0
        self._note.add(UploadedLog(entry.name, found.bytes, found.modified_ns, found.sha256, self._plan.url, name))
        log.info("%s uploaded as %s, %d bytes, verified: %s", plain(entry.name), plain(name), found.bytes, how)
        if self._summarize is not None:
            self._rowless.append((entry.name, name))
        self._retry_s.pop(entry.name, None)
        self.totals.uploaded += 1
        self.totals.bytes += found.bytes

    async def _add_row(self, summarize: Summarize, file: str, name: str) -> None:
        """Put the row of a log beside it. A missing row is no fault: the catalog can make it."""
        try:
            await self._store.replace(name + ROW_SUFFIX, await summarize(self._plan.directory / file))
        except FileNotFoundError:
            return  # Retention was faster.
        except (RowError, StoreError, OSError) as error:
            self._failures += isinstance(error, StoreError)
            log.warning("%s has no row in the catalog: %s", plain(name), error)
        else:
            self._failures = 0
            self.totals.rows += 1

    def _put_off(self, name: str, fault: str, pause_s: float) -> None:
        is_new = self.totals.faults.get(name) != fault
        log.log(logging.WARNING if is_new else logging.DEBUG, "%s is not uploaded: %s", plain(name), fault)
        self._retry_s[name] = time.monotonic() + pause_s
        self.totals.faults[name] = fault

    async def _send(self, entry: LogEntry, stream: BinaryIO, found: LogDigest) -> tuple[str, str]:
        """Upload and verify a log. Returns its name in the store, and how it was verified."""
        for name in object_names(entry.robot, entry.name):
            claim = self._manifest(name, entry, stream, found)
            is_new = await self._store.create(name + MANIFEST_SUFFIX, msgspec.json.encode(claim))
            before = claim if is_new else await self._manifest_of(name)
            if before is None or (before.sha256, before.bytes) != (found.sha256, found.bytes):
                continue  # The name is another log's.
            # An existing log need not be sent again. But its manifest is unsigned, and retention deletes uploaded
            # logs: so the log itself is compared with the disk.
            how = "" if is_new else await self._verify(name, found)
            if not how:
                how = await self._write(name, stream, found)
            if signature := signature_of(self._plan.directory / entry.name, found.sha256):
                await self._store.replace(name + SIGNATURE_SUFFIX, signature)
            if not before.verified:
                done = msgspec.structs.replace(claim, state=UploadState.VERIFIED, verified=how)
                await self._store.replace(name + MANIFEST_SUFFIX, msgspec.json.encode(done))
            return name, how
        raise _WrongLogError("the store has too many other logs of that name")

    def _manifest(self, name: str, entry: LogEntry, stream: BinaryIO, found: LogDigest) -> UploadManifest:
        found_in = read_contents(stream)
        return UploadManifest(
            state=UploadState.UPLOADING,
            object=name,
            file=entry.name,
            bytes=found.bytes,
            sha256=found.sha256,
            robot=entry.robot,
            is_incident=entry.is_incident,
            messages=None if found_in is None else found_in.counts.total(),
            start_ns=None if found_in is None else found_in.start_ns,
            end_ns=None if found_in is None else found_in.end_ns,
            metadata={} if found_in is None else dict(found_in.metadata).get(METADATA_NAME, {}),
            verified="",
            recorder_version=self._plan.version,
            uploaded_ns=time.time_ns(),
        )

    async def _manifest_of(self, name: str) -> UploadManifest | None:
        """Read an existing manifest; StoreError if the store does not show it yet."""
        data = await self._store.read(name + MANIFEST_SUFFIX)
        if data is None:
            raise StoreError(f"the manifest of {plain(name)} cannot be read yet")
        return read_manifest(data)

    async def _write(self, name: str, stream: BinaryIO, found: LogDigest) -> str:
        for _ in range(TRIES):
            await self._store.write(name, self._unchanged(stream, found), found.bytes)
            if how := await self._verify(name, found):
                return how
            log.warning("the store's copy of %s differs", plain(name))
        raise _WrongLogError("the store's copy differs")

    async def _unchanged(self, stream: BinaryIO, found: LogDigest) -> AsyncIterator[bytes]:
        """The bytes of a log; the last piece only if the whole has the expected checksum."""
        whole, last = hashlib.sha256(), b""
        async for piece in read_slowly(stream, self._pace):
            whole.update(piece)
            if last:
                yield last
            last = piece
        if whole.hexdigest() != found.sha256 or os.fstat(stream.fileno()).st_mtime_ns != found.modified_ns:
            raise _WrongLogError("was changed while it was read")
        yield last

    async def _verify(self, name: str, found: LogDigest) -> str:
        """Compare the store's log with the disk's. Returns the method; empty if they differ."""
        held = await self._store.look(name)
        if held is None or held.bytes != found.bytes:
            return ""
        if not self._plan.reads_back and held.e_tag in found.e_tags:
            return CHECKSUM
        whole, size = hashlib.sha256(), 0
        async for piece in self._store.read_back(name, found.bytes):
            whole.update(piece)
            size += len(piece)
            await asyncio.sleep(self._pace.delay_s(len(piece), time.monotonic()))
        return READ_BACK if (size, whole.hexdigest()) == (found.bytes, found.sha256) else ""


class _WrongLogError(Exception):
    """A log that cannot be uploaded now, while others can. Says why."""
