"""The run loop, with a fake source and a real directory."""

import time
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader

from recorder import loop as loop_module
from recorder.disk.files import LogDirectory
from recorder.disk.keeper import DiskUse
from recorder.disk.log_writer import LogWriter
from recorder.encoding.routes import keep_raw
from recorder.encoding.samples import ReceivedSample
from recorder.layouts.attached import COUNT as LAYOUTS
from recorder.loop import Recorded, RecorderLoop
from recorder.record import orders
from recorder.record.actions import Action, Deleted, DiskRoom, Notice
from recorder.record.orders import OperatorRequest
from recorder.record.recorder import HealthReport, Recorder, SampleInbox
from recorder.record.robot_log import LogPlan
from recorder.review.info import read_info
from schemas.decisions import EventKind
from schemas.messages import GatewayInfo, Gear, Message, Variant
from schemas.recording import (
    Mark,
    RecorderEvent,
    RecorderHealth,
    RecorderState,
    Status,
)
from schemas.requests import Request
from tests.support.fakes.recording import RECORDER_PLAN, FakeAsked, FakeSource
from tests.support.logs import PLAN, logs_in
from tests.support.messages import WALL_NS, FakeSample, gear, info, key_of, safety_event, sample_of

INFO_KEY = key_of(GatewayInfo)


def recorder(
    source: FakeSource,
    directory: Path,
    plan: LogPlan = PLAN,
    queue_bytes: int = 64_000_000,
    **more: Any,  # noqa: ANN401 - the loop's own arguments
) -> RecorderLoop:
    pure = Recorder(msgspec.structs.replace(RECORDER_PLAN, log=plan))
    writer = LogWriter(LogDirectory(directory), "test")
    return RecorderLoop(pure, source, writer, SampleInbox(queue_bytes), HealthReport("bench", "1", 0), **more)


def record(source: FakeSource, directory: Path, plan: LogPlan = PLAN) -> Recorded:
    return recorder(source, directory, plan).run(lambda: source.is_exhausted)


@pytest.fixture
def fast_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Advances ten seconds for each second."""
    clock = SimpleNamespace(
        monotonic_ns=lambda: 10 * time.monotonic_ns(),
        time_ns=time.time_ns,
        sleep=time.sleep,
        process_time_ns=lambda: 10 * time.process_time_ns(),
    )
    monkeypatch.setattr(loop_module, "time", clock)


def test_no_more_is_asked_than_the_source_has_room_for(tmp_path: Path) -> None:
    source = FakeSource([sample_of(gear(0))], {INFO_KEY: [sample_of(info())]})
    source.room = 0
    one = recorder(source, tmp_path)
    one._step()
    assert source.asked == []
    source.room = 1
    recorded = one.run(lambda: source.is_exhausted)
    assert source.asked == [INFO_KEY]
    found = read_info(Path(recorded.path or ""))
    assert found.variants == {"cruiser-1": "coarse"}
    assert len(found.attachments) == 2 + LAYOUTS


@pytest.mark.usefixtures("fast_clock")
def test_while_samples_wait_one_thing_is_asked_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = FakeSource(sample_of(gear(number), f"r-{number % 100}") for number in range(10**9))
    one = recorder(source, tmp_path, queue_bytes=1_000_000)
    asked: list[int] = []
    ask = one._recorder.ask

    def watched(now_ns: int, most: int) -> Sequence[Action]:
        asked.append(most)
        return ask(now_ns, most)

    monkeypatch.setattr(one._recorder, "ask", watched)
    one.run(lambda: len(source.asked) >= 5)
    assert 1 in asked[:5]
    assert set(asked[1:5]) == {1}


def test_a_robot_that_did_not_know_its_variant_is_asked_at_the_end(tmp_path: Path) -> None:
    replies = [sample_of(info(Variant.UNKNOWN, dbc="")), sample_of(info())]
    source = FakeSource((sample_of(gear(number)) for number in range(5000)), {INFO_KEY: replies})
    found = read_info(Path(record(source, tmp_path).path or ""))
    assert source.asked == [INFO_KEY, INFO_KEY]
    assert found.variants == {"cruiser-1": "coarse"}
    assert len(found.attachments) == 2 + LAYOUTS


def test_a_fault_of_our_own_leaves_a_readable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_module, "PASS_NS", 10**12)

    def stopped() -> Callable[[], bool]:
        passes = iter([False, False])
        return lambda: next(passes)

    source = FakeSource(sample_of(gear(number)) for number in range(3000))
    one = recorder(source, tmp_path, LogPlan("x", 1024, 10**9, "1"))
    with pytest.raises(StopIteration):
        one.run(stopped())
    (left,) = tmp_path.iterdir()
    assert left.suffix == ".mcap"
    assert read_info(left).messages > 1900


GEAR_KEY = key_of(Gear)


@pytest.mark.parametrize("last_samples_ns", [0, 10**12])
def test_more_than_can_be_recorded_waits_and_the_rest_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last_samples_ns: int
) -> None:
    monkeypatch.setattr(loop_module, "LAST_SAMPLES_NS", last_samples_ns)
    source = FakeSource(sample_of(gear(number)) for number in range(50_000))
    one = recorder(source, tmp_path, queue_bytes=2_000_000)
    recorded = one.run(lambda: source.is_exhausted)
    found = recorded.keys[GEAR_KEY]
    assert (found.received, found.lost_link, found.lost_full, found.lost_disk) == (50_000, 0, 0, 0)
    assert found.lost_queue > 0
    assert recorded.lost == recorded.lost_queue == sum(key.lost for key in recorded.keys.values())
    assert found.written == 50_000 - found.lost_queue
    messages = make_reader(BytesIO(Path(recorded.path or "").read_bytes()), validate_crcs=True).iter_messages(
        topics=[GEAR_KEY], log_time_order=False
    )
    sequences = [message.sequence for _, _, message in messages]
    assert len(sequences) == found.written
    assert sequences == sorted(sequences)


class FakeControl:
    """Sends these requests, each after the reply to the one before; stores published messages."""

    def __init__(self, *requests: Request) -> None:
        self.asked = [FakeAsked(request) for request in requests]
        self.published: list[Message] = []
        self._sent = 0

    @property
    def is_served(self) -> bool:
        return all(asked.is_done for asked in self.asked)

    def drain(self) -> list[OperatorRequest]:
        if self._sent < len(self.asked) and all(asked.is_done for asked in self.asked[: self._sent]):
            self._sent += 1
            return [self.asked[self._sent - 1].asked]
        return []

    def publish(self, message: Message) -> None:
        self.published.append(message)

    def health(self) -> list[RecorderHealth]:
        return [one for one in self.published if isinstance(one, RecorderHealth)]


@pytest.mark.usefixtures("fast_clock")
def test_operators_are_obeyed_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # However slow the disk is here: a reply that waits for it no longer names no file.
    monkeypatch.setattr(orders, "REPLY_NS", 10**12)
    control = FakeControl(Status(), Mark("it shook"))
    # Each pass brings some, so that there is a file to end.
    source = FakeSource(sample_of(gear(number)) for number in range(10**9))
    one = recorder(source, tmp_path, queue_bytes=1_000_000)
    one.attach(control)
    recorded = one.run(lambda: control.is_served)
    status, mark = (asked.answer for asked in control.asked)
    assert status.health.state is RecorderState.RECORDING
    assert len(mark.files) == 1
    assert set(mark.files) <= set(logs_in(tmp_path))
    assert recorded.incidents == 1
    events = [message.kind.value for message in control.published if isinstance(message, RecorderEvent)]
    assert events == ["incident"]


def test_notices_of_others_are_taken(tmp_path: Path) -> None:
    control = FakeControl()
    source = FakeSource(sample_of(gear(number)) for number in range(100))
    notices: list[Notice] = [DiskRoom(has_room=False, has_incident_room=True), Deleted("old.mcap", 7)]
    keeper = SimpleNamespace(notices=lambda: [notices.pop(0)] if notices else [], use=DiskUse())
    plan = msgspec.structs.replace(PLAN, alarms=frozenset({EventKind.STOP}))
    one = recorder(source, tmp_path, plan, keeper=keeper)
    one.attach(control)
    one._step()
    late = [sample_of(safety_event(EventKind.STOP)), *(sample_of(gear(number)) for number in range(100, 200))]
    source._samples = iter(late)
    source.is_exhausted = False
    recorded = one.run(lambda: source.is_exhausted and not notices)
    found = recorded.keys[GEAR_KEY]
    assert (found.received, found.written, found.lost_full) == (200, 100, 100)
    events = [message for message in control.published if isinstance(message, RecorderEvent)]
    assert [event.kind.value for event in events if event.kind.value != "incident"] == ["full", "deleted"]
    (incident,) = tmp_path.glob("*.incident.mcap")
    assert sum(1 for _ in make_reader(BytesIO(incident.read_bytes())).iter_messages(topics=[GEAR_KEY])) == 200


def test_the_leftovers_hear_of_room(tmp_path: Path) -> None:
    notices: list[Notice] = [DiskRoom(has_room=True, has_incident_room=True)]
    keeper = SimpleNamespace(notices=lambda: [notices.pop(0)] if notices else [], use=DiskUse())
    heard: list[Notice] = []
    leftovers = SimpleNamespace(notices=list, receive_notice=heard.append)
    expected = list(notices)
    recorder(FakeSource(), tmp_path, keeper=keeper, leftovers=leftovers).run(lambda: not notices)
    assert heard == expected


class Clock:
    """The loop's clock: it advances with slow samples, and a little at each reading."""

    def __init__(self, slow_ns: int) -> None:
        self.now_ns = 1
        self.slow_ns = slow_ns

    def monotonic_ns(self) -> int:
        self.now_ns += 1000
        return self.now_ns

    def time_ns(self) -> int:
        return WALL_NS + self.now_ns

    def sleep(self, wait_s: float) -> None:
        time.sleep(wait_s)
        self.now_ns += round(wait_s * 1e9)

    def process_time_ns(self) -> int:
        return self.now_ns


@pytest.mark.parametrize("slow_ns", [10_000, 5_000_000, 35_000_000])
def test_samples_that_take_long_do_not_hold_up_what_is_due(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, slow_ns: int
) -> None:
    clock = Clock(slow_ns)
    monkeypatch.setattr(loop_module, "time", clock)
    monkeypatch.setattr(loop_module, "LAST_SAMPLES_NS", 10**12)

    def keep_slowly(sample: ReceivedSample, reason: str, time_ns: int) -> bytes:
        clock.now_ns += slow_ns
        return keep_raw(sample, reason, time_ns)

    monkeypatch.setattr("recorder.record.robot_log.keep_raw", keep_slowly)
    source = FakeSource(FakeSample(f"k/{number % 7}", "x", b"") for number in range(700))
    one = recorder(source, tmp_path)
    ticks: list[int] = []
    tick = one._recorder.tick

    def watched(now_ns: int, wall_ns: int, sizes: Mapping[str, int]) -> Sequence[Action]:
        ticks.append(now_ns)
        return tick(now_ns, wall_ns, sizes)

    monkeypatch.setattr(one._recorder, "tick", watched)
    recorded = one.run(lambda: True)
    assert recorded.messages == 700
    # One sample may go beyond the time of a pass, but not two.
    longest_ns = max(later - earlier for earlier, later in pairwise([0, *ticks, clock.now_ns]))
    assert longest_ns < 2 * loop_module.PASS_NS + loop_module.TICK_NS + 2 * slow_ns
    assert sum(report.received for report in recorded.keys.values()) == 700
