"""A sample: bytes that are ready to be published under a subject."""

from __future__ import annotations

import msgspec


class Sample(msgspec.Struct, frozen=True, gc=False):
    """A payload to publish under a subject.

    Attributes:
        subject: the subject's name in the subject table.
        payload: MessagePack.
    """

    subject: str
    payload: bytes
