"""One gateway on a machine commands a bus: whoever comes second learns that there is another."""

from __future__ import annotations

import errno
import hashlib
import socket
from typing import Final, Self

from gateway.can.open_bus import describe
from schemas.settings import CanSettings

_PREFIX: Final = "\0cruiser-gateway/"
"""A name of this machine's kernel, of which each network namespace has its own, as it has of CAN interfaces. It is
free as soon as its process has ended, in whatever way."""


class BusClaim:
    """Says to other gateways on this machine that this one commands a bus. It keeps nobody off it.

    Attributes:
        is_shared: another one said so before.
    """

    def __init__(self, settings: CanSettings) -> None:
        self.is_shared = False
        digest = hashlib.sha256(describe(settings).encode()).hexdigest()[:32]
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.bind(f"{_PREFIX}{digest}")
        except OSError as error:
            self.is_shared = error.errno == errno.EADDRINUSE

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self._socket.close()
