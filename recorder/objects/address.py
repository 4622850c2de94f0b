"""Addresses of objects: ``s3://BUCKET/PLACE`` and the like. Pure."""

from __future__ import annotations

import re
from typing import Final

import msgspec

from schemas.command_line import plain

SCHEMES: Final = ("s3://", "gs://", "az://", "file://", "https://", "http://")
"""The stores that can be read."""

UNLISTED: Final = ("https://", "http://")
"""Those that tell of one object at a time."""


class StoreAddress(msgspec.Struct, frozen=True):
    """An address of an object, or of a place that holds several."""

    url: str

    @property
    def scheme(self) -> str:
        """The kind of the store, ``s3://`` for example."""
        return next(one for one in SCHEMES if self.url.startswith(one))

    @property
    def has_list(self) -> bool:
        """True if its store says what a place holds."""
        return self.scheme not in UNLISTED

    @property
    def parent(self) -> StoreAddress:
        """The place that an object lies in."""
        return StoreAddress(self.url.rpartition("/")[0])

    @property
    def name(self) -> str:
        """The last part of it."""
        return self.url.rpartition("/")[2]

    def join(self, name: str) -> StoreAddress:
        """The address of an object of this place."""
        return StoreAddress(f"{self.url.rstrip('/')}/{name}")


_SECRET: Final = re.compile(r"(?<=://)[^/]*@|(?<=\?).+")
"""Name and password, and all behind the path, as of an address that somebody has signed."""


def shown_url(url: str) -> str:
    """Return an address for messages and notes: what may be a secret in it is masked."""
    return plain(_SECRET.sub(lambda found: "***@" if found[0].endswith("@") else "***", url))


def is_address(text: str) -> bool:
    """True of what names an object of a store, and no file."""
    return text.startswith(SCHEMES)
