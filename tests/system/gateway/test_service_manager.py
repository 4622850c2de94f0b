"""What systemd is told: ready once, alive each time, and the state where it has changed."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from gateway.host.process import ServiceManager


@contextmanager
def told(name: str) -> Iterator[tuple[socket.socket, ServiceManager]]:
    """The socket of a systemd, and a gateway that it has started."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(name.replace("@", "\0"))
        listening.settimeout(5)
        manager = ServiceManager.of({"NOTIFY_SOCKET": name})
        assert manager is not None
        yield listening, manager
        manager.close()


def test_ready_is_said_once_and_alive_each_time(tmp_path: Path) -> None:
    """The status again only where it is another."""
    with told(str(tmp_path / "notify")) as (systemd, manager):
        for status in ("standby", "standby", "en\ngaged"):
            manager.alive(status)
        said = [systemd.recv(200) for _ in range(3)]
    assert said == [b"WATCHDOG=1\nREADY=1\nSTATUS=standby", b"WATCHDOG=1", b"WATCHDOG=1\nSTATUS=en\\ngaged"]


def test_what_was_not_taken_is_said_again(tmp_path: Path) -> None:
    """A full socket holds nobody up: the loop continues, and ready comes later."""
    with told(str(tmp_path / "notify")) as (systemd, manager):
        another = ServiceManager(str(tmp_path / "notify"))
        # The kernel holds so many datagrams for a reader, and none more.
        for _ in range(10_000):
            manager.alive("standby")
        another.alive("standby")
        systemd.settimeout(0)
        with suppress(BlockingIOError):
            while True:
                systemd.recv(200)
        systemd.settimeout(5)
        another.alive("standby")
        assert b"READY=1" in systemd.recv(200)
        another.close()


def test_an_abstract_name_is_one_of_the_kernels() -> None:
    """As in a container."""
    with told("@cruiser-test-notify") as (systemd, manager):
        manager.alive("standby")
        assert b"READY=1" in systemd.recv(200)


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "vsock:2:1"}])
def test_without_systemd_nobody_is_told(environment: dict[str, str]) -> None:
    """By hand, or in a test."""
    assert ServiceManager.of(environment) is None


def test_a_manager_that_has_gone_ends_nothing(tmp_path: Path) -> None:
    """The loop goes on."""
    manager = ServiceManager(str(tmp_path / "gone"))
    manager.alive("standby")
    manager.close()
