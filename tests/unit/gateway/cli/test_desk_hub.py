"""Between Zenoh and the browsers: what each browser gets, and what goes out."""

import asyncio
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import wraps
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.cli.desk_server import (
    FAILED,
    LOOK_NS,
    QUESTIONS_MAX,
    REPLIES_MAX,
    SAMPLE_MAX_BYTES,
    STOPS_MAX,
    Browser,
    Hub,
    _serve,
)
from gateway.client.remote_stop import StopReport
from gateway.desk import words
from gateway.desk.fleet_view import BOUNDS, EVENT_MAX_BYTES
from gateway.telemetry.samples import Received
from schemas.messages import Message
from schemas.settings import Settings
from schemas.subjects import BY_VERB
from tests.support.fakes.desk import FakeCommandPort, FakeDeskListener
from tests.support.messages import HEALTH, SECOND, STANDBY, STATE, event, recorder_health
from tests.support.metrics import received


class Scene:
    def __init__(self) -> None:
        self.listener, self.port = FakeDeskListener(), FakeCommandPort()
        self.stops: list[tuple[str, str]] = []
        self.hub = Hub(Settings(), self.listener, self.port, self.stop)  # type: ignore[arg-type]
        self.now_ns = SECOND

    def stop(self, _settings: Settings, robot: str, operator: str, _timeout_s: float) -> StopReport:
        self.stops.append((robot, operator))
        return StopReport(["cruiser-1"], {}, {"cruiser-2": "its speed is unknown"}, ["cruiser-3"], linked=True)

    def step(self, *messages: Message, seconds: float = 0.25) -> None:
        self.listener.waiting += map(received, messages)
        self.now_ns += round(seconds * SECOND)
        self.hub.step(self.now_ns)

    def say(self, browser: Browser, **message: object) -> None:
        self.hub.receive(browser, msgspec.msgpack.encode(message))


def in_a_loop(test: Callable[[], Coroutine[Any, Any, None]]) -> Callable[[], None]:
    @wraps(test)
    def run() -> None:
        asyncio.run(asyncio.wait_for(test(), 60))

    return run


def told(browser: Browser, kind: type) -> list[Any]:
    return [one for one in browser.outbox.take() if isinstance(one, kind)]


def test_whoever_comes_is_told_all_and_then_what_changes() -> None:
    scene = Scene()
    scene.step(STATE, HEALTH)
    browser = scene.hub.join()
    hello, rows = browser.outbox.take()
    assert isinstance(hello, words.DeskHello)
    assert hello.requests["engage"] == (BY_VERB["engage"].encoding, BY_VERB["engage"].reply_encoding)
    assert isinstance(rows, words.DeskRows)
    assert set(rows.rows) == {"cruiser-1"}
    scene.step(STATE, HEALTH)
    assert [one.rows for one in told(browser, words.DeskRows)] == [{}]
    scene.step(msgspec.structs.replace(STATE, bus_up=False))
    assert told(browser, words.DeskRows)[0].rows["cruiser-1"].word == "bus_down"
    scene.hub.leave(browser)
    scene.step(STATE)
    assert told(browser, words.DeskRows) == []


def test_what_has_waited_while_the_desk_hung_is_not_current() -> None:
    scene = Scene()
    browser = scene.hub.join()
    scene.step(STATE, HEALTH)
    scene.say(browser, **{"is": "look", "robot": "cruiser-1"})
    scene.step(STATE, event(1), seconds=5.0)
    messages = browser.outbox.take()
    assert [one.subject for one in messages if isinstance(one, words.DeskSample)] == ["safety/event"]
    rows = [one.rows for one in messages if isinstance(one, words.DeskRows)]
    assert rows[-1]["cruiser-1"].word == "offline"  # type: ignore[union-attr]
    scene.step(STATE)
    assert told(browser, words.DeskRows)[0].rows["cruiser-1"].word == "telemetry"


def test_samples_go_to_whom_looks_at_their_robot() -> None:
    scene = Scene()
    near, far = scene.hub.join(), scene.hub.join()
    scene.step(event(1), STATE)
    scene.say(near, **{"is": "look", "robot": "cruiser-1"})
    assert [one.subject for one in told(near, words.DeskSample)] == ["safety/event"]
    signed = msgspec.structs.replace(received(STANDBY), attachment=b"signature")
    scene.listener.waiting.append(signed)
    scene.step(STATE)
    samples = {one.subject: one for one in told(near, words.DeskSample)}
    assert set(samples) == {"state", "safety/state"}
    assert samples["safety/state"] == words.DeskSample(
        "safety/state", signed.key, signed.encoding, signed.payload, b"signature"
    )
    assert told(far, words.DeskSample) == []


def test_what_is_signed_goes_out_as_it_is() -> None:
    scene = Scene()
    browser = scene.hub.join()
    scene.say(
        browser, **{"is": "drive", "robot": "cruiser-1", "operator": "ann", "payload": b"p", "attachment": b"a"}
    )
    assert scene.port.puts == [("fleet/cruiser-1/@cmd/ann/drive", "drive", b"p", b"a")]
    verb = {"is": "ask", "robot": "cruiser-1", "operator": "ann", "payload": b"q", "attachment": b"b"}
    scene.port.replies = [Received("k", "e", b"answer", b"proof")]
    scene.say(browser, number=7, verb="engage", **verb)
    assert scene.port.questions == [("fleet/cruiser-1/@cmd/ann/engage", BY_VERB["engage"].encoding, b"q", b"b")]
    scene.step()
    reply, last = told(browser, words.DeskReply)
    assert (reply.number, reply.payload, reply.attachment, reply.last) == (7, b"answer", b"proof", False)
    assert (last.number, last.last) == (7, True)
    scene.say(browser, **{"is": "show", "number": 8, "robot": "cruiser-1", "statement": b"s", "question": b"r"})
    assert scene.port.questions[-1] == ("fleet/cruiser-1/@auth", "text/plain", b"s", b"r")


def test_all_see_who_sees_to_an_alarm() -> None:
    scene = Scene()
    near, far = scene.hub.join(), scene.hub.join()
    scene.step(STATE, HEALTH)
    for browser in (near, far):
        browser.outbox.take()
    scene.say(far, **{"is": "acknowledge"}, robot="cruiser-1", word="in_control", operator="cat")
    scene.step(STATE, msgspec.structs.replace(STANDBY, lease_holder="ann"), HEALTH)
    for browser in (near, far):
        assert told(browser, words.DeskRows)[0].rows["cruiser-1"].acknowledged == "cat"


def test_what_cannot_be_done_is_said() -> None:
    scene = Scene()
    browser = scene.hub.join()
    scene.port.is_over = False
    verb = {"is": "ask", "robot": "cruiser-1", "operator": "ann", "payload": b"q", "attachment": b""}
    scene.say(browser, number=1, verb="fly", **verb)
    scene.hub.receive(browser, b"\xc1")
    scene.say(browser, **{"is": "acknowledge"}, robot="made-up", word="needs_reset", operator="bob")
    faults = [one.fault for one in told(browser, words.DeskRefused)]
    assert (len(faults), faults[0], faults[2]) == (3, "unknown verb 'fly'", "unknown robot made-up")
    for number in range(QUESTIONS_MAX + 1):
        scene.say(browser, number=number, verb="renew", **verb)
    scene.say(browser, number=0, verb="renew", **verb)
    assert len(scene.port.questions) == QUESTIONS_MAX
    assert len(told(browser, words.DeskRefused)) == 2


@in_a_loop
async def test_a_stop_that_fails_is_never_silent() -> None:
    scene = Scene()

    def fail(*_: object) -> StopReport:
        raise OSError("no file descriptors")

    scene.hub._stopper = fail
    browser = scene.hub.join()
    browser.outbox.take()
    scene.say(browser, **{"is": "stop", "robot": "cruiser-1", "operator": "ann"})
    browser.ready.clear()
    await asyncio.wait_for(browser.ready.wait(), 30)
    (refused,) = told(browser, words.DeskRefused)
    assert "no file descriptors" in refused.fault


@in_a_loop
async def test_who_stops_what_is_being_stopped_learns_the_same() -> None:
    scene = Scene()
    hold = threading.Event()

    def wait(*arguments: Any) -> StopReport:  # noqa: ANN401 - the stopper's own
        hold.wait(30)
        return scene.stop(*arguments)

    scene.hub._stopper = wait
    ann, bob = scene.hub.join(), scene.hub.join()
    for browser, operator in ((ann, "ann"), (bob, "bob"), (ann, "ann")):
        scene.say(browser, **{"is": "stop", "robot": "", "operator": operator})
    assert [key for key, *_ in scene.port.puts] == [f"fleet/*/@cmd/{one}/stop" for one in ("ann", "bob", "ann")]
    hold.set()
    for browser in (ann, bob):
        while not (outcome := told(browser, words.DeskStopped)):
            browser.ready.clear()
            await asyncio.wait_for(browser.ready.wait(), 30)
        (known,) = outcome
        assert (known.standing, known.silent) == (["cruiser-1"], ["cruiser-3"])
        assert known.unconfirmed == {"cruiser-2": "its speed is unknown"}
    assert scene.stops == [("*", "ann")]


@in_a_loop
async def test_a_browser_that_stops_too_many_is_told_that_it_learns_no_more() -> None:
    scene = Scene()
    hold = threading.Event()
    scene.hub._stopper = lambda *_: StopReport([], {}, {}, [], linked=hold.wait(30))
    browser = scene.hub.join()
    try:
        for number in range(STOPS_MAX + 1):
            scene.say(browser, **{"is": "stop", "robot": f"cruiser-{number}", "operator": "ann"})
        assert len(scene.port.puts) == STOPS_MAX + 1
        assert [one.stop for one in told(browser, words.DeskRefused)] == [f"cruiser-{STOPS_MAX}"]
    finally:
        hold.set()


def test_the_last_minutes_are_put_together_seldom() -> None:
    scene = Scene()
    scene.step(STATE)
    scene.listener.waiting += [received(STATE, "cruiser-2"), received(event(1), "cruiser-2")]
    scene.step()
    browser = scene.hub.join()
    for robot in ("cruiser-1", "cruiser-2", "cruiser-1", "cruiser-2"):
        scene.say(browser, **{"is": "look", "robot": robot})
    assert [one.robot for one in told(browser, words.DeskHistory)] == ["cruiser-1"]
    scene.step(seconds=LOOK_NS / SECOND)
    waiting = browser.outbox.take()
    assert [one.robot for one in waiting if isinstance(one, words.DeskHistory)] == ["cruiser-2"]
    assert [one.subject for one in waiting if isinstance(one, words.DeskSample)] == ["safety/event"]
    assert [one.robot for one in waiting if isinstance(one, words.DeskPose)] == ["cruiser-2"]
    scene.step(seconds=LOOK_NS / SECOND)
    assert told(browser, words.DeskHistory) == []


def test_what_is_larger_than_a_gateway_says_is_passed_over() -> None:
    """Otherwise samples under a robot's name could fill the memory of desk and browsers."""
    scene = Scene()
    browser = scene.hub.join()
    scene.say(browser, **{"is": "look", "robot": "cruiser-1"})
    scene.listener.waiting += [msgspec.structs.replace(received(STATE), attachment=bytes(SAMPLE_MAX_BYTES))]
    scene.step()
    assert told(browser, words.DeskSample) == []
    scene.step(STATE, event(1, text="x" * EVENT_MAX_BYTES), event(2))
    assert [one.payload for one in scene.hub._view.events("cruiser-1")] == [received(event(2)).payload]
    scene.port.replies = [Received("k", "e", bytes(SAMPLE_MAX_BYTES))] + [Received("k", "e", b"r")] * REPLIES_MAX
    question = {"is": "show", "number": 1, "robot": "cruiser-1", "statement": b"s", "question": b"r"}
    scene.port.is_over = False
    scene.say(browser, **question)
    for _ in range(REPLIES_MAX + 2):
        scene.step()
    assert len(told(browser, words.DeskReply)) == REPLIES_MAX - 1


def test_no_count_breaks_what_all_browsers_are_sent() -> None:
    scene = Scene()
    browser = scene.hub.join()
    most = 2**63 - 1
    feedback = [msgspec.structs.replace(HEALTH.feedback[0], lost=most)] * 3
    scene.step(STATE, msgspec.structs.replace(HEALTH, feedback=feedback))
    scene.step(msgspec.structs.replace(recorder_health(), missed=most, dropped={"disk": most, "queue": most}))
    rows = told(browser, words.DeskRows)
    assert [msgspec.msgpack.decode(words.encode(one))["is"] for one in rows] == ["rows"]


def test_everybody_is_told_where_not_all_robots_are_shown() -> None:
    scene = Scene()
    scene.step(STATE)
    browser = scene.hub.join()
    assert [one.full for one in told(browser, words.DeskRows)] == [False]
    scene.listener.waiting += [received(STATE, f"evil-{number}") for number in range(BOUNDS.robots)]
    scene.step()
    assert [one.full for one in told(browser, words.DeskRows)] == [True]
    assert [one.full for one in told(scene.hub.join(), words.DeskRows)] == [True]
    # Also where no row changes.
    scene.listener.waiting.append(received(STATE, "stranger"))
    scene.step()
    assert [(one.full, one.rows) for one in told(browser, words.DeskRows)] == [(True, {})]
    scene.step(seconds=11)
    assert [one.full for one in told(browser, words.DeskRows)] == [False]


@pytest.mark.parametrize("seen", [(), (STATE, HEALTH)], ids=["no robot", "a robot"])
def test_that_zenoh_is_gone_and_back_is_told_once(seen: tuple[Message, ...]) -> None:
    scene = Scene()
    scene.step(*seen)
    browser = scene.hub.join()
    browser.outbox.take()
    for linked in (False, True):
        scene.listener.linked = linked
        scene.step(seconds=2)
        (rows,) = told(browser, words.DeskRows)
        assert rows.linked is linked
        assert linked or [row and row.word for row in rows.rows.values()] == ["offline"] * bool(seen)
        scene.step()
        browser.outbox.take()


@pytest.mark.parametrize("robot", ["*", "**", "c$*", "../x", "cruiser-1/x", "@adv"])
def test_no_browser_asks_several_robots_at_once(robot: str) -> None:
    scene = Scene()
    browser = scene.hub.join()
    for kind in ({"is": "drive"}, {"is": "ask", "number": 1, "verb": "engage"}):
        scene.say(browser, robot=robot, operator="ann", payload=b"", attachment=b"", **kind)
    scene.say(browser, **{"is": "stop", "robot": robot, "operator": "ann"})
    assert scene.port.puts == []
    assert scene.port.questions == []


class FakeSocket:
    def __init__(self) -> None:
        self.closed: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    async def receive(self) -> dict[str, Any]:
        await self.closed
        return {"type": "websocket.disconnect"}

    async def send_bytes(self, _data: bytes) -> None:
        await asyncio.sleep(0)

    async def close(self, code: int) -> None:
        if not self.closed.done():
            self.closed.set_result(code)


@in_a_loop
async def test_a_browser_that_cannot_be_sent_a_message_is_cut_off() -> None:
    hub = Scene().hub
    socket = FakeSocket()
    serving = asyncio.create_task(_serve(socket, hub))  # type: ignore[arg-type]
    while not hub._browsers:  # noqa: ASYNC110 - nobody tells
        await asyncio.sleep(0)
    (browser,) = hub._browsers
    browser.tell(words.DeskReply(2**70, last=True))
    assert await socket.closed == FAILED
    await serving
    assert not hub._browsers


@given(st.binary(max_size=200))
def test_whatever_a_browser_sends_ends_nothing(data: bytes) -> None:
    scene = Scene()
    browser = scene.hub.join()
    with suppress(RuntimeError):  # A stop wants a running loop.
        scene.hub.receive(browser, data)
    scene.step(STATE)
