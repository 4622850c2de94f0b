"""Notifications to systemd: ready once, alive each time, and the state when it changes."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from gateway.host.process import ServiceManager


@contextmanager
def told(name: str) -> Iterator[tuple[socket.socket, ServiceManager]]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(name.replace("@", "\0"))
        listening.settimeout(5)
        manager = ServiceManager.of({"NOTIFY_SOCKET": name})
        assert manager is not None
        yield listening, manager
        manager.close()


@pytest.mark.parametrize("name", ["{}/notify", "@cruiser-test-notify"], ids=["file", "abstract"])
def test_ready_is_said_once_and_alive_each_time(tmp_path: Path, name: str) -> None:
    with told(name.format(tmp_path)) as (systemd, manager):
        for status in ("standby", "standby", "en\ngaged"):
            manager.alive(status)
        said = [systemd.recv(200) for _ in range(3)]
    assert said == [b"WATCHDOG=1\nREADY=1\nSTATUS=standby", b"WATCHDOG=1", b"WATCHDOG=1\nSTATUS=en\\ngaged"]


def test_what_was_not_taken_is_said_again(tmp_path: Path) -> None:
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


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "vsock:2:1"}])
def test_without_systemd_nobody_is_told(environment: dict[str, str]) -> None:
    assert ServiceManager.of(environment) is None


def test_a_manager_that_has_gone_ends_nothing(tmp_path: Path) -> None:
    manager = ServiceManager(str(tmp_path / "gone"))
    manager.alive("standby")
    manager.close()
