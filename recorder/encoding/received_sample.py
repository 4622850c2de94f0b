"""A Zenoh sample as it was received: untrusted."""

from __future__ import annotations

from typing import Protocol

import msgspec


class ReceivedSample(Protocol):
    """One sample, or one reply to a query. Key, encoding and payload are at hand, the rest may cost something."""

    @property
    def key(self) -> str:
        """The key."""
        ...

    @property
    def encoding(self) -> str:
        """Zenoh's encoding string, schema included."""
        ...

    @property
    def payload(self) -> bytes:
        """The payload."""
        ...

    @property
    def received_ns(self) -> int:
        """The time of receipt, nanoseconds since 1970."""
        ...

    @property
    def is_reply(self) -> bool:
        """It is a reply to a query of ours, and did not come by itself."""
        ...

    @property
    def attachment(self) -> bytes:
        """The attachment; empty if there is none."""
        ...

    @property
    def zenoh_time_ns(self) -> int:
        """The sample's own Zenoh timestamp since 1970; 0 if it has none."""
        ...

    @property
    def source(self) -> tuple[str, int] | None:
        """The publisher's identifier and its sequence number on the key; None if the sample has none."""
        ...

    @property
    def deleted(self) -> bool:
        """The sample says that the key was deleted, and carries nothing else."""
        ...


class WaitingSample(msgspec.Struct, frozen=True, gc=False):
    """A copy of a sample, to wait for long: one that Zenoh gave holds its whole receive buffer of 64 KiB."""

    key: str
    encoding: str
    payload: bytes
    attachment: bytes
    zenoh_time_ns: int
    source: tuple[str, int] | None
    deleted: bool
    received_ns: int
    is_reply: bool


def copy(sample: ReceivedSample) -> WaitingSample:
    """All of a sample, by value."""
    return WaitingSample(
        sample.key,
        sample.encoding,
        sample.payload,
        sample.attachment,
        sample.zenoh_time_ns,
        sample.source,
        sample.deleted,
        sample.received_ns,
        sample.is_reply,
    )
