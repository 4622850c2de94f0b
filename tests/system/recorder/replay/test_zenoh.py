"""A log's samples on a real Zenoh, on the loopback."""

from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest
import zenoh

from recorder.replay import ReplaySample, ZenohOutlet
from schemas import keys, zenoh_session
from schemas.decisions import SafetyEvent, SafetyState
from schemas.messages import CanFrames, Gear
from schemas.settings import ZenohSettings
from schemas.subjects import BY_TYPE
from tests.support.drives import STEP_NS
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.messages import SECOND, WALL_NS, gear
from tests.support.waiting import wait_until

GEAR = BY_TYPE[Gear]


def never() -> bool:
    return False


def gear_sample(number: int) -> ReplaySample:
    time_ns = WALL_NS + number * STEP_NS
    return ReplaySample(time_ns, "replay/cruiser-1/chassis/gear", GEAR.encoding, GEAR, gear(number, time_ns))


@contextmanager
def outlet_at(endpoint: str, *, waits: bool = True) -> Iterator[ZenohOutlet]:
    with closing(ZenohOutlet(ZenohSettings(connect=[endpoint]), "replay", waits=waits)) as outlet:
        assert outlet.wait_for_link(20, never)
        yield outlet


@pytest.fixture
def peer() -> Iterator[tuple[Peer, str]]:
    endpoint = free_endpoint()
    with Peer(endpoint) as one:
        yield one, endpoint


Received = zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]


def subscribe(peer: Peer, expression: str = "replay/**") -> Received:
    return peer.session.declare_subscriber(expression, zenoh.handlers.FifoChannel(10_000))


def received(subscriber: Received, count: int) -> list[zenoh.Sample]:
    found: list[zenoh.Sample] = []

    def are_there() -> bool:
        while (sample := subscriber.try_recv()) is not None:
            found.append(sample)
        return len(found) >= count

    wait_until(are_there)
    return found


def test_the_quality_of_service_is_that_of_the_subject(peer: tuple[Peer, str]) -> None:
    one, endpoint = peer
    subscriber = subscribe(one)
    for waits, congestion in ((True, zenoh.CongestionControl.BLOCK), (False, zenoh.CongestionControl.DROP)):
        with outlet_at(endpoint, waits=waits) as outlet:
            assert outlet.wait_for_subscriber(20, never)
            for kind in (Gear, SafetyEvent, CanFrames, SafetyState):
                subject = BY_TYPE[kind]
                outlet.send(ReplaySample(0, f"replay/{kind.__name__}", subject.encoding, subject, gear(1)), 0)
        found = received(subscriber, 4)
        assert {str(sample.key_expr): sample.priority for sample in found} == {
            "replay/Gear": zenoh.Priority.DATA,
            "replay/SafetyEvent": zenoh.Priority.DATA_HIGH,
            "replay/CanFrames": zenoh.Priority.DATA_LOW,
            "replay/SafetyState": zenoh.Priority.INTERACTIVE_HIGH,
        }
        assert [str(sample.key_expr) for sample in found if sample.express] == ["replay/SafetyState"]
        assert all(sample.congestion_control == congestion for sample in found)


def test_a_sample_that_was_kept_is_sent_as_it_was(peer: tuple[Peer, str]) -> None:
    one, endpoint = peer
    subscriber = subscribe(one)
    with outlet_at(endpoint) as outlet:
        assert outlet.wait_for_subscriber(20, never)
        outlet.send(
            ReplaySample(0, "replay/x", "text/plain", raw=b"\0hello", attachment=b"with this"), 10 * SECOND
        )
        outlet.send(ReplaySample(0, "replay/x", "zenoh/bytes", is_delete=True), 0)
        kept, gone = received(subscriber, 2)
    assert kept.payload.to_bytes() == b"\0hello"
    assert str(kept.encoding) == "text/plain"
    assert kept.attachment is not None
    assert kept.attachment.to_bytes() == b"with this"
    assert gone.kind == zenoh.SampleKind.DELETE


def test_a_key_that_zenoh_does_not_take_is_counted(peer: tuple[Peer, str]) -> None:
    _, endpoint = peer
    with outlet_at(endpoint) as outlet:
        outlet.send(ReplaySample(0, "replay//x", "text/plain", raw=b""), 0)
        outlet.send(gear_sample(0), 0)
        assert (outlet.sent, outlet.failed) == (1, 1)


def test_no_token_is_declared_and_no_query_answered(peer: tuple[Peer, str]) -> None:
    one, endpoint = peer
    subscriber = subscribe(one)
    with outlet_at(endpoint) as outlet:
        assert outlet.wait_for_subscriber(20, never)
        outlet.send(gear_sample(0), 0)
        received(subscriber, 1)
        assert list(one.session.liveliness().get("**", timeout=0.5)) == []
        assert list(one.session.get("replay/**", timeout=0.5)) == []


def test_where_it_only_listens_it_is_a_network_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    machine, here = free_endpoint(), free_endpoint()
    monkeypatch.setattr(zenoh_session, "DEFAULT_ENDPOINT", machine)
    with (
        Peer(machine) as gateway,
        closing(ZenohOutlet(ZenohSettings(listen=[here]), "replay", waits=True)) as outlet,
        zenoh_session.join(ZenohSettings(connect=[here]), [free_endpoint()]) as robot,
        zenoh_session.join(ZenohSettings(connect=[here])) as viewer,
    ):
        token = robot.liveliness().declare_token(keys.liveliness("fleet", "cruiser-1"))
        wait_until(lambda: bool(robot.info.peers_zid()) and bool(viewer.info.peers_zid()))
        subscriber = viewer.declare_subscriber("replay/**", zenoh.handlers.FifoChannel(10))
        assert outlet.wait_for_subscriber(20, never)
        outlet.send(gear_sample(0), 0)
        received(subscriber, 1)
        assert list(viewer.liveliness().get(keys.ANY_TOKEN, timeout=1)) == []
        assert [len(one.info.peers_zid()) for one in (robot, viewer, gateway.session)] == [1, 1, 0]
        token.undeclare()
