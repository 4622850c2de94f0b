"""Objects of a store in memory, which counts what it is asked for, and fails as it is told to."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import lru_cache

from recorder.objects.address import ListedObject, StoredObject, StoreError


class FakeObjects:
    """A store that answers by ranges.

    Attributes:
        ranges: name, begin and end of each range that was requested, in order.
        fetched: bytes sent.
        breaks_after: the connection is lost after so many ranges.
        old_names: a list to answer instead of the current one.
    """

    def __init__(self, **objects: bytes) -> None:
        self.objects: dict[str, bytes] = dict(objects)
        self.ranges: list[tuple[str, int, int]] = []
        self.fetched = 0
        self.is_gone = False
        self.breaks_after: int | None = None
        self.old_names: list[ListedObject] | None = None

    def look(self, name: str) -> StoredObject | None:
        self._answer()
        data = self.objects.get(name)
        return None if data is None else StoredObject(len(data), mark_of(data))

    def read(self, name: str, start: int, end: int, e_tag: str) -> bytes:
        self.ranges.append((name, start, end))
        self._answer()
        if self.breaks_after is not None:
            self.breaks_after -= 1
            if self.breaks_after < 0:
                raise StoreError("connection reset by peer")
        data = self.objects.get(name)
        if data is None or (e_tag and mark_of(data) != e_tag):
            raise StoreError("it was changed or removed while it was read: try again")
        self.fetched += end - start
        return data[start:end]

    def names(self) -> Iterator[ListedObject]:
        self._answer()
        if self.old_names is not None:
            yield from self.old_names
            return
        yield from [ListedObject(name, len(data)) for name, data in sorted(self.objects.items())]

    def _answer(self) -> None:
        if self.is_gone:
            raise StoreError("no answer: check the store's endpoint and the network")


@lru_cache(64)
def mark_of(data: bytes) -> str:
    return hashlib.md5(data, usedforsecurity=False).hexdigest()
