import json
from pathlib import Path

import pytest

from gateway.ports.zenoh_client import (
    RobotListener,
    _configuration,
    client_endpoints,
    close_session,
    open_session,
    place,
)
from gateway.remote.heard import Heard, Received, TokenChange
from schemas import codec
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import DEFAULT_ENDPOINT, Settings, ZenohSettings
from schemas.subjects import BY_NAME
from tests.gateway.remote.fake_gateway import HEALTH, STATE, FakeGateway, free_endpoint
from tests.gateway.remote.waiting import wait_until

HEALTH_SAMPLE = Received(
    "fleet/cruiser-1/gateway/health", BY_NAME["gateway/health"].encoding, codec.encode(HEALTH)
)


def settings_for(*endpoints: str) -> Settings:
    """Settings that connect to these endpoints."""
    return Settings(zenoh=ZenohSettings(connect=list(endpoints)))


def test_multicast_is_off_and_nothing_listens_unless_asked() -> None:
    """A session neither scouts by multicast nor listens on any interface by itself."""
    config = _configuration(ZenohSettings(), ["tcp/127.0.0.1:7447"], [])
    assert json.loads(config.get_json("scouting/multicast/enabled")) is False
    assert json.loads(config.get_json("listen/endpoints")) == []


def test_a_zenoh_file_that_says_nothing_of_it_changes_neither(tmp_path: Path) -> None:
    """With a Zenoh file multicast stays off and nothing listens, unless the file itself asks for it."""
    file = tmp_path / "zenoh.json5"
    file.write_text("{ transport: { link: { tx: { keep_alive: 5 } } } }")
    config = _configuration(ZenohSettings(config=str(file)), [], [])
    assert json.loads(config.get_json("scouting/multicast/enabled")) is False
    assert json.loads(config.get_json("listen/endpoints")) == []
    file.write_text(
        "{ scouting: { multicast: { enabled: true } }, listen: { endpoints: ['tcp/127.0.0.1:7500'] },"
        " connect: { endpoints: ['tcp/127.0.0.1:7501'] } }"
    )
    config = _configuration(ZenohSettings(config=str(file)), [], [])
    assert json.loads(config.get_json("scouting/multicast/enabled")) is True
    assert json.loads(config.get_json("listen/endpoints")) == ["tcp/127.0.0.1:7500"]
    assert json.loads(config.get_json("connect/endpoints")) == ["tcp/127.0.0.1:7501"]
    config = _configuration(ZenohSettings(config=str(file)), ["tcp/127.0.0.1:7502"], [])
    assert json.loads(config.get_json("connect/endpoints")) == ["tcp/127.0.0.1:7502"]


def test_a_command_connects_to_this_machine_unless_told_otherwise(tmp_path: Path) -> None:
    """The settings say where to connect, else the Zenoh file, else it is the gateway's own start endpoint."""
    assert client_endpoints(ZenohSettings()) == [DEFAULT_ENDPOINT]
    assert client_endpoints(ZenohSettings(connect=["tcp/127.0.0.1:1"])) == ["tcp/127.0.0.1:1"]
    file = tmp_path / "zenoh.json5"
    file.write_text("{ connect: { endpoints: ['tcp/127.0.0.1:7501'] } }")
    assert client_endpoints(ZenohSettings(config=str(file))) == []
    assert str(file) in place(ZenohSettings(config=str(file)))
    file.write_text("{}")
    assert client_endpoints(ZenohSettings(config=str(file))) == [DEFAULT_ENDPOINT]


@pytest.mark.parametrize(
    ("settings", "code"),
    [
        (ZenohSettings(connect=["nonsense"]), ExitCode.USAGE),
        (ZenohSettings(connect=["\x1b[31m\n"]), ExitCode.USAGE),
        (ZenohSettings(connect=["pigeon/127.0.0.1:1"]), ExitCode.UNREACHABLE),
        (ZenohSettings(config="/nowhere/zenoh.json5"), ExitCode.USAGE),
        (ZenohSettings(config="/dev/null"), ExitCode.USAGE),
        (ZenohSettings(mode="client", connect=[free_endpoint()]), ExitCode.UNREACHABLE),
    ],
)
def test_what_zenoh_does_not_take_is_one_clear_line(settings: ZenohSettings, code: ExitCode) -> None:
    """Wrong endpoints, a wrong file, a client that finds nobody: one printable line, without Zenoh's places."""
    with pytest.raises(CommandError) as caught:
        close_session(open_session(settings, client_endpoints(settings), []))
    assert caught.value.code is code
    assert str(caught.value).isprintable()
    assert ".rs" not in str(caught.value)


def test_a_port_that_is_taken_is_one_clear_line() -> None:
    """Listening where somebody else listens fails at once."""
    with FakeGateway("cruiser-1") as gateway, pytest.raises(CommandError, match="cannot open Zenoh") as caught:
        close_session(open_session(ZenohSettings(), [], [gateway.listen]))
    assert caught.value.code is ExitCode.UNREACHABLE


def test_a_listener_is_connected_only_while_somebody_is_there() -> None:
    """A peer's session opens although nobody answers; it connects when somebody comes, and sees them go."""
    endpoint = free_endpoint()
    with RobotListener.open(settings_for(endpoint)) as listener:
        assert not listener.connected()
        with FakeGateway("cruiser-1", listen=endpoint):
            wait_until(listener.connected)
        wait_until(lambda: not listener.connected())


def test_state_health_and_token_are_heard() -> None:
    """What a gateway says arrives with key, encoding and payload as they were sent, and nothing else does."""
    with FakeGateway("cruiser-1") as gateway, RobotListener.open(settings_for(gateway.listen)) as listener:
        heard: list[Heard] = []
        state = Received("fleet/cruiser-1/state", BY_NAME["state"].encoding, codec.encode(STATE))

        def speak() -> None:
            gateway.say(STATE)
            gateway.say(HEALTH)
            gateway.say_raw("chassis/gear", b"", "")
            heard.extend(listener.drain())

        wanted = [state, HEALTH_SAMPLE, TokenChange("fleet/cruiser-1/gateway", present=True)]
        wait_until(lambda: all(one in heard for one in wanted), speak)
        assert all(one in wanted for one in heard)


def test_the_last_health_reaches_whoever_comes_later() -> None:
    """A health that was said before the listener was there is heard all the same, once."""
    with FakeGateway("cruiser-1") as gateway:
        gateway.say(HEALTH)
        with RobotListener.open(settings_for(gateway.listen)) as listener:
            heard: list[Heard] = []
            wait_until(lambda: HEALTH_SAMPLE in heard, lambda: heard.extend(listener.drain()))


def test_the_last_health_of_a_gateway_that_comes_later_is_heard() -> None:
    """A health that was said before the link stood is heard when it does, whoever was there first."""
    endpoint = free_endpoint()
    with (
        RobotListener.open(settings_for(endpoint)) as listener,
        FakeGateway("cruiser-1", listen=endpoint) as gateway,
    ):
        gateway.say(HEALTH)
        heard: list[Heard] = []
        wait_until(lambda: HEALTH_SAMPLE in heard, lambda: heard.extend(listener.drain()))


def test_a_token_that_goes_is_heard() -> None:
    """When a gateway leaves, its token goes, and that is heard."""
    endpoint = free_endpoint()
    with RobotListener.open(settings_for(endpoint), "cruiser-1") as listener:
        heard: list[Heard] = []

        def listen() -> None:
            heard.extend(listener.drain())

        with FakeGateway("cruiser-1", listen=endpoint):
            wait_until(lambda: TokenChange("fleet/cruiser-1/gateway", present=True) in heard, listen)
        wait_until(lambda: TokenChange("fleet/cruiser-1/gateway", present=False) in heard, listen)


def test_a_robot_behind_another_is_found() -> None:
    """Several robots on one bench: who connects to the first one's node also hears the second, by gossip."""
    with (
        FakeGateway("cruiser-1") as first,
        FakeGateway("cruiser-2", connect=first.listen) as second,
        RobotListener.open(settings_for(first.listen)) as listener,
    ):
        keys: set[str] = set()

        def speak() -> None:
            second.say(STATE)
            keys.update(heard.key for heard in listener.drain())

        wait_until(lambda: {"fleet/cruiser-2/gateway", "fleet/cruiser-2/state"} <= keys, speak)


def test_one_robot_is_heard_without_the_others() -> None:
    """A listener for one robot hears nothing of another."""
    with (
        FakeGateway("cruiser-1") as first,
        FakeGateway("cruiser-2", connect=first.listen) as second,
        RobotListener.open(settings_for(first.listen), "cruiser-2") as listener,
    ):
        heard: list[Heard] = []

        def speak() -> None:
            first.say(STATE)
            first.say(HEALTH)
            second.say(STATE)
            heard.extend(listener.drain())

        wait_until(lambda: len(heard) >= 3, speak)
        assert {one.key for one in heard} <= {"fleet/cruiser-2/state", "fleet/cruiser-2/gateway"}
