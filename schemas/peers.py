"""Limits on the peers of a server: connections and rates. Pure.

A peer is an address, which clients behind one proxy or on one machine share. So each connection has limits too,
and one that is in use is not closed for another.
"""

from __future__ import annotations

import ipaddress
from collections import Counter
from typing import Final, Generic, TypeVar

BURST_S: Final = 0.1  # longest pause that a sender may catch up


class RateLimit:
    """A limit on a rate."""

    def __init__(self, per_s: float, burst_s: float = BURST_S) -> None:
        self.per_s = per_s
        self._burst_s = burst_s
        self._free_s = 0.0  # time from which more may be taken

    def delay_s(self, count: float, now_s: float) -> float:
        """Take this many. Returns the time to wait afterwards."""
        if not self.per_s:
            return 0.0
        self._free_s = max(self._free_s, now_s - self._burst_s) + count / self.per_s
        return max(0.0, self._free_s - now_s)


CONNECTIONS_MAX: Final = 256
PEER_CONNECTIONS_MAX: Final = 128  # open connections, of all peers and of one
FILES_SHARE: Final = 0.5  # share of the process's file descriptors for connections; the rest is for Zenoh and logs
CONNECTS_PER_S: Final = 100.0
PEER_CONNECTS_PER_S: Final = 50.0  # accepted connections, of all peers and of one
CONNECT_BURST_S: Final = 2.0  # longest pause that these rates may catch up
REQUEST_S: Final = 10.0  # time for a connection's next request, from its start or from the last answer
FRAME_BYTES: Final = 512  # cost of a WebSocket frame, and of a piece that is read, besides its content
SOCKET_BYTES_PER_S: Final = 65_536  # read from a WebSocket; a page that drives sends 50 messages of 0.4 kB
SOCKET_BURST_S: Final = 1.0
PORTION_BYTES: Final = 8 * FRAME_BYTES  # read from a connection before the next one's turn
PIECES_MAX: Final = 64  # frames of a WebSocket message; browsers send one

Connection = TypeVar("Connection")


def peer_of(host: str) -> str:
    """The peer of an address; an IPv6 network of 2**64 addresses is one peer."""
    address = ipaddress.ip_address(host.partition("%")[0])
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((address, 64), strict=False))


def most_connections(files: int) -> int:
    return max(1, min(CONNECTIONS_MAX, int(files * FILES_SHARE)))


class Peers(Generic[Connection]):
    """The connections of a server.

    At a limit, a new one replaces the oldest idle connection, of its own peer or of the peer with the most: idle
    connections cannot keep clients out.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._peer_most = min(PEER_CONNECTIONS_MAX, most)
        self._rate = RateLimit(CONNECTS_PER_S, CONNECT_BURST_S)
        self._rates: dict[str, RateLimit] = {}
        self._peers: dict[Connection, str] = {}
        self._counts: Counter[str] = Counter()
        self._silent: dict[Connection, None] = {}  # idle connections, the oldest first

    def __len__(self) -> int:
        return len(self._peers)

    def pause_s(self, now_s: float) -> float:
        """The time until the next connection may be accepted."""
        return self._rate.delay_s(0, now_s)

    def enter(self, connection: Connection, peer: str, now_s: float) -> list[Connection] | None:
        """Accept a connection. Returns the removed ones, which are to be closed; None if it is not accepted."""
        rate = self._rates.setdefault(peer, RateLimit(PEER_CONNECTS_PER_S, CONNECT_BURST_S))
        if rate.delay_s(0, now_s):
            return None
        rate.delay_s(1, now_s)
        self._rate.delay_s(1, now_s)
        gone = []
        if self._counts[peer] >= self._peer_most or len(self._peers) >= self._most:
            is_own = self._counts[peer] >= self._peer_most
            candidates = [one for one in self._silent if not is_own or self._peers[one] == peer]
            if not candidates:
                return None
            gone = [max(candidates, key=lambda one: self._counts[self._peers[one]])]
            self.leave(gone[0])
        self._peers[connection] = peer
        self._counts[peer] += 1
        self._silent[connection] = None
        self._forget()
        return gone

    def asks(self, connection: Connection) -> None:
        """Mark a connection as in use until its request is answered."""
        self._silent.pop(connection, None)

    def rests(self, connection: Connection) -> None:
        if connection in self._peers:
            self._silent[connection] = None

    def leave(self, connection: Connection) -> None:
        """Remove a connection; may be called again."""
        peer = self._peers.pop(connection, None)
        self._silent.pop(connection, None)
        if peer is not None:
            self._counts[peer] -= 1

    def _forget(self) -> None:
        """Forget peers without connections, since there are very many addresses."""
        if len(self._rates) > 2 * CONNECTIONS_MAX:
            self._counts = +self._counts
            self._rates = {peer: rate for peer, rate in self._rates.items() if peer in self._counts}


class SocketFrames:
    """Finds the frames of a WebSocket by their headers (RFC 6455, 5.2)."""

    def __init__(self) -> None:
        self._head = bytearray()
        self._left = 0
        self.pieces = 0

    def portion(self, data: bytes | bytearray) -> tuple[int, int]:
        """Return the length of a portion at the beginning of the data, and its cost."""
        place = cost = 0
        while place < len(data) and cost < PORTION_BYTES:
            if self._left:
                step = min(self._left, len(data) - place, PORTION_BYTES - cost)
                self._left -= step
                place += step
                cost += step
                continue
            self._head.append(data[place])
            place += 1
            if len(self._head) >= 2 and len(self._head) == self._head_bytes():
                cost += FRAME_BYTES
                self._begin()
        return place, max(cost, FRAME_BYTES)

    def _head_bytes(self) -> int:
        return 2 + self._length_bytes() + (4 if self._head[1] & 0x80 else 0)

    def _length_bytes(self) -> int:
        return {126: 2, 127: 8}.get(self._head[1] & 0x7F, 0)

    def _begin(self) -> None:
        extended = self._length_bytes()
        self._left = int.from_bytes(self._head[2 : 2 + extended]) if extended else self._head[1] & 0x7F
        is_control = bool(self._head[0] & 0x08)
        is_last = bool(self._head[0] & 0x80)
        if not is_control:
            self.pieces = 0 if is_last else self.pieces + 1
        self._head.clear()
