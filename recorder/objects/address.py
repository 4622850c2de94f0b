"""Addresses of objects (``s3://BUCKET/PLACE`` and the like), and the questions that a store answers. Pure.

Known without the library that does the asking.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, Protocol

import msgspec

from schemas.command_line import plain

SCHEMES: Final = ("s3://", "gs://", "az://", "file://", "https://", "http://")  # the stores that can be read
UNLISTED: Final = ("https://", "http://")  # those that tell of one object at a time


class StoreAddress(msgspec.Struct, frozen=True):
    """An address of an object, or of a place that holds several."""

    url: str

    @property
    def scheme(self) -> str:
        return next(one for one in SCHEMES if self.url.startswith(one))

    @property
    def has_list(self) -> bool:
        return self.scheme not in UNLISTED

    @property
    def parent(self) -> StoreAddress:
        return StoreAddress(self.url.rpartition("/")[0])

    @property
    def name(self) -> str:
        return self.url.rpartition("/")[2]

    def join(self, name: str) -> StoreAddress:
        return StoreAddress(f"{self.url.rstrip('/')}/{name}")


_SECRET: Final = re.compile(r"(?<=://)[^/]*@|(?<=\?).+")
"""Name and password, and all behind the path, as of an address that somebody has signed."""


def shown_url(url: str) -> str:
    """Return an address for messages and notes: what may be a secret in it is masked."""
    return plain(_SECRET.sub(lambda found: "***@" if found[0].endswith("@") else "***", url))


def is_address(text: str) -> bool:
    return text.startswith(SCHEMES)


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
