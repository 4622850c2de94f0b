"""Addresses of objects (``s3://BUCKET/PLACE`` and the like), and the interface of a store. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, Protocol

import msgspec

from schemas.command_line import plain

SCHEMES: Final = ("s3://", "gs://", "az://", "file://", "https://", "http://")  # the stores that can be read
UNLISTED: Final = ("https://", "http://")  # those without lists of objects


class StoreAddress(msgspec.Struct, frozen=True):
    """The address of an object, or of a place with several."""

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


_SECRET: Final = re.compile(r"(?<=://)[^/]*@|(?<=\?).+")  # name and password, and the query of a signed address


def shown_url(url: str) -> str:
    """Return an address for messages and notes, with possible secrets masked."""
    return plain(_SECRET.sub(lambda found: "***@" if found[0].endswith("@") else "***", url))


def is_address(text: str) -> bool:
    return text.startswith(SCHEMES)


class StoreError(Exception):
    """The store failed or refused, perhaps temporarily; says why in one line."""


class StoredObject(msgspec.Struct, frozen=True):
    """An object of a store; ``e_tag`` is without quotes, empty if it has none."""

    bytes: int
    e_tag: str


class ListedObject(msgspec.Struct, frozen=True):
    """An object of a list, which may be out of date; ``name`` is relative to the place."""

    name: str
    bytes: int


class Objects(Protocol):
    """The objects of a place. Each method raises StoreError if the store does not respond, or refuses."""

    def look(self, name: str) -> StoredObject | None:
        """Return length and e_tag of an object; None if there is none."""

    def read(self, name: str, start: int, end: int, e_tag: str) -> bytes:
        """Return a range of an object that still has this e_tag; an empty one matches any."""

    def names(self) -> Iterator[ListedObject]:
        """Return all objects of the place, at any depth."""
