"""A store of logs that loses, hides, spoils and refuses what it is told to."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator, Awaitable, Callable

from recorder.objects.address import StoredObject, StoreError
from recorder.upload.uploader import LogStore


class FakeLogStore(LogStore):
    """A store in memory.

    Attributes:
        calls: what was asked of it, in order: the method and the object.
        cuts: so many writes lose their connection before their last piece.
        spoils: of so many writes it keeps something else.
        is_old: it answers as if nothing had been there before.
        meanwhile: called before each answer: a store that is slow.
    """

    def __init__(self) -> None:
        self.objects: dict[str, bytes] = {}
        self.calls: list[tuple[str, str]] = []
        self.is_gone = False
        self.refused: set[str] = set()
        self.cuts = 0
        self.spoils = 0
        self.is_old = False
        self.meanwhile: Callable[[str, str], Awaitable[None]] | None = None

    async def create(self, name: str, data: bytes) -> bool:
        await self._answer("create", name)
        return self.objects.setdefault(name, data) is data

    async def replace(self, name: str, data: bytes) -> None:
        await self._answer("replace", name)
        self.objects[name] = data

    async def read(self, name: str) -> bytes | None:
        await self._answer("read", name)
        return None if self.is_old else self.objects.get(name)

    async def write(self, name: str, pieces: AsyncIterator[bytes], size: int) -> None:
        await self._answer("write", name)
        data = b"".join([piece async for piece in pieces])
        assert len(data) == size
        if self.cuts:
            self.cuts -= 1
            raise StoreError("connection reset by peer")
        if self.spoils:
            self.spoils -= 1
            data = bytes([data[0] ^ 1]) + data[1:]
        self.objects[name] = data

    async def look(self, name: str) -> StoredObject | None:
        await self._answer("look", name)
        if self.is_old or name not in self.objects:
            return None
        data = self.objects[name]
        return StoredObject(len(data), hashlib.md5(data, usedforsecurity=False).hexdigest())

    async def read_back(self, name: str, size: int) -> AsyncIterator[bytes]:
        await self._answer("read_back", name)
        yield self.objects[name][:size]

    async def _answer(self, method: str, name: str) -> None:
        self.calls.append((method, name))
        if self.meanwhile is not None:
            await self.meanwhile(method, name)
        if self.is_gone or name in self.refused:
            raise StoreError("nobody answers")
