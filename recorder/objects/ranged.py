"""An object of a store as a binary stream that can be sought in: by ranges, through a small cache of blocks.

Whoever reads a file can so read an object. What follows what was read last is asked for in ever longer ranges; who
knows what it will need asks for it at once (``fetch``).
"""

from __future__ import annotations

import errno
import io
from collections import OrderedDict
from typing import BinaryIO, Final, cast

from recorder.objects.interface import Objects, StoreError

BLOCK_BYTES: Final = 65_536
"""The unit of the cache. Larger ones fetch more that nobody wants, smaller ones take more requests."""

FETCH_MAX: Final = 4 * 1024 * 1024
"""The longest range of one request."""

CACHE_BYTES: Final = 32 * 1024 * 1024
"""Blocks of an object that are kept; what was used longest ago goes first."""


class RangeError(OSError):
    """A range cannot be had; ``strerror`` says why in a line."""


class RangedObject:
    """An object, and the blocks of it that have been read.

    Args:
        objects: of the store.
        name: the object's.
        size: its length in bytes.
        e_tag: the mark of the content that is read: another is a fault. Empty where the store has none.

    Attributes:
        requests: those for ranges; ``fetched``, the bytes that they brought.
    """

    def __init__(self, objects: Objects, name: str, size: int, e_tag: str) -> None:
        self.size = size
        self.requests = 0
        self.fetched = 0
        self._objects = objects
        self._name = name
        self._e_tag = e_tag
        self._blocks: OrderedDict[int, bytes] = OrderedDict()
        self._next = -1
        """The block behind those that were fetched last."""
        self._ahead = 1
        """Blocks to fetch at once where what is read goes on."""

    def open(self) -> BinaryIO:
        """Return a stream of it; several share its blocks."""
        return cast("BinaryIO", _RangedStream(self))

    def fetch(self, start: int, end: int) -> None:
        """Have the bytes of a place ready, as far as the cache holds them.

        Raises:
            RangeError: they cannot be had.
        """
        end = min(end, start + CACHE_BYTES // 2, self.size)
        if start < end:
            self._have(start // BLOCK_BYTES, (end - 1) // BLOCK_BYTES + 1)

    def read(self, start: int, length: int) -> bytes:
        """Return bytes of a place, fewer at the end.

        Raises:
            RangeError: they cannot be had.
        """
        end = min(start + length, self.size)
        parts = []
        while start < end:
            first = start // BLOCK_BYTES
            last = min((end - 1) // BLOCK_BYTES + 1, first + FETCH_MAX // BLOCK_BYTES)
            self._have(first, last)
            for number in range(first, last):
                block = self._blocks[number]
                self._blocks.move_to_end(number)
                at = start - number * BLOCK_BYTES
                part = block[at : at + end - start]
                parts.append(part)
                start += len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def _have(self, first: int, last: int) -> None:
        """Fetch the blocks from one to another that are not there, each stretch of them by as few requests."""
        number = first
        while number < last:
            if number in self._blocks:
                number += 1
                continue
            behind = number
            while behind < last and behind not in self._blocks:
                behind += 1
            self._request(number, behind)
            number = behind

    def _request(self, first: int, last: int) -> None:
        most = FETCH_MAX // BLOCK_BYTES
        if first == self._next:
            self._ahead = min(2 * self._ahead, most)
            # Not over what is there already.
            end = first
            while end < max(last, first + self._ahead) and end not in self._blocks:
                end += 1
            last = end
        else:
            self._ahead = 1
        for start in range(first, last, most):
            self._take(start, min(start + most, last))
        self._next = last

    def _take(self, first: int, last: int) -> None:
        start, end = first * BLOCK_BYTES, min(last * BLOCK_BYTES, self.size)
        if start >= end:
            return
        self.requests += 1
        try:
            data = self._objects.read(self._name, start, end, self._e_tag)
        except StoreError as error:
            raise RangeError(errno.EIO, str(error)) from error
        self.fetched += len(data)
        for number in range(first, last):
            at = (number - first) * BLOCK_BYTES
            if at < len(data):
                self._blocks[number] = data[at : at + BLOCK_BYTES]
        while len(self._blocks) * BLOCK_BYTES > CACHE_BYTES:
            self._blocks.popitem(last=False)


class _RangedStream(io.RawIOBase):
    def __init__(self, ranged: RangedObject) -> None:
        super().__init__()
        self._ranged = ranged
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._ranged.size}[whence]
        self._at = max(0, base + offset)
        return self._at

    def read(self, size: int | None = -1, /) -> bytes:
        length = self._ranged.size - self._at if size is None or size < 0 else size
        data = self._ranged.read(self._at, max(0, length))
        self._at += len(data)
        return data

    def readall(self) -> bytes:
        return self.read()
