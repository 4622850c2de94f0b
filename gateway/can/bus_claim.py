"""One gateway on a machine commands a bus: whoever comes second learns that there is another."""

from __future__ import annotations

import errno
import hashlib
import socket
from pathlib import Path
from typing import Final, Self

from gateway.can.open_bus import describe
from schemas.settings import CanSettings

_PREFIX: Final = "\0cruiser-gateway/"
"""A name of this machine's kernel, of which each network namespace has its own, as it has of CAN interfaces. It is
free as soon as its process has ended, in whatever way."""

SOCKETS: Final = Path("/proc/net/unix")
"""The kernel's list of names, of this network namespace."""

CLAIMS_MAX: Final = 8
"""Gateways on one bus that are counted."""


class BusClaim:
    """Says to other gateways on this machine that this one commands a bus. It keeps nobody off it.

    Attributes:
        is_shared: another one said so before.
    """

    def __init__(self, settings: CanSettings) -> None:
        self.is_shared = False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        # Those that come later have a name each, too: 'cruiser doctor' counts them.
        for name in _names(settings):
            try:
                self._socket.bind(name)
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    return
                self.is_shared = True
            else:
                return

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self._socket.close()


def count_claims(settings: CanSettings) -> int:
    """Count the gateways of this machine that command a bus."""
    try:
        taken = {line.rpartition(" ")[2].strip() for line in SOCKETS.read_text("ascii").splitlines()}
    except OSError:
        return 0
    return sum(name.replace("\0", "@") in taken for name in _names(settings))


def _names(settings: CanSettings) -> list[str]:
    digest = hashlib.sha256(describe(settings).encode()).hexdigest()[:32]
    return [f"{_PREFIX}{digest}", *(f"{_PREFIX}{digest}/{number}" for number in range(2, CLAIMS_MAX + 1))]
