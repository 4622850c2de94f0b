import socket
from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import msgspec
import pytest
import zenoh

from gateway.telemetry.samples import Arrival, Missed, Received, TokenChange
from gateway.zenoh import client as zenoh_client
from gateway.zenoh.client import PendingQuery, RobotListener, call_roll, open_local_router, receive
from gateway.zenoh.operator import CommandPort
from schemas import codec, keys
from schemas.command_line import CommandError, ExitCode
from schemas.settings import RobotSettings, Settings, ZenohSettings
from schemas.subjects import BY_NAME
from schemas.zenoh_session import client_endpoints, close_session, open_session, split_endpoint
from tests.support.fakes.fleet import FakeFleet
from tests.support.fakes.gateway import FakeGateway
from tests.support.fakes.peer import free_endpoint
from tests.support.fakes.robot import FakeRobot
from tests.support.messages import HEALTH
from tests.support.waiting import wait_until

HEALTH_SAMPLE = Received(
    "fleet/cruiser-1/gateway/health", BY_NAME["gateway/health"].encoding, codec.encode(HEALTH)
)

NEXT_HEALTH = msgspec.structs.replace(HEALTH, sequence=1)
TOKEN = TokenChange("fleet/cruiser-1/gateway", present=True)

VOLLEYS, VOLLEY = 40, 5


def settings_for(*endpoints: str) -> Settings:
    return Settings(zenoh=ZenohSettings(connect=list(endpoints)))


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
    with pytest.raises(CommandError) as caught:
        close_session(open_session(settings, client_endpoints(settings), []))
    assert caught.value.code is code
    assert str(caught.value).isprintable()
    assert ".rs" not in str(caught.value)


def test_a_health_of_before_is_not_heard() -> None:
    """It may be from before the gateway hung."""
    newer = Received(HEALTH_SAMPLE.key, HEALTH_SAMPLE.encoding, codec.encode(NEXT_HEALTH))
    with FakeGateway("cruiser-1", caches_health=True) as gateway:
        gateway.say(HEALTH)
        with RobotListener.open(settings_for(gateway.listen)) as listener:
            heard: list[Arrival] = []
            wait_until(lambda: TOKEN in heard, lambda: heard.extend(listener.drain()))

            def speak() -> None:
                gateway.say(NEXT_HEALTH)
                heard.extend(listener.drain())

            wait_until(lambda: newer in heard, speak)
            assert HEALTH_SAMPLE not in heard


ROOM = 1000  # more than the 256 replies of a channel of Zenoh's


class Pair(NamedTuple):
    answerer: zenoh.Session
    asker: zenoh.Session


@pytest.fixture
def pair() -> Iterator[Pair]:
    listen = free_endpoint()
    answerer = open_session(ZenohSettings(), [], [listen])
    asker = open_session(ZenohSettings(), [listen], [])
    yield Pair(answerer, asker)
    close_session(asker)
    close_session(answerer)


def test_a_flood_of_replies_holds_nothing_up(monkeypatch: pytest.MonkeyPatch, pair: Pair) -> None:
    answerer, asker = pair
    count = 2 * ROOM
    monkeypatch.setattr(zenoh_client, "REPLIES_WAITING", ROOM)

    def flood(query: zenoh.Query) -> None:
        with query:
            for number in range(count):
                query.reply("flood", b"%d" % number)

    with answerer.declare_queryable("flood", zenoh.handlers.Callback(flood, indirect=False), complete=True):
        first, second = PendingQuery(), PendingQuery()
        querier: Any = asker.declare_querier(
            "flood", congestion_control=zenoh.CongestionControl.BLOCK, consolidation=zenoh.ConsolidationMode.NONE
        )
        wait_until(lambda: bool(querier.matching_status.matching))
        for question in (first, second):
            querier.get(handler=question.handler)
        wait_until(lambda: bool(first._ended and second._ended))
        for question in (first, second):
            assert [one.payload for one in question.poll()] == [b"%d" % n for n in range(count // 2, count)]
            assert question.is_over
            assert not question.timed_out


def test_a_question_that_ran_out_of_time_says_so(pair: Pair) -> None:
    answerer, asker = pair
    with answerer.declare_queryable("mute", zenoh.handlers.RingChannel(1), complete=True) as mute:
        question = PendingQuery()
        querier: Any = asker.declare_querier("mute", timeout=0.1)
        wait_until(lambda: bool(querier.matching_status.matching))
        querier.get(handler=question.handler)
        wait_until(lambda: question.poll() == [] and question.is_over)
        assert question.timed_out
        assert mute.try_recv() is not None
    roll = call_roll(asker, "nobody/*", 20)
    wait_until(lambda: roll.poll() == [] and roll.is_over)
    assert not roll.timed_out


def test_who_publishes_faster_than_is_read_keeps_no_reader_for_ever(pair: Pair) -> None:
    with pair.asker.declare_subscriber("x", zenoh.handlers.FifoChannel(1)) as subscriber:
        pair.asker.put("x", b"")
        sample = subscriber.recv()
    *samples, last = receive(lambda: sample, 8)
    assert (len(samples), last) == (8, Missed())


def test_a_ring_that_ran_over_says_that_samples_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zenoh_client, "SAMPLES_WAITING", 8)
    listen = free_endpoint()
    with RobotListener(open_session(ZenohSettings(), [], [listen]), RobotSettings()) as listener:
        for count, expected in ((7, []), (9, [Missed()])):
            for _ in range(count):
                listener._session.put("fleet/cruiser-1/state", b"")
            assert [one for one in listener.drain() if isinstance(one, Missed)] == expected


def test_commands_that_follow_each_other_closely_all_arrive() -> None:
    """Zenoh's defaults drop most of them."""
    with FakeRobot() as fake, CommandPort.open(settings_for(fake.listen), fake.name, "first") as port:
        wait_until(port.reaches)
        for volley in range(1, VOLLEYS + 1):
            for _ in range(VOLLEY):
                port.put("drive", b"")
            wait_until(partial(fake.has_heard, VOLLEY * volley))


def test_of_a_large_fleet_every_reply_arrives() -> None:
    """Replies in one burst share Zenoh's batches."""
    with FakeFleet(1000) as fleet, CommandPort.open(settings_for(fleet.listen), keys.ALL, "first") as port:
        wait_until(lambda: count_replies(port.call_roll(20)) == len(fleet.names))
        assert count_replies(port.begin("stop", b"", 20)) == len(fleet.names)


def count_replies(question: PendingQuery) -> int:
    found: list[Received] = []
    wait_until(lambda: question.is_over, lambda: found.extend(question.poll()))
    return len(found)


def test_beside_a_router_no_commands_are_sought() -> None:
    """A port that swallows connections would hold the session up, and with it the first stop."""
    endpoint = free_endpoint()
    router = open_local_router(endpoint)
    with socket.create_server(("127.0.0.1", split_endpoint(endpoint)[2] + 1)) as beside:
        beside.settimeout(0)
        with CommandPort.open(settings_for(endpoint), "cruiser-1", "first", lasts=True) as port:
            assert port.connected()
            with pytest.raises(BlockingIOError):
                beside.accept()
    close_session(router)
