"""What systemd is told: ready once, alive each time, and the state where it has changed."""

import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.host.process import ServiceManager


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.settimeout(5)
        yield listening


def told(systemd: socket.socket, address: str) -> ServiceManager:
    """A gateway that systemd has started."""
    del systemd
    manager = ServiceManager.of({"NOTIFY_SOCKET": address})
    assert manager is not None
    return manager


def test_ready_is_said_once_and_alive_each_time(systemd: socket.socket) -> None:
    """The status again only where it is another."""
    manager = told(systemd, systemd.getsockname())
    for status in ("standby", "standby", "en\ngaged"):
        manager.alive(status)
    manager.close()
    assert [systemd.recv(200).decode() for _ in range(3)] == [
        "WATCHDOG=1\nREADY=1\nSTATUS=standby",
        "WATCHDOG=1",
        "WATCHDOG=1\nSTATUS=en\\ngaged",
    ]


def test_what_was_not_taken_is_said_again(systemd: socket.socket) -> None:
    """A full socket holds nobody up: the loop continues, and ready comes later."""
    manager = told(systemd, systemd.getsockname())
    another = told(systemd, systemd.getsockname())
    sent = 0
    # The kernel holds so many datagrams for a reader, and none more.
    for _ in range(10_000):
        manager.alive("standby")
    another.alive("standby")
    systemd.settimeout(0)
    with suppress(BlockingIOError):
        while True:
            assert b"READY" not in systemd.recv(200) or not sent
            sent += 1
    systemd.settimeout(5)
    another.alive("standby")
    assert "READY=1" in systemd.recv(200).decode()
    for each in (manager, another):
        each.close()


def test_an_abstract_name_is_one_of_the_kernels() -> None:
    """As in a container."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind("\0cruiser-test-notify")
        listening.settimeout(5)
        manager = told(listening, "@cruiser-test-notify")
        manager.alive("standby")
        manager.close()
        assert b"READY=1" in listening.recv(200)


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "vsock:2:1"}])
def test_without_systemd_nobody_is_told(environment: dict[str, str]) -> None:
    """By hand, or in a test."""
    assert ServiceManager.of(environment) is None


def test_a_manager_that_has_gone_ends_nothing(tmp_path: Path) -> None:
    """The loop goes on."""
    manager = ServiceManager(str(tmp_path / "gone"))
    manager.alive("standby")
    manager.close()
