"""A log's frames on a CAN bus of python-can, and how a virtual bus is told from a real one."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import pytest

from recorder.replay.can import CanOutlet, CanPlace, is_virtual
from recorder.replay.frames import ReplayedFrame
from schemas.exit_codes import CommandError, ExitCode
from tests.support.messages import WALL_NS, can_frame
from tests.support.processes.simulator import served


def test_the_simulators_server_is_known_and_passes_frames_on() -> None:
    """It is asked what it is, before anything is sent; then another client gets what was sent."""
    with served() as simulator, simulator.bus() as other:
        place = CanPlace("socketcand", f"{simulator.host}:{simulator.port}")
        assert is_virtual(place)
        with closing(CanOutlet(place)) as outlet:
            deadline_s = time.monotonic() + 20
            found = None
            while found is None:
                # A client is on the bus a moment after it has joined.
                outlet.send(ReplayedFrame(WALL_NS, can_frame(0x555, is_extended=False)), 0)
                outlet.attend()
                message = other.recv(0.01)
                if message is not None and message.arbitration_id == 0x555:
                    found = message
                assert time.monotonic() < deadline_s
            assert bytes(found.data) == can_frame().data


@contextmanager
def server(answer: Callable[[bytes], bytes], greeting: bytes = b"< hi >") -> Iterator[str]:
    """Somebody else's server on the loopback: greets, and answers once. Gives its address."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(20)

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.settimeout(20)
                connection.sendall(greeting)
                connection.sendall(answer(connection.recv(1024)))

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield f"127.0.0.1:{listener.getsockname()[1]}"
        finally:
            thread.join()


@pytest.mark.parametrize("answer", [b"< error unknown command >", b"< ok >", b"< error >", b""])
def test_another_server_of_this_machine_may_serve_a_real_bus(answer: bytes) -> None:
    """A socketcand daemon knows no faults, and says so; whatever else is answered is no proof either."""
    with server(lambda _: answer) as address:
        assert not is_virtual(CanPlace("socketcand", address))


def test_a_server_that_is_not_there_is_unreachable() -> None:
    """One line; an address that is none is a mistake."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"127.0.0.1:{listener.getsockname()[1]}"
    with pytest.raises(CommandError) as caught:
        is_virtual(CanPlace("socketcand", address))
    assert caught.value.code is ExitCode.UNREACHABLE
    for channel in ("nowhere", "127.0.0.1:0", "127.0.0.1:99999", ":"):
        with pytest.raises(CommandError) as caught:
            is_virtual(CanPlace("socketcand", channel))
        assert caught.value.code is ExitCode.USAGE
