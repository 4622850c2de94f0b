"""Samples and liveliness tokens of robots, as they arrive."""

from __future__ import annotations

import msgspec


class Received(msgspec.Struct, frozen=True):
    """A sample, undecoded."""

    key: str
    encoding: str
    payload: bytes
    attachment: bytes = b""


class Missed(msgspec.Struct, frozen=True):
    """More samples came than can wait: some may be missing from those before this."""


class TokenChange(msgspec.Struct, frozen=True):
    """A gateway's liveliness token has appeared or gone."""

    key: str
    present: bool


Arrival = Received | Missed | TokenChange
