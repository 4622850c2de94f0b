"""Processes listen where they were told to, by the sockets that they open."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest

from gateway.authority.enrolment import TransportRole
from schemas.command_line import CommandError, ExitCode
from schemas.messages import GatewayInfo
from schemas.settings import ZenohSettings
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.nights import by_night
from tests.support.processes.gateway import Running, chassis, gateway, run, wait_for_chassis
from tests.support.processes.listening import listening
from tests.support.secured import Network
from tests.support.waiting import wait_until

EVERY = ("tcp/127.0.0.1:{}", "tcp/0.0.0.0:{}", "tcp/[::]:{}", "tcp/127.0.0.1:0")


def port_of(endpoint: str) -> int:
    return int(endpoint.rpartition(":")[2])


def sockets(endpoints: list[str]) -> set[str]:
    return {endpoint.partition("/")[2] for endpoint in endpoints}


def info_of(connect: str) -> GatewayInfo:
    session = open_session(ZenohSettings(mode="client"), [connect], [])
    found: list[bytes] = []

    def ask() -> None:
        replies = session.get("fleet/cruiser-1/gateway/info", timeout=2)
        found.extend(reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None)

    wait_until(lambda: bool(found), ask)
    close_session(session)
    return msgspec.msgpack.decode(found[0], type=GatewayInfo)


def stop_at(connect: str, *words: str) -> None:
    wait_for_chassis(connect, *words)
    done = run(["stop", "cruiser-1", "--connect", connect, *words])
    assert done.returncode == ExitCode.OK, done.stderr


@contextmanager
def dialling(*words: str) -> Iterator[Running]:
    """A gateway without an endpoint to listen on."""
    with (
        chassis() as (_, address),
        Running("gateway", "--interface", "socketcand", "--channel", address, *words) as running,
    ):
        running.wait_says("^gateway: ")
        yield running


@contextmanager
def router(config: str = "", protocol: str = "tcp", host: str = "127.0.0.1") -> Iterator[str]:
    endpoint = f"{protocol}/{host}:{port_of(free_endpoint())}"
    settings = msgspec.structs.replace(ZenohSettings(config=config, given=frozenset({"mode"})), mode="router")
    session = open_session(settings, [], [endpoint])
    yield endpoint
    close_session(session)


@pytest.mark.parametrize("form", EVERY)
def test_a_gateway_listens_where_it_is_told_and_one_port_on(form: str) -> None:
    port = port_of(free_endpoint())
    with chassis() as (_, address), gateway(address, form.format(port)) as running:
        said = running.wait_says(r"cruiser-1 listens on (\S+), for commands on (\S+), bus")
        if "{}" in form:
            assert said.groups() == (form.format(port), form.format(port + 1))
        assert listening(running.process.pid) == sockets([said[1], said[2]])
        host = "[::1]" if "[::]" in form else "127.0.0.1"
        info = info_of(f"tcp/{host}:{port_of(said[1])}")
        assert (info.listen, info.command_listen) == ([said[1]], [said[2]])
        assert running.stop() == 0


def test_the_port_for_commands_can_be_said(monkeypatch: pytest.MonkeyPatch) -> None:
    listen, commands = free_endpoint(), free_endpoint()
    monkeypatch.setenv("CRUISER_ZENOH_COMMAND_LISTEN", commands)
    with chassis() as (_, address):
        with gateway(address, listen) as running:
            assert listening(running.process.pid) == sockets([listen, commands])
        with gateway(address, listen, "--listen-only") as running:
            assert listening(running.process.pid) == sockets([listen])


@pytest.mark.parametrize("said_by", [by_night("flags alone"), "a file"])
def test_a_gateway_that_dials_out_listens_on_nothing(tmp_path: Path, said_by: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{ transport: { link: { tx: { keep_alive: 5 } } } }")
    words = ["--zenoh-config", str(file)] if said_by == "a file" else []
    with router() as endpoint, dialling("--connect", endpoint, *words) as running:
        running.wait_says(re.escape(f"cruiser-1 listens on nothing, connects to {endpoint}, bus"))
        info = info_of(endpoint)
        assert (info.listen, info.command_listen) == ([], [])
        stop_at(endpoint)
        assert listening(running.process.pid) == set()


def test_a_file_says_where_to_connect_and_to_listen(tmp_path: Path) -> None:
    listen = free_endpoint()
    commands = f"tcp/127.0.0.1:{port_of(listen) + 1}"
    file = tmp_path / "zenoh.json5"
    with router() as endpoint:
        dials = {"connect": {"endpoints": [endpoint]}}
        file.write_text(json.dumps(dials | {"listen": {"endpoints": {"peer": [listen]}}}))
        with dialling("--zenoh-config", str(file)) as running:
            assert listening(running.process.pid) == sockets([listen, commands])
            for connect in (endpoint, listen):
                stop_at(connect)
        file.write_text(json.dumps(dials))
        with dialling("--zenoh-config", str(file)) as running:
            assert info_of(endpoint).listen == []
            assert listening(running.process.pid) == set()


def test_a_gateway_that_speaks_tls_alone(tmp_path: Path) -> None:
    network = Network(tmp_path)
    port = port_of(free_endpoint())
    listen, commands = (f"tls/0.0.0.0:{one}" for one in (port, port + 1))
    # Its certificate carries a name, not the addresses that it listens on.
    with dialling("--zenoh-config", network.tls_file("localhost"), "--listen", listen) as running:
        assert listening(running.process.pid) == sockets([listen, commands])
        assert "cannot command" not in "".join(running.said)
        ends = [f"tls/localhost:{one}" for one in (port, port + 1)]
        for mode, connect in (("client", ends[:1]), ("peer", ends)):
            flags = [word for one in connect for word in ("--connect", one)]
            stop_at(flags.pop(), *flags[:-1], "--zenoh-config", network.tls_file("desk", mode=mode))
        for one in (port, port + 1):
            with pytest.raises(CommandError, match="cannot open Zenoh"):
                open_session(ZenohSettings(mode="client"), [f"tcp/localhost:{one}"], [])


def test_a_gateway_and_a_recorder_that_speak_tls_alone_dial_out(tmp_path: Path) -> None:
    network = Network(tmp_path)
    robot, desk = (network.tls_file(name) for name in ("robot", "desk"))
    depot = network.tls_file("depot", TransportRole.RECORDER)
    with router(network.tls_file("localhost"), "tls", "localhost") as endpoint:
        there = ["--connect", endpoint, "--zenoh-config"]
        with (
            dialling(*there, robot) as running,
            Running("record", *there, depot, "-o", str(tmp_path / "logs"), "--name", "depot") as recorder,
        ):
            recorder.wait_says("listens on nothing")
            stop_at(*there[1:], desk)
            for process in (running.process, recorder.process):
                assert listening(process.pid) == set()
            assert run(["record", "status", *there, desk]).returncode == ExitCode.OK
            assert recorder.stop() == ExitCode.OK
    assert list((tmp_path / "logs").glob("**/*.mcap"))


def test_where_only_tls_is_allowed_somebody_has_to_say_where(tmp_path: Path) -> None:
    file = Network(tmp_path).tls_file("robot")
    done = run(["gateway", "--interface", "virtual", "--zenoh-config", file])
    assert done.returncode == ExitCode.USAGE
    assert "does not allow the protocol of the default endpoint" in done.stderr


def test_a_recorder_listens_on_this_machine_alone(tmp_path: Path) -> None:
    with Running("record", "--connect", free_endpoint(), "-o", str(tmp_path)) as recorder:
        said = recorder.wait_says(r"; listens on (tcp/127\.0\.0\.1:\d+)$")
        assert listening(recorder.process.pid) == sockets([said[1]])
    listen = free_endpoint()
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps({"listen": {"endpoints": [listen]}}))
    with Running("record", "--zenoh-config", str(file), "-o", str(tmp_path)) as recorder:
        recorder.wait_says(f"; listens on {listen}, ")
        assert listening(recorder.process.pid) == sockets([listen, f"tcp/127.0.0.1:{port_of(listen) + 1}"])
