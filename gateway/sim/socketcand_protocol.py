"""The server's side of the socketcand text protocol: bytes in to events, frames to bytes. No I/O.

The protocol is that of github.com/linux-can/socketcand, in raw mode::

    server  < hi >                              on connecting
    client  < open can0 >                       server  < ok >
    client  < rawmode >                         server  < ok >
    client  < send 18C4D1D0 8 1 4 0 0 0 0 0 5 >
    server  < frame 18C4D1EF 1700000000.000123 0104000000000005 >
    client  < echo >                            server  < echo >

An identifier of 3 digits is standard, one of 8 extended. Outside the protocol, and in any state, a client may
cause a fault of the virtual chassis by ``< fault bumper front on >``; the answer is ``< ok >`` or
``< error reason >``.
"""

from __future__ import annotations

import re
from enum import Enum
from typing import Final

import msgspec

from gateway.chassis.frame import ERROR, EXTENDED, IDENTIFIER_MASK, REMOTE, STANDARD_MASK, Frame, hex_identifier

HI: Final = b"< hi >"
OK: Final = b"< ok >"
ECHO: Final = b"< echo >"

MAX_MESSAGE_BYTES: Final = 512
"""A message without its end after this many bytes is given up."""

_MAX_ERROR_CHARACTERS: Final = 300
_MAX_SHOWN_BYTES: Final = 60
"""The part of a wrong message that an error repeats."""


class ServerReply(msgspec.Struct, frozen=True):
    """Bytes that this client is to get."""

    data: bytes


class RawModeEntered(msgspec.Struct, frozen=True):
    """From here on the client gets the frames of the bus."""


class Sent(msgspec.Struct, frozen=True):
    """The client put a frame on the bus; its time is not known yet."""

    frame: Frame


class FaultAsked(msgspec.Struct, frozen=True):
    """The client asks for a fault, and waits for OK or an error."""

    text: str


Event = ServerReply | RawModeEntered | Sent | FaultAsked


class _State(Enum):
    CONNECTED = "open a bus first: < open can0 >"
    OPENED = "choose a mode first: < rawmode >"
    RAW = "the bus is open and in raw mode"


_SEND: Final = re.compile(rb"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) ([0-9A-Fa-f]{1,2})((?: [0-9A-Fa-f]{1,2}){0,8})")


class ServerConnection:
    """One client's conversation. Any bytes are an event, never an exception; the buffer is bounded."""

    def __init__(self) -> None:
        self._state = _State.CONNECTED
        self._buffer = b""

    def receive_bytes(self, data: bytes) -> list[Event]:
        """Return the events in these bytes, and in those kept from before."""
        *messages, rest = (self._buffer + data).split(b">")
        events: list[Event] = []
        for message in messages:
            # What comes before the last '<' is noise, or a message whose end was lost.
            _, bracket, body = message.rpartition(b"<")
            if not bracket or len(body) > MAX_MESSAGE_BYTES:
                events.append(_error("a message begins with '<' and ends with '>'"))
            else:
                events += self._message(body)
        # Of an overlong rest only its first bytes are kept: enough to know that it is overlong when its end comes.
        start = max(rest.rfind(b"<"), 0)
        self._buffer = rest[start : start + MAX_MESSAGE_BYTES + 2]
        return events

    def _message(self, body: bytes) -> list[Event]:
        word, _, rest = b" ".join(body.split()).partition(b" ")
        match word:
            case b"send":
                return [self._send(rest)]
            case b"echo":
                return [ServerReply(ECHO)]
            case b"fault":
                return [FaultAsked(rest.decode("ascii", errors="replace"))]
            case b"open":
                return self._advance(_State.CONNECTED, _State.OPENED) if rest else [_error("open what bus?")]
            case b"rawmode":
                events = self._advance(_State.OPENED, _State.RAW)
                return (
                    [*events, RawModeEntered()]
                    if self._state is _State.RAW and events == [ServerReply(OK)]
                    else events
                )
            case _:
                return [_error(f"unknown command {_shown(word)}")]

    def _advance(self, wanted: _State, following: _State) -> list[Event]:
        if self._state is not wanted:
            return [_error(self._state.value)]
        self._state = following
        return [ServerReply(OK)]

    def _send(self, rest: bytes) -> Event:
        if self._state is not _State.RAW:
            return _error(self._state.value)
        match = _SEND.fullmatch(rest)
        if match is None:
            return _error(f"cannot send {_shown(rest)}")
        can_id = int(match[1], 16)
        if can_id > (IDENTIFIER_MASK if len(match[1]) == 8 else STANDARD_MASK):
            return _error(f"identifier {_shown(match[1])} is too large")
        can_id |= EXTENDED if len(match[1]) == 8 else 0
        length, data = int(match[2], 16), bytes(int(byte, 16) for byte in match[3].split())
        if length <= 8 and not data and length:
            # python-can writes a remote frame so; the protocol itself has no word for one.
            return Sent(Frame(can_id | REMOTE, b"", remote_length=length))
        if length != len(data):
            return _error(f"length {length} and {len(data)} bytes do not fit")
        return Sent(Frame(can_id, data))


def frame_line(frame: Frame) -> bytes | None:
    """The line that shows a frame to a client; None for what the protocol cannot show: remote and FD frames."""
    if frame.can_id & REMOTE or frame.fd_flags:
        return None
    time_s, remainder_ns = divmod(frame.wall_ns, 1_000_000_000)
    when = f"{time_s}.{remainder_ns // 1000:06d}"
    if frame.can_id & ERROR:
        return f"< error {frame.can_id & IDENTIFIER_MASK:03X} {when} >".encode("ascii")
    return f"< frame {hex_identifier(frame.can_id)} {when} {frame.data.hex().upper()} >".encode("ascii")


def error_line(reason: str) -> bytes:
    """Return the line that reports a client's error to it."""
    text = re.sub(r"[<>\s]+", " ", reason)[:_MAX_ERROR_CHARACTERS].strip()
    return f"< error {text} >".encode("ascii", errors="replace")


def _error(reason: str) -> ServerReply:
    return ServerReply(error_line(reason))


def _shown(data: bytes) -> str:
    return repr(data[:_MAX_SHOWN_BYTES].decode("ascii", errors="replace"))
