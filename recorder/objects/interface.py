"""The questions that are asked of a store of objects; known without the library that does the asking. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import msgspec


class StoreError(Exception):
    """The store did not do what was asked: in a line. It may do it later."""


class StoredObject(msgspec.Struct, frozen=True):
    """An object, as the store has it.

    Attributes:
        e_tag: the store's own mark of its content, without quotes; empty if it has none.
    """

    bytes: int
    e_tag: str


class ListedObject(msgspec.Struct, frozen=True):
    """An object of a list, which a store may answer as of a while ago; ``name`` is that within the place."""

    name: str
    bytes: int


class Objects(Protocol):
    """The objects of a place. Each method raises StoreError where it is not answered, or refused."""

    def look(self, name: str) -> StoredObject | None:
        """Return length and mark of an object; None if there is none."""

    def read(self, name: str, start: int, end: int, e_tag: str) -> bytes:
        """Return a range of an object that still has this mark; any, where the mark is empty."""

    def names(self) -> Iterator[ListedObject]:
        """Return all objects of the place, and of those within it."""
