"""Requests from Zenoh, with real sessions on the loopback."""

import itertools
import tracemalloc
from collections.abc import Iterator
from contextlib import closing
from typing import Any, Literal

import msgspec
import pytest
import zenoh

from gateway.command.flow import PendingReply
from gateway.command.rulings import RawRequest
from gateway.telemetry.samples import Received
from gateway.zenoh import inbox as zenoh_inbox
from gateway.zenoh.client import PendingQuery, declare_events, open_local_router, receive
from gateway.zenoh.inbox import (
    DRIVES_WAITING,
    STOPS_WAITING,
    VERBS_WAITING,
    CommandInbox,
    Joined,
    LateInbox,
    LateNode,
    open_inbox,
)
from gateway.zenoh.node import ZenohPlace, client_place, open_node
from schemas.codec import Sample
from schemas.command_line import CommandError
from schemas.settings import (
    DRIVES_PER_TICK,
    REQUEST_MAX_BYTES,
    STOPS_PER_TICK,
    VERBS_PER_TICK,
    RobotSettings,
    Settings,
    ZenohSettings,
)
from schemas.subjects import BY_NAME, BY_VERB, COMMANDS, KEPT_FIRST, STOP_VERB, Asking, Command
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.newer import newer
from tests.support.requests import REQUESTS
from tests.support.waiting import wait_until

ROBOT = "fleet/cruiser-1/@cmd/"
ENOUGH = 10_000_000  # a payload of this many bytes would show in the memory


class Bench:
    """An inbox, and a client's session connected to it."""

    def __init__(self, mode: str = "client") -> None:
        self.endpoint = free_endpoint()
        session = open_session(ZenohSettings(), [], [self.endpoint])
        self.inbox = CommandInbox(session, Settings())
        asking = ZenohSettings(mode=mode, connect=[self.endpoint])  # type: ignore[arg-type]
        self.asker = open_session(asking, [self.endpoint], [])
        self.got: list[RawRequest] = []
        self._probes = itertools.count()

    def close(self) -> None:
        close_session(self.asker)
        self.inbox.close()

    def drain(self, holder: str = "", lease: int = 0, after: int = -1) -> None:
        self.got += self.inbox.drain(holder, lease, after)

    def wait_for(self, count: int) -> list[RawRequest]:
        wait_until(lambda: len(self.got) >= count, self.drain)
        return self.got

    def settle(self) -> None:
        """Wait until all earlier puts have arrived, without a tick: queries keep their order."""
        key = f"probe/{next(self._probes)}"
        with self.inbox._session.declare_queryable(key, zenoh.handlers.RingChannel(1)) as probe:
            wait_until(lambda: probe.try_recv() is not None, lambda: self.ask_nowhere(key))

    def ask_nowhere(self, key: str) -> None:
        self.asker.get(key, zenoh.handlers.RingChannel(1), timeout=5)

    def ask(self, key: str, payload: bytes = b"", encoding: str | None = None) -> Any:  # noqa: ANN401 - Zenoh's own handler
        return self.asker.get(key, payload=payload, encoding=encoding, timeout=5)

    def answer(self, requests: list[RawRequest], payload: bytes = b"yes") -> None:
        for request in requests:
            self.inbox.reply(PendingReply(request.handle, request.verb, payload))


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    reach(made)
    yield made
    made.close()


def reach(made: Bench) -> None:
    wait_until(lambda: bool(made.inbox.drain("")), lambda: made.asker.put(f"{ROBOT}probe/drive", b""))
    made.settle()
    while made.inbox.drain(""):
        pass


def replies(receiver: Any) -> list[tuple[str, bytes, str]]:  # noqa: ANN401 - Zenoh's own handler
    return [
        (str(reply.ok.key_expr), reply.ok.payload.to_bytes(), str(reply.ok.encoding))
        for reply in receiver
        if reply.ok is not None
    ]


@pytest.mark.parametrize("mode", ["client", "peer"])
def test_whoever_connects_reaches_it(mode: str) -> None:
    with closing(Bench(mode)) as made:
        reach(made)
        made.asker.put(f"{ROBOT}first/drive", b"abc")
        asked = made.ask(f"{ROBOT}first/acquire", b"xyz")
        got = sorted(made.wait_for(2), key=lambda request: request.verb)
        assert [(one.verb, one.operator, one.payload, one.size) for one in got] == [
            ("acquire", "first", b"xyz", 3),
            ("drive", "first", b"abc", 3),
        ]
        assert [request.is_query for request in got] == [True, False]
        made.answer(got[:1])
        assert replies(asked) == [(f"{ROBOT}first/acquire", b"yes", BY_VERB["acquire"].reply_encoding)]


@pytest.mark.parametrize("key", [f"{ROBOT}op/stop", "fleet/*/@cmd/op/stop", "*/*/@cmd/op/stop"])
def test_a_stop_comes_as_a_put_and_as_a_query(bench: Bench, key: str) -> None:
    bench.asker.put(key, b"\xff" * 100)
    assert [(one.verb, one.operator, one.handle) for one in bench.wait_for(1)] == [("stop", "op", 0)]
    bench.got.clear()
    asked = bench.ask(key)
    (request,) = bench.wait_for(1)
    assert (request.verb, request.operator, request.is_query) == ("stop", "op", True)
    bench.answer([request])
    assert replies(asked) == [(f"{ROBOT}op/stop", b"yes", BY_VERB["stop"].reply_encoding)]


def test_stops_come_first_and_verbs_before_drives(bench: Bench) -> None:
    bench.asker.put(f"{ROBOT}first/drive", b"1")
    asked = [bench.ask(f"{ROBOT}first/acquire"), bench.ask(f"{ROBOT}first/stop")]
    bench.asker.put(f"{ROBOT}first/stop", b"")
    bench.settle()
    assert [one.verb for one in bench.wait_for(4)] == ["stop", "stop", "acquire", "drive"]
    assert len(asked) == 2


LEASE = 4711


def leased(lease: int = LEASE, **fields: object) -> bytes:
    """A request with a lease number, by default the holder's."""
    return msgspec.msgpack.encode({"lease": lease, "speed_mps": 0.2, **fields})


def flood_with(bench: Bench, operator: str, payload: bytes, between: list[bytes]) -> None:
    """Send 500 puts of an operator, with five of the holder's between them."""
    block = zenoh.CongestionControl.BLOCK
    for number in range(500):
        bench.asker.put(f"{ROBOT}{operator}/drive", payload, congestion_control=block)
        if number % 100 == 0:
            bench.asker.put(f"{ROBOT}first/drive", between[number // 100], congestion_control=block)
    bench.settle()


FORGED = {
    "another number": leased(lease=LEASE + 1, seq=10**6),
    "the number of no lease": leased(lease=0, seq=10**6),
    "the last one again": leased(seq=7),
    "one of before": leased(seq=6, x=[[[[]]]]),
    "no sequence": leased(seq="8"),
    "no text": leased(x="\udcff".encode("utf-8", "surrogatepass"), seq=-(2**63)),
    "cut short": leased(seq=8)[:-1],
    "too large": leased(seq=8, x=b"x" * REQUEST_MAX_BYTES),
    "deep": b"\x91" * REQUEST_MAX_BYTES,
    "a negative number": b"\x81\xa5lease\xff",
    "nothing": b"",
}


@pytest.mark.parametrize("forged", FORGED.values(), ids=FORGED)
def test_the_holders_drives_survive_a_flood_under_its_name(bench: Bench, forged: bytes) -> None:
    mine = [leased(seq=number) for number in range(8, 13)]
    flood_with(bench, "first", forged, mine)
    bench.drain("first", LEASE, 7)
    assert [one.payload for one in bench.got[:5]] == mine
    assert len(bench.got) == 5 + DRIVES_PER_TICK


def test_the_holders_verbs_survive_a_flood_under_its_name(bench: Bench) -> None:
    asked = [bench.ask(f"{ROBOT}first/engage", leased())]
    asked += [bench.ask(f"{ROBOT}first/engage", leased(lease=1)) for _ in range(VERBS_WAITING // 2)]
    bench.settle()
    bench.drain("first", LEASE, 7)
    assert (bench.got[0].verb, bench.got[0].payload) == ("engage", leased())
    assert len(bench.got) == 1 + VERBS_PER_TICK
    assert len(asked) > VERBS_PER_TICK


@pytest.mark.parametrize(("holder", "other"), [("ana", "banana"), ("fleet", "x"), ("cruiser-1", "x")])
def test_an_operator_whose_name_holds_the_holders_is_another(bench: Bench, holder: str, other: str) -> None:
    """'banana' is not 'ana'; a holder may have the name of the root or of the robot."""
    for number in range(2 * DRIVES_PER_TICK):
        bench.asker.put(f"{ROBOT}{other}/drive", leased(seq=number))
    bench.asker.put(f"{ROBOT}{holder}/drive", leased(seq=1))
    bench.settle()
    bench.drain(holder, LEASE)
    assert bench.got[0].operator == holder
    assert len(bench.got) == 1 + DRIVES_PER_TICK


def test_no_flood_keeps_a_stop_out(bench: Bench) -> None:
    asked = []
    for number in range(DRIVES_WAITING + 500):
        bench.asker.put(f"{ROBOT}stranger/drive", b"x" * 100)
        if number % 5 == 0:
            asked.append(bench.ask(f"{ROBOT}stranger/engage"))
        if number == 100:
            bench.asker.put(f"{ROBOT}op/stop", b"")
    bench.settle()
    bench.drain()
    assert bench.got[0].verb == "stop"
    assert len(bench.got) <= 1 + VERBS_PER_TICK + DRIVES_PER_TICK
    assert len(asked) > VERBS_WAITING


def test_a_flood_of_stops_is_taken_in_portions(bench: Bench) -> None:
    for _ in range(STOPS_WAITING * 2):
        bench.asker.put(f"{ROBOT}op/stop", b"")
    bench.settle()
    portions = [len(bench.inbox.drain("")) for _ in range(STOPS_WAITING // STOPS_PER_TICK + 1)]
    assert portions == [STOPS_PER_TICK] * (STOPS_WAITING // STOPS_PER_TICK) + [0]


@pytest.mark.parametrize("verb", ["drive", "stop"])
def test_a_huge_payload_is_not_copied(bench: Bench, verb: str) -> None:
    huge = bytes(ENOUGH)
    tracemalloc.start()
    try:
        bench.asker.put(f"{ROBOT}first/{verb}", huge, congestion_control=zenoh.CongestionControl.BLOCK)
        bench.wait_for(1)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert [(one.payload, one.size) for one in bench.got] == [(b"", ENOUGH)]
    assert peak < ENOUGH / 10


@pytest.mark.parametrize(("size", "is_read"), [(REQUEST_MAX_BYTES, True), (REQUEST_MAX_BYTES + 1, False)])
def test_a_request_of_the_greatest_size_is_read(bench: Bench, size: int, is_read: bool) -> None:  # noqa: FBT001 - a case of the table
    bench.asker.put(f"{ROBOT}first/drive", b"x" * size)
    (request,) = bench.wait_for(1)
    assert (len(request.payload), request.size) == (size if is_read else 0, size)


ANY_VERB = [
    f"{ROBOT}first/*",
    f"{ROBOT}*/*",
    f"{ROBOT}**",
    f"{ROBOT}first/**",
    f"{ROBOT}first/s$*",
    "fleet/*/@cmd/**",
]


@pytest.mark.parametrize("key", [f"{ROBOT}*/acquire", *ANY_VERB])
def test_a_wildcard_for_verb_or_operator_is_no_verb_but_the_stop(bench: Bench, key: str) -> None:
    """It counts as a stop if its key matches one, and as nothing else."""
    asked = bench.ask(key)
    bench.settle()
    for _ in range(3):
        bench.drain()
    for request in bench.got:
        assert request.is_query
        assert request.verb == STOP_VERB or not request.operator
    assert [one.verb for one in bench.got if one.verb == STOP_VERB] == [STOP_VERB] * (key in ANY_VERB)
    bench.answer(bench.got)
    bench.inbox._queries.clear()
    assert len(replies(asked)) <= len(bench.got)


@pytest.mark.parametrize("key", ANY_VERB)
def test_what_names_any_verb_displaces_no_stop(bench: Bench, key: str) -> None:
    bench.asker.put(f"{ROBOT}op/stop", b"")
    asked = bench.ask(f"{ROBOT}op/stop")
    for _ in range(2 * STOPS_WAITING):
        bench.asker.put(key, b"")
        bench.ask_nowhere(key)
    bench.settle()
    bench.drain()
    assert {one.verb for one in bench.got[: 2 * STOPS_PER_TICK]} == {STOP_VERB}
    assert asked is not None


@pytest.mark.parametrize("key", ["fleet/**", "**", "*/**", "fleet/cruiser-1/**", "fleet/cruiser-1/*/first/stop"])
def test_no_wildcard_reaches_a_command_by_accident(bench: Bench, key: str) -> None:
    """@cmd is a verbatim chunk."""
    bench.asker.put(key, b"")
    asked = bench.ask(key)
    bench.settle()
    bench.drain()
    assert bench.got == []
    assert replies(asked) == []


def test_it_is_found_through_the_telemetry_session() -> None:
    settings = Settings(zenoh=ZenohSettings(listen=[free_endpoint()]), robot=RobotSettings(name="cruiser-1"))
    node, place = open_node(settings)
    with closing(node), closing(open_inbox(settings, place)) as inbox:
        modes: tuple[Literal["client", "peer"], ...] = ("client", "peer")
        for mode in modes:
            reach_from(open_session(ZenohSettings(mode=mode), settings.zenoh.listen, []), inbox)


def reach_from(session: zenoh.Session, inbox: CommandInbox) -> None:
    wait_until(lambda: bool(inbox.drain("")), lambda: session.put(f"{ROBOT}first/drive", b""))
    close_session(session)


def test_a_port_for_commands_that_is_taken_is_told() -> None:
    settings = Settings(zenoh=ZenohSettings(listen=[free_endpoint()]))
    node, place = open_node(settings)
    taken = open_session(ZenohSettings(), [], place.command_listen)
    with closing(node), pytest.raises(CommandError, match=rf"{place.command_listen[0]} \(zenoh.command_listen\)"):
        open_inbox(settings, place)
    close_session(taken)


def test_a_gateway_whose_sessions_do_not_meet_says_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(zenoh_inbox, "OWN_LINK_TIMEOUT_S", 0.1)
    place = ZenohPlace("another", [], [free_endpoint()], [free_endpoint()])
    with closing(open_inbox(Settings(), place)):
        assert "can neither command nor stop this robot" in caplog.text


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_a_command_of_another_version_says_so(bench: Bench, command: Command) -> None:
    key, payload = f"{ROBOT}first/{command.verb}", msgspec.msgpack.encode(REQUESTS[command.verb])
    encodings = [newer(command.encoding), newer(command.encoding, -1), command.encoding, "zenoh/bytes"]
    for encoding in encodings:
        if command.asking is Asking.PUT:
            bench.asker.put(key, payload, encoding=encoding)
        else:
            bench.ask(key, payload, encoding)
    faults = [request.fault for request in bench.wait_for(len(encodings))]
    if command.verb == STOP_VERB:
        assert faults == ["", "", "", ""]
        return
    version = command.request.version
    assert faults == [
        f"version {version + 1} of {command.schema_name}, and the gateway knows {version}: upgrade the gateway",
        f"version {version - 1} of {command.schema_name}, and the gateway knows {version}: upgrade the client",
        "",
        "",
    ]


def test_what_a_node_publishes_before_its_router_is_there_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The journal and events do; states do not."""
    monkeypatch.setattr(zenoh_inbox, "AGAIN_S", 0.01)
    endpoint = free_endpoint()
    settings = Settings(zenoh=ZenohSettings(mode="client", connect=[endpoint]))

    def join() -> Joined:
        node, place = open_node(settings)
        return node, open_inbox(settings, place)

    def info() -> bytes:
        return b"\x80"

    assert client_place(settings).connect == [endpoint]
    inbox = LateInbox()
    with closing(LateNode(join, inbox, "no answer")) as node, closing(inbox):
        for subject, payload in (("journal", b"\x01"), ("safety/event", b"\x02"), ("state", b"\x03")):
            node.publish(Sample(subject, payload))
        node.answer(info)
        assert (node.peers(), node.failures) == (0, 0)
        assert (inbox.drain(""), inbox.statements(), inbox.drops, inbox.inbox) == ([], [], 0, None)
        with (
            closing(open_local_router(endpoint)),
            open_session(ZenohSettings(mode="client"), [endpoint], []) as peer,
        ):
            events = declare_events(peer, "fleet/cruiser-1/safety/event", 10)
            states = peer.declare_subscriber("fleet/cruiser-1/state", zenoh.handlers.RingChannel(10))
            wait_until(lambda: node.peers() == 1, lambda: node.answer(info))
            assert node.notes() == ()
            assert inbox.inbox is not None
            received = list[object]()
            event = Received("fleet/cruiser-1/safety/event", BY_NAME["safety/event"].encoding, b"\x02")
            wait_until(lambda: event in received, lambda: received.extend(receive(events.try_recv, 1)))
            question, found = PendingQuery(), list[bytes]()
            peer.get(f"fleet/cruiser-1/journal?{KEPT_FIRST}=0", question.handler, timeout=10)

            def ask() -> None:
                node.answer(info)
                found.extend(one.payload for one in question.poll())

            wait_until(lambda: found == [b"\x01"], ask)
            node.publish(Sample("state", b"\x04"))
            wait_until(lambda: (one := states.try_recv()) is not None and one.payload.to_bytes() == b"\x04")
