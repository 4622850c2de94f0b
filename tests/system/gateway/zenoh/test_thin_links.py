"""Telemetry over a thin link: profiles, and priorities on a full link."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from random import Random
from statistics import median
from time import monotonic
from typing import Final, NamedTuple

import pytest
import zenoh

from gateway.command.flow import PendingReply
from gateway.zenoh.client import open_local_router
from gateway.zenoh.inbox import CommandInbox, open_inbox
from gateway.zenoh.node import ZenohNode, open_node
from gateway.zenoh.operator import CommandPort
from schemas.codec import Sample
from schemas.settings import PUBLISHED, Settings, ZenohSettings
from schemas.subjects import KEPT_FIRST
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.links import LINKS
from tests.support.nights import by_night
from tests.support.processes.tcp_link import TcpLink
from tests.support.waiting import wait_until

LTE: Final = next(link for link in LINKS if link.name == "LTE bad")
BYTES_PER_S: Final = 62_500  # an uplink of 0.5 Mbit/s

STATE, DECISION = "safety/state", "safety/decision"
REPLIES: Final = "replies of the journal"
STATE_BYTES: Final = 780
FLOOD_BYTES: Final = 1500
INFO_BYTES: Final = 120_000
FLOOD: Final = 20  # samples beside each state: some thirty times what the link takes at 50 ms


class Thin(NamedTuple):
    """A robot behind a thin uplink, and a listener on the far side.

    Attributes:
        late_s: time of publication and latency of each sample, by subject.
    """

    link: TcpLink
    node: ZenohNode
    inbox: CommandInbox
    operator: CommandPort
    listening: zenoh.Session
    late_s: dict[str, list[tuple[float, float]]]

    def publish(self, subject: str, size: int) -> None:
        """Publish a sample that contains its time."""
        self.node.publish(Sample(subject, f"{monotonic():020.9f}".encode().ljust(size)))


def settings(endpoint: str, *profiles: str) -> Settings:
    zenoh = ZenohSettings(mode="client", connect=[endpoint], given=frozenset({"mode"}), profiles=list(profiles))
    return Settings(zenoh=zenoh)


@pytest.fixture
def thin() -> Iterator[Thin]:
    endpoint = free_endpoint()
    late_s: dict[str, list[tuple[float, float]]] = {}

    def note(sample: zenoh.Sample) -> None:
        published_s = float(sample.payload.to_bytes()[:20])
        subject = str(sample.key_expr).removeprefix("fleet/cruiser-1/")
        late_s.setdefault(subject, []).append((published_s, monotonic() - published_s))

    with ExitStack() as stack:
        stack.callback(open_local_router(endpoint).close)
        random = Random(1)  # noqa: S311 - the same link each time
        link = stack.enter_context(TcpLink(endpoint, lambda: LTE.delay_s(random), up_bytes_per_s=BYTES_PER_S))
        robot = settings(link.endpoint, "lo=operator")
        node, place = open_node(robot)
        stack.callback(node.close)
        inbox = stack.enter_context(closing(open_inbox(robot, place)))
        listening = open_session(ZenohSettings(mode="client"), [endpoint], [])
        stack.callback(close_session, listening)
        subscribers = [listening.declare_subscriber(f"fleet/*/{name}", note) for name in (STATE, DECISION)]
        operator = stack.enter_context(closing(CommandPort.open(settings(endpoint), "cruiser-1", "alice")))
        wait_until(operator.reaches)
        made = Thin(link, node, inbox, operator, listening, late_s)
        wait_until(lambda: late_s.keys() == {STATE, DECISION}, lambda: publish_all(made))
        late_s.clear()
        yield made
        del subscribers


def publish_all(thin: Thin) -> None:
    for subject in (STATE, DECISION):
        thin.publish(subject, STATE_BYTES)


def flooding(thin: Thin) -> Callable[[], None]:
    """Publish a state each 50 ms, and more samples of lower priority than the link can take."""
    due_s = monotonic()

    def publish() -> None:
        nonlocal due_s
        if monotonic() >= due_s:
            due_s = monotonic() + 0.05
            thin.publish(STATE, STATE_BYTES)
            for _ in range(FLOOD):
                thin.publish(DECISION, FLOOD_BYTES)

    return publish


def test_the_arbiters_state_overtakes_what_fills_the_link(thin: Thin) -> None:
    publish = flooding(thin)
    wait_until(lambda: len(thin.late_s.get(STATE, [])) >= 120, publish)
    states, others = ([late for _, late in thin.late_s[subject][-60:]] for subject in (STATE, DECISION))
    assert median(states) < 0.75 * median(others)
    lost = 1 - len(thin.late_s[DECISION]) / (FLOOD * len(thin.late_s[STATE]))
    assert lost > 0.5, "the link was not full"


def test_a_stop_and_its_reply_wait_for_nothing_that_fills_the_link(thin: Thin) -> None:
    publish = flooding(thin)
    wait_until(lambda: len(thin.late_s.get(DECISION, [])) >= 150, publish)
    asked_s = monotonic()
    question = thin.operator.begin("stop", b"", 30.0)
    came_s: list[float] = []

    def serve() -> None:
        publish()
        for request in thin.inbox.drain(""):
            came_s.append(monotonic())
            thin.inbox.reply(PendingReply(request.handle, request.verb, b"\x80"))

    replied: list[object] = []

    def is_replied() -> bool:
        replied.extend(question.poll())
        return bool(replied)

    wait_until(is_replied, serve)
    newest_s = max(published_s for published_s, _ in thin.late_s[DECISION])
    assert newest_s < asked_s, "telemetry of before the stop was on its way when the reply had come"
    assert len(came_s) == 1


@pytest.mark.parametrize("priority", [by_night(zenoh.Priority.DATA), zenoh.Priority.DATA_LOW])
def test_who_the_gateway_is_still_fits_through(thin: Thin, priority: zenoh.Priority) -> None:
    channel: zenoh.handlers.FifoChannel[zenoh.Reply] = zenoh.handlers.FifoChannel(4)
    replies = thin.listening.get(
        "fleet/cruiser-1/gateway/info",
        channel,
        timeout=50,
        priority=priority,
        congestion_control=zenoh.CongestionControl.DROP,
    )
    came: list[zenoh.Reply] = []

    def is_there() -> bool:
        thin.node.answer(lambda: bytes(INFO_BYTES))
        came.extend(filter(None, [replies.try_recv()]))
        return bool(came)

    wait_until(is_there)
    assert came[0].ok is not None
    assert len(came[0].ok.payload) == INFO_BYTES


def counts(endpoint: str, *profiles: str) -> Counter[str]:
    """Count the samples of each subject over a link in two seconds, and the replies."""
    robot = Settings(zenoh=ZenohSettings(listen=[endpoint], profiles=list(profiles)))
    found: Counter[str] = Counter()
    with ExitStack() as stack:
        node, _ = open_node(robot)
        stack.callback(node.close)
        session = open_session(ZenohSettings(mode="client"), [endpoint], [])
        stack.callback(close_session, session)
        subscriber = session.declare_subscriber("fleet/cruiser-1/**", zenoh.handlers.RingChannel(100_000))
        # No profile leaves out events: one says that both are linked, another one that all has come.
        wait_until(
            lambda: subscriber.try_recv() is not None, lambda: node.publish(Sample("safety/event", b"begin"))
        )
        begin_s = monotonic()

        def publish() -> None:
            for subject in PUBLISHED:
                node.publish(Sample(subject.name, b"counted"))

        wait_until(lambda: monotonic() - begin_s > 2, publish)
        came: set[bytes] = set()

        def is_through() -> bool:
            while (sample := subscriber.try_recv()) is not None:
                came.add(sample.payload.to_bytes())
                if sample.payload.to_bytes() == b"counted":
                    found[str(sample.key_expr).removeprefix("fleet/cruiser-1/")] += 1
            return b"end" in came

        wait_until(is_through, lambda: node.publish(Sample("safety/event", b"end")))
        found[REPLIES] = replies_of_the_journal(session, node)
    return found


def replies_of_the_journal(session: zenoh.Session, node: ZenohNode) -> int:
    channel: zenoh.handlers.FifoChannel[zenoh.Reply] = zenoh.handlers.FifoChannel(100)
    replies = session.get(f"fleet/cruiser-1/journal?{KEPT_FIRST}=0", channel, timeout=2)
    answered = 0

    def is_answered() -> bool:
        nonlocal answered
        node.answer(lambda: b"")
        try:
            while (reply := replies.try_recv()) is not None:
                answered += reply.ok is not None
        except zenoh.ZError:  # No more will come.
            return True
        return False

    wait_until(is_answered)
    return answered


def test_zenoh_leaves_out_what_a_profile_says_on_its_interface_alone() -> None:
    whole = counts(free_endpoint(), "wwan0=thin")
    assert len(whole) == len(PUBLISHED) + 1
    assert whole[REPLIES]
    operator = counts(free_endpoint(), "lo=operator")
    assert operator.keys() - {REPLIES} == {
        *("state", "safety/state", "safety/decision", "safety/event"),
        *("authority/statement", "gateway/health", "chassis/odometry"),
    }
    assert operator[REPLIES] == 0
    assert operator["safety/decision"] == operator["safety/event"] > 2 * operator["state"] > 0
    assert operator["safety/event"] > operator["safety/state"] > operator["state"]
    thin = counts(free_endpoint(), "*=thin")
    assert thin.keys() - {REPLIES} == {
        *("state", "safety/state", "safety/event", "authority/statement", "gateway/health"),
        "chassis/odometry",
    }
    assert thin["safety/event"] > 5 * thin["state"] > 0
    assert thin["state"] >= thin["gateway/health"] > 0
