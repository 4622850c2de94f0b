"""The terminal of a replay: a real one, as far as a program can tell."""

import io
import os
import pty
import termios
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

import pytest

from recorder.replay.controls import Order, ReplayControls, orders_of
from tests.support.messages import WALL_NS
from tests.support.waiting import wait_until


@contextmanager
def terminal() -> Iterator[tuple[int, TextIO]]:
    """The side of a person, and that of the program."""
    person, program = pty.openpty()
    with os.fdopen(program, "r+b", buffering=0) as raw, io.TextIOWrapper(raw, write_through=True) as stream:
        yield person, stream
    os.close(person)


@pytest.mark.parametrize(
    ("typed", "orders"),
    [
        (b" ", [Order.PAUSE]),
        (b"q", [Order.QUIT]),
        (b"\x1b[C\x1b[D", [Order.ON, Order.BACK]),
        (b"\x1bOC", [Order.ON]),
        (b"x\x1b[A\n ", [Order.PAUSE]),
        (b"\xff\x00\x1b", []),
        (b"", []),
    ],
)
def test_keys_mean_orders(typed: bytes, orders: list[Order]) -> None:
    """What means nothing is passed over."""
    assert orders_of(typed) == orders


def test_a_terminal_is_read_and_written_and_left_as_it_was() -> None:
    """Keys come without Enter, the line shows where the replay is, Ctrl-C stays a signal."""
    with terminal() as (person, stream):
        before = termios.tcgetattr(stream)
        with ReplayControls(takes_keys=True, read_from=stream, write_to=stream) as controls:
            inside = termios.tcgetattr(stream)
            assert not inside[3] & (termios.ICANON | termios.ECHO)
            assert inside[3] & termios.ISIG
            assert controls.orders() == []
            os.write(person, b" q")
            found: list[Order] = []

            def came() -> bool:
                found.extend(controls.orders())
                return len(found) >= 2

            wait_until(came)
            assert found == [Order.PAUSE, Order.QUIT]
            controls.show(None, is_paused=False)
            controls.show(WALL_NS, is_paused=True)
            controls.show(WALL_NS, is_paused=False)
        shown = os.read(person, 1000)
        assert b"2027-01-15 08:00:00.000 UTC  paused" in shown
        assert shown.count(b"UTC") == 1
        assert termios.tcgetattr(stream) == before


def test_where_there_is_no_terminal_nothing_is_read_or_shown() -> None:
    """Input may be a pipe that means something to somebody else."""
    out = io.StringIO()
    with ReplayControls(takes_keys=True, read_from=io.StringIO("q"), write_to=out) as controls:
        controls.show(WALL_NS, is_paused=False)
        assert controls.orders() == []
    assert out.getvalue() == ""


def test_a_replay_that_takes_no_keys_reads_none() -> None:
    """To a real bus nobody steps about in a drive."""
    with terminal() as (person, stream):
        os.write(person, b"q")
        with ReplayControls(takes_keys=False, read_from=stream, write_to=stream) as controls:
            assert controls.orders() == []


def test_a_terminal_that_has_gone_ends_the_replay() -> None:
    """Nobody is watching any more."""
    with terminal() as (_, stream):
        controls = ReplayControls(takes_keys=True, read_from=stream, write_to=stream)
        # What cannot be read is always ready, and fails.
        controls._in = os.open(os.devnull, os.O_WRONLY)
        try:
            assert controls.orders() == [Order.QUIT]
        finally:
            os.close(controls._in)
