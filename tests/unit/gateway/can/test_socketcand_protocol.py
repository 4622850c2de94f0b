"""The server side of the socketcand text protocol."""

from itertools import pairwise

import pytest
from can.interfaces.socketcand.socketcand import (
    convert_ascii_message_to_can_message,
    convert_can_message_to_ascii_message,
)
from hypothesis import given
from hypothesis import strategies as st

from gateway.can.can_bus import epoch_ns, frame_of, send_line
from gateway.can.python_can import to_frame, to_message
from gateway.can.socketcand_server import (
    ECHO,
    MAX_MESSAGE_BYTES,
    OK,
    Event,
    FaultAsked,
    ServerConnection,
    error_line,
    frame_line,
)
from gateway.chassis.frame import ERROR, EXTENDED, FD, REMOTE, Frame

HANDSHAKE = b"< open can0 >< rawmode >"

WORDS = st.sampled_from(b"<,>,< , >,open,can0,rawmode,send,echo,fault, ,123,18C4D1D0,1,\n".split(b","))
NOISE = st.binary(max_size=40) | st.lists(WORDS, max_size=40).map(b"".join) | st.just(b"x" * 600)

can_ids = st.integers(0, 0x7FF) | st.integers(0, 0x1FFF_FFFF).map(lambda number: number | EXTENDED)
sendable = st.builds(Frame, can_id=can_ids, data=st.binary(max_size=8))
remote = st.builds(lambda can_id, length: Frame(can_id | REMOTE, b"", 0, 0, length), can_ids, st.integers(1, 8))


def joined() -> ServerConnection:
    connection = ServerConnection()
    assert connection.receive_bytes(HANDSHAKE) == [OK, OK]
    return connection


def is_error(event: Event) -> bool:
    return isinstance(event, bytes) and event.startswith(b"< error ")


def test_the_handshake_is_answered_word_by_word() -> None:
    connection = ServerConnection()
    assert connection.receive_bytes(b"< open can0 >") == [OK]
    assert not connection.is_raw
    assert connection.receive_bytes(b"< rawmode >") == [OK]
    assert connection.is_raw
    assert connection.receive_bytes(b"< echo >") == [ECHO]


@pytest.mark.parametrize(
    "data",
    [
        b"< rawmode >",
        b"< send 123 0 >",
        b"< open >",
        b"< bcmmode >",
        b"<>",
        b"noise >",
        b"< open can0 >< open can0 >",
        HANDSHAKE + b"< rawmode >",
        HANDSHAKE + b"< send 12345 0 >",
        HANDSHAKE + b"< send 800 0 >",
        HANDSHAKE + b"< send 20000000 0 >",
        HANDSHAKE + b"< send 123 9 1 2 3 4 5 6 7 8 9 >",
        HANDSHAKE + b"< send 123 2 1 >",
        HANDSHAKE + b"< send 123 1 100 >",
        HANDSHAKE + b"< send 123 1 0x1 >",
        HANDSHAKE + b"< send 123 1 +1 >",
        HANDSHAKE + b"< send >",
        b"<" + b"x" * (MAX_MESSAGE_BYTES + 1) + b">",
    ],
)
def test_what_is_wrong_is_answered_by_an_error(data: bytes) -> None:
    *_, last = ServerConnection().receive_bytes(data)
    assert is_error(last)


@given(frame=sendable | remote)
def test_it_understands_what_python_can_sends(frame: Frame) -> None:
    assert convert_can_message_to_ascii_message(to_message(frame)).encode() == send_line(frame)
    assert joined().receive_bytes(send_line(frame)) == [frame]


@given(frame=sendable, wall_ns=st.integers(0, 2**61))
def test_python_can_understands_what_it_sends(frame: Frame, wall_ns: int) -> None:
    line = frame_line(Frame(frame.can_id, frame.data, wall_ns))
    assert line is not None
    message = convert_ascii_message_to_can_message(line.decode())
    assert message.arbitration_id == frame.identifier
    assert message.is_extended_id == bool(frame.can_id & EXTENDED)
    assert bytes(message.data) == frame.data
    assert message.timestamp == pytest.approx(wall_ns / 1e9, abs=2e-6)
    assert frame_of(line.decode()) == to_frame(message, epoch_ns(message.timestamp))


def test_an_error_frame_is_shown_as_one() -> None:
    line = frame_line(Frame(0x4 | ERROR, bytes(8), 1_500_000_000))
    assert line == b"< error 004 1.500000 >"
    message = convert_ascii_message_to_can_message(line.decode())
    assert (
        frame_of(line.decode())
        == to_frame(message, 1_500_000_000)
        == Frame(0x4 | ERROR | EXTENDED, b"\0", 1_500_000_000)
    )


@pytest.mark.parametrize("frame", [Frame(0x123 | REMOTE, b"", remote_length=4), Frame(0x123, bytes(12), 0, FD)])
def test_what_the_protocol_cannot_show_is_not_shown(frame: Frame) -> None:
    assert frame_line(frame) is None


@given(data=st.lists(NOISE, max_size=10).map(b"".join), joins=st.booleans())
def test_any_bytes_are_events(data: bytes, joins: bool) -> None:  # noqa: FBT001 - Hypothesis names its arguments
    connection = joined() if joins else ServerConnection()
    for event in connection.receive_bytes(data):
        if is_error(event):
            assert isinstance(event, bytes)
            assert event.isascii()
            assert (event.count(b"<"), event.count(b">")) == (1, 1)
    assert len(connection._buffer) <= MAX_MESSAGE_BYTES + 2
    assert connection.receive_bytes(b"< echo >")[-1] == ECHO


@given(data=st.lists(NOISE, max_size=8).map(b"".join), cuts=st.lists(st.integers(0, 2000), max_size=10))
def test_segments_do_not_matter(data: bytes, cuts: list[int]) -> None:
    whole, cut_up = joined(), joined()
    edges = [0, *sorted(cuts), len(data)]
    pieces = [data[begin:end] for begin, end in pairwise(edges)]
    assert [event for piece in pieces for event in cut_up.receive_bytes(piece)] == whole.receive_bytes(data)


def test_a_fault_may_be_asked_for_at_any_time() -> None:
    asked = [FaultAsked("bumper front on")]
    assert ServerConnection().receive_bytes(b"<  fault  bumper front on >") == asked
    assert joined().receive_bytes(b"< fault bumper front on >") == asked


def test_a_lost_end_costs_one_message() -> None:
    assert joined().receive_bytes(b"< send 123 1 < echo >") == [ECHO]


@given(reason=st.text(max_size=1000))
def test_an_error_is_one_message(reason: str) -> None:
    line = error_line(reason)
    assert line.isascii()
    assert (line.count(b"<"), line.count(b">")) == (1, 1)
    assert len(line) < 400
