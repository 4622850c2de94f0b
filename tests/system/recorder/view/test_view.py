"""``cruiser view`` with real robots and a viewer. The oracle is a log of the same time."""

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import zenoh
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from gateway.authority.enrolment import TransportRole
from recorder.cli import view
from recorder.encoding.protobuf import message_class
from schemas.command_line import CommandError, ExitCode
from schemas.decisions import Decision, SafetyEvent
from schemas.messages import GatewayInfo, RobotState
from schemas.settings import Settings, ZenohSettings
from tests.support.commands import run_command
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.foxglove_client import Advertised, FoxgloveClient
from tests.support.messages import STATE as ROBOT_STATE
from tests.support.messages import gear, info, key_of, sample_of
from tests.support.processes.gateway import Running, chassis, gateway, run
from tests.support.processes.recorder import recording
from tests.support.routers import router_process
from tests.support.secured import Network
from tests.support.waiting import wait_until

LISTEN = ("--listen", "127.0.0.1:0")
STATE, DECISION, EVENT = key_of(RobotState), key_of(Decision), key_of(SafetyEvent)


class Scene(NamedTuple):
    endpoint: str
    url: str
    gateway: Running
    view: Running


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    endpoint = free_endpoint()
    with ExitStack() as stack:
        _, bus = stack.enter_context(chassis())
        robot = stack.enter_context(gateway(bus, endpoint))
        words = ("cruiser-1", *LISTEN, "--connect", endpoint, "--layouts", str(tmp_path / "layouts"))
        viewing = stack.enter_context(Running("view", *words))
        yield Scene(endpoint, viewing.wait_says(r"view: (ws://[^,]+), cruiser-1 at ")[1], robot, viewing)


def stop(scene: Scene) -> None:
    assert run(["stop", "cruiser-1", "--connect", scene.endpoint]).returncode in {ExitCode.OK, ExitCode.PARTIAL}


def state_of(data: bytes) -> Any:  # noqa: ANN401 - protobuf makes the class at run time
    return message_class(RobotState).FromString(data)


def test_what_is_shown_is_what_is_in_a_log_of_the_time(scene: Scene, tmp_path: Path) -> None:
    """Topics, schemas and encodings are equal, and each record is in the log byte by byte."""
    words = ("-k", "fleet/cruiser-1/**", "-o", str(tmp_path / "logs"), "--connect", scene.endpoint)
    with recording(*words) as recorder, FoxgloveClient(scene.url) as viewer:
        viewer.subscribe()
        first = viewer.wait(lambda one: one.topics >= {STATE, f"{EVENT}/log"} and len(one.messages) > 300)
        # What the recorder was there to see.
        before = len(first.messages)
        stop(scene)
        viewer.wait(lambda one: {EVENT, f"{EVENT}/log", DECISION} <= {message.topic for message in one.messages})
        viewer.receive_for(1.0)
        assert recorder.end()[0] == ExitCode.OK
        seen, channels = viewer.messages[before:], viewer.channels.values()
    (log,) = (path for path in (tmp_path / "logs").glob("*.mcap") if "incident" not in path.name)
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        logged_channels = {
            Advertised(
                channel.topic,
                channel.message_encoding,
                summary.schemas[channel.schema_id].name,
                summary.schemas[channel.schema_id].encoding,
                summary.schemas[channel.schema_id].data,
            )
            for channel in summary.channels.values()
            if "/@recorder/" not in channel.topic
        }
        logged = {(channel.topic, message.data) for _, channel, message in reader.iter_messages()}
        speeds = [decoded.speed_mps for _, _, _, decoded in reader.iter_decoded_messages(topics=[STATE])]
    assert set(channels) == logged_channels
    # Each asks for itself who the robot is, and draws odometry samples of its own choice.
    own = ("/gateway/info", "/odometry/tf")
    missing = {(one.topic, one.data) for one in seen if not one.topic.endswith(own)} - logged
    assert {topic for topic, _ in missing} == set()
    assert any(one.topic.endswith("/odometry/tf") for one in seen)
    shown = [state_of(one.data).speed_mps for one in seen if one.topic == STATE]
    assert shown
    assert set(shown) <= set(speeds)


def test_what_a_viewer_sends_reaches_no_robot(scene: Scene) -> None:
    """No put, no decision."""
    config = zenoh.Config()
    for path, value in (("mode", "client"), ("connect/endpoints", [scene.endpoint])):
        config.insert_json5(path, json.dumps(value))
    with zenoh.open(config) as session, FoxgloveClient(scene.url) as viewer:
        put = session.declare_subscriber("fleet/**", zenoh.handlers.RingChannel(1))
        commanded = session.declare_subscriber("fleet/*/@cmd/**", zenoh.handlers.RingChannel(1))
        wait_until(lambda: put.try_recv() is not None)
        assert viewer.info["capabilities"] == []
        viewer.subscribe(lambda topic: topic in {DECISION, EVENT})
        topic = "fleet/cruiser-1/@cmd/intruder/stop"
        channel = {"id": 1, "topic": topic, "encoding": "json", "schemaName": ""}
        for operation in (
            {"op": "advertise", "channels": [channel]},
            {"op": "setParameters", "parameters": [{"name": "command.max_age_s", "value": 9}], "id": "a"},
            {"op": "getParameters", "parameterNames": [], "id": "b"},
            {"op": "subscribeConnectionGraph"},
            {"op": "fetchAsset", "uri": "file:///etc/passwd", "requestId": 1},
        ):
            viewer.send(operation)
        viewer.publish(1, b"{}")
        viewer.call(1, b"{}")
        viewer.wait(lambda one: len(one.said) == 7)
        levels = [one.get("level") for one in viewer.said]
        assert sorted(one["op"] for one in viewer.said) == ["serviceCallFailure", *["status"] * 6]
        assert levels.count(2) == 6
        assert all("not support" in one["message"] or "Unknown channel" in one["message"] for one in viewer.said)
        viewer.receive_for(1.0)
        # An event may be there from before; a decision is made of every request.
        assert [message.topic for message in viewer.messages if message.topic == DECISION] == []
        assert commanded.try_recv() is None
        stop(scene)
        viewer.wait(lambda one: DECISION in {message.topic for message in one.messages})


def test_a_robot_that_falls_silent_is_not_shown_as_current(scene: Scene) -> None:
    with FoxgloveClient(scene.url) as viewer:
        scene.gateway.process.send_signal(signal.SIGSTOP)
        viewer.wait(lambda one: bool(one.said))
        assert viewer.said[0]["message"] == "cruiser-1 is silent: its values are out of date"
        with FoxgloveClient(scene.url) as late:
            late.wait(lambda one: bool(one.said))
        scene.gateway.process.send_signal(signal.SIGCONT)
        viewer.wait(lambda one: one.said[-1]["op"] == "removeStatus")


def test_it_ends_at_a_signal_and_leaves_the_layouts(scene: Scene, tmp_path: Path) -> None:
    layout = tmp_path / "layouts" / "cruiser-1.layout.foxglove.json"
    wait_until(layout.exists)
    assert b"fleet/cruiser-1/can/can0/rx" in layout.read_bytes()
    assert scene.view.stop() == ExitCode.OK
    assert len(scene.view.said) == 1


def settings(endpoint: str) -> Settings:
    return Settings(zenoh=ZenohSettings(connect=[endpoint]))


def test_a_robot_that_is_not_there_is_named() -> None:
    endpoint = free_endpoint()
    words = ("cruiser-9", *LISTEN, "--timeout", "1")
    with pytest.raises(CommandError, match=f"no Zenoh node answered within 1 s at {endpoint}"):
        run_command(view, *words, settings=settings(endpoint))
    with Peer(endpoint) as peer:
        peer.put(sample_of(gear(0)))
        with pytest.raises(CommandError, match=r"no sample of cruiser-9 received .*'cruiser list' shows") as error:
            run_command(view, *words, settings=settings(endpoint))
    assert error.value.code is ExitCode.UNREACHABLE


def test_beyond_this_machine_it_wants_a_certificate() -> None:
    with pytest.raises(CommandError, match=r"beyond this machine \(0\.0\.0\.0\) viewers need TLS") as error:
        run_command(view, "--listen", "0.0.0.0:0")
    assert error.value.code is ExitCode.USAGE


def test_without_its_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith(("foxglove", "recorder.view"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(CommandError, match=r"foxglove: pip install -e '\.\[live\]'"):
        run_command(view)


def test_a_viewers_certificate_suffices(tmp_path: Path) -> None:
    network = Network(tmp_path, free_endpoint().replace("tcp/", "tls/"))
    router = network.node(TransportRole.ROUTER, "127.0.0.1") / "router.json5"
    file = network.node(TransportRole.VIEWER, "ann") / "viewer.json5"
    words = (*LISTEN, "--zenoh-config", str(file))
    who = sample_of(info())
    with (
        router_process(router),
        network.session(TransportRole.ROBOT, "cruiser-1", "cruiser-1") as robot,
        Running("view", *words) as viewing,
        FoxgloveClient(viewing.wait_says(r"view: (ws://[^,]+), all robots at ")[1]) as viewer,
    ):
        queries = robot.declare_queryable(who.key, zenoh.handlers.RingChannel(4), complete=True)
        viewer.subscribe()

        def is_shown() -> bool:
            said = sample_of(ROBOT_STATE)
            robot.put(said.key, said.payload, encoding=said.encoding)
            if (query := queries.try_recv()) is not None:
                with query:
                    query.reply(who.key, who.payload, encoding=who.encoding)
            viewer.receive_for(0.1)
            return {STATE, key_of(GatewayInfo)} <= {message.topic for message in viewer.messages}

        wait_until(is_shown)
