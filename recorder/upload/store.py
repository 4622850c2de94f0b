"""The questions to an object store, and any store that obstore knows: S3, GCS, Azure, a directory."""

from __future__ import annotations

from collections.abc import AsyncIterator, Generator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from typing import Any, Final, Protocol

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError
from obstore.store import LocalStore, ObjectStore

from recorder.objects.interface import StoredObject, StoreError
from recorder.objects.store import line_of, open_store
from recorder.upload.finished import PART_BYTES
from schemas.command_line import plain

READ_BACK_BYTES: Final = 1024 * 1024
"""A log is read back in ranges of this length, each at once: of a link that breaks no more is asked again."""

SMALL_MAX_BYTES: Final = 4 * 1024 * 1024
"""A manifest is no larger: whatever else a store answers would fill the robot's memory."""

PART_S: Final = timedelta(minutes=5)
"""A request may take so long: a part over a link of 18 kB/s."""

REQUEST_S: Final = timedelta(minutes=3)
"""A link may be away for so long, and a part that was begun goes on."""


class LogStore(Protocol):
    """A store of logs. Each method raises StoreError where it is not answered, or refused."""

    async def create(self, name: str, data: bytes) -> bool:
        """Put a small object where none is. False if there is one."""

    async def replace(self, name: str, data: bytes) -> None:
        """Put a small object in the place of what is there."""

    async def read(self, name: str) -> bytes | None:
        """A small object; None if there is none."""

    async def write(self, name: str, pieces: AsyncIterator[bytes], size: int) -> None:
        """Put a log there. It appears when all of it has come, and not before."""

    async def look(self, name: str) -> StoredObject | None:
        """Return length and mark of what is there; None if nothing is."""

    def read_back(self, name: str, size: int) -> AsyncIterator[bytes]:
        """The bytes of a log, of which there should be so many."""


class ObstoreLogs:
    """The store at a URL.

    Args:
        url: as obstore has them: s3://BUCKET/PLACE, gs://, az://, file:///DIRECTORY.
        options: of this store, by obstore's names; credentials come from the environment.

    Raises:
        CommandError: no store is called so, or an option is none of it.
    """

    def __init__(self, url: str, options: Mapping[str, Any]) -> None:
        self._store: ObjectStore = open_store(
            url, options, {"timeout": PART_S}, {"retry_timeout": REQUEST_S}, may_make=True
        )

    async def create(self, name: str, data: bytes) -> bool:
        """Put a small object where none is. False if there is one."""
        with _store_errors():
            try:
                await obstore.put_async(self._store, name, data, mode="create")
            except (AlreadyExistsError, PreconditionError, FileExistsError):
                return False
            except BaseError:
                # A disk without hard links, as FAT has none, cannot see to it that there is none yet.
                if not isinstance(self._store, LocalStore):
                    raise
                if await self.look(name) is not None:
                    return False
                await self.replace(name, data)
        return True

    async def replace(self, name: str, data: bytes) -> None:
        """Put a small object in the place of what is there."""
        with _store_errors():
            await obstore.put_async(self._store, name, data)

    async def read(self, name: str) -> bytes | None:
        """A small object; None if there is none."""
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
        """Put a log there. It appears when all of it has come, and not before."""
        with _store_errors():
            if size <= PART_BYTES:
                whole = b"".join([piece async for piece in pieces])
                await obstore.put_async(self._store, name, whole, use_multipart=False)
            else:
                await obstore.put_async(self._store, name, pieces, chunk_size=PART_BYTES, max_concurrency=1)

    async def look(self, name: str) -> StoredObject | None:
        """Return length and mark of what is there; None if nothing is."""
        with _store_errors():
            try:
                found = await obstore.head_async(self._store, name)
            except FileNotFoundError:
                return None
        return StoredObject(found["size"], (found["e_tag"] or "").strip('"'))

    async def read_back(self, name: str, size: int) -> AsyncIterator[bytes]:
        """The bytes of a log, of which there should be so many."""
        for start in range(0, size, READ_BACK_BYTES):
            end = min(start + READ_BACK_BYTES, size)
            with _store_errors():
                found = await obstore.get_async(self._store, name, options={"range": (start, end)})
                # A byte more than was asked for is enough to see that an answer goes on and on.
                piece = bytes(await anext(aiter(found.stream(end - start + 1)), b""))
            yield piece


@contextmanager
def _store_errors() -> Generator[None, None, None]:
    """Raise one StoreError for whatever the library reports."""
    try:
        yield
    except (BaseError, OSError) as error:
        raise StoreError(line_of(error)) from error
