"""Reruns from the first input, from a snapshot, and with other settings; golden logs cover whole logs."""

from collections.abc import Callable
from random import Random
from typing import Any

import msgspec
import pytest

from gateway import rerun as module
from gateway.choice.chassis import CHASSIS
from gateway.command.restart import QUIET_NS
from gateway.core import Core
from gateway.journal import BrokenJournalError, JournalGapError, follow, inputs_of
from gateway.rerun import WARM_UP_NS, give, rerun, run_again, run_of, what_if
from schemas import codec
from schemas.codec import Sample
from schemas.decisions import Decision, EventKind, Journal, SafetyEvent
from schemas.journal import COMMAND_RULES, Kind
from schemas.messages import Message, Mode, RobotState, Variant
from schemas.reasons import Reason
from schemas.settings import Settings
from schemas.subjects import BY_NAME
from tests.support.nights import by_night
from tests.support.rigs.day import COMMAND, Day, RestfulDay, restful_day
from tests.support.rigs.gateway import GatewayRig, Operator

SAFETY = ("safety/decision", "safety/event", "safety/state")


def again(journals: list[Journal]) -> list[Sample]:
    """The samples of the core, run again from its first input."""
    inputs = list(follow(journals, 0))
    core = Core(CHASSIS, Settings(command=COMMAND), "", inputs[0][1], journals[0].run)
    return [sample for _, samples in run_again(core, inputs) for sample in samples]


def short(act: Callable[[Day], object] = lambda _day: None, seconds: float = 2) -> Day:
    """A stretch without a driver."""
    day = Day(3, Variant.COARSE)
    act(day)
    day.rig.run(seconds)
    return day


def test_a_gap_is_noticed() -> None:
    journals = short().rig.journals
    del journals[20]
    with pytest.raises(JournalGapError, match="are missing"):
        list(rerun(Settings(command=COMMAND), journals))


def test_what_a_run_began_with_is_run_again_so() -> None:
    """Events that neither the bus nor a request explains are in the journal as well."""

    def begin(day: Day) -> None:
        day.rig.core.latch_guard_stop("yesterday guard: it is gone", day.rig.now_ns)
        day.rig.core.warn("somebody has our name", day.rig.now_ns)

    day = short(begin)
    said = [sample for _, sample in day.rig.recorded if sample.subject == "safety/event"]
    assert [sample for sample in again(day.rig.journals) if sample.subject == "safety/event"] == said
    events = [msgspec.msgpack.decode(sample.payload, type=SafetyEvent) for sample in said]
    assert [(one.kind, one.text.rpartition("; ")[2]) for one in events] == [
        (EventKind.LATCH, "yesterday guard: it is gone"),
        (EventKind.FAULT, "somebody has our name"),
    ]


def test_a_journal_of_before_has_six_links_and_the_speed_limit_of_its_time() -> None:
    """Real-time priority is missing in it, and lowered no limit then."""
    core = Core(CHASSIS, Settings(), "", 0)
    give(core, (Kind.LINKS, 5, True, 1, True, False, 2, False))
    give(core, (Kind.TICK, 10, 11, 0))
    assert core.command is not None
    seen = core.command.arbiter.monitor.chassis
    links = (seen.bus_losses, seen.guarded, seen.guard_stops, seen.guard_says, seen.realtime)
    assert links == (1, True, 2, "", True)


def test_a_run_may_come_bit_by_bit() -> None:
    """The samples are the same if journals are read lazily, followed by the incomplete batches."""
    journals = short(seconds=1).rig.journals
    samples, found = again(journals), list(rerun(Settings(command=COMMAND), iter(journals)))
    assert found[: len(samples)] == samples
    assert {sample.subject for sample in found[len(samples) :]} <= {"can/{bus}/rx", "can/{bus}/tx", "journal"}
    assert not list(rerun(Settings(), iter(())))


def made_up(first: int, *inputs: object) -> Journal:
    encoded = msgspec.msgpack.encode(inputs)
    return Journal(0, 0, run=7, first=first, count=len(inputs), inputs=encoded, rules=COMMAND_RULES)


def test_not_every_checkpoint_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each attempt takes milliseconds, and a journal of a megabyte could hold a hundred thousand."""
    tried: list[bytes] = []
    monkeypatch.setattr(module, "_fits", tried.append)
    journal = made_up(5, *[(Kind.CHECKPOINT, 0, 0, b"")] * 1000)
    assert run_of([journal]) is None
    assert len(tried) == module.CHECKPOINTS_TRIED


@pytest.mark.parametrize("one", [(Kind.TICK, 5, 5, 0, bytes(8)), (Kind.SENT, 5, 0, 5), (Kind.SHUT_DOWN, 5)])
def test_inputs_that_come_in_no_time_fill_no_memory(
    monkeypatch: pytest.MonkeyPatch, one: tuple[object, ...]
) -> None:
    """A core holds them until its next journal is due, and time may be made to stand still."""
    monkeypatch.setattr(module, "INPUTS_MAX", 100)
    with pytest.raises(BrokenJournalError, match="more than 100 inputs without a journal"):
        list(rerun(Settings(), [made_up(0, *[one] * 200)]))


def test_what_no_core_was_given_is_a_broken_journal() -> None:
    with pytest.raises(BrokenJournalError, match="not the inputs of a core"):
        list(rerun(Settings(), [made_up(0, (Kind.TICK, -1, 5, 0, b""))]))


# From a place where the gateway was at rest.


@pytest.fixture(scope="module")
def day() -> RestfulDay:
    return restful_day(1, rounds=3)


def test_from_any_place_of_rest_on_all_comes_out_the_same(day: RestfulDay) -> None:
    """Decisions, events and states byte for byte, and every frame with its counter."""
    journals = day.rig.journals
    bursts = [frames for frames in day.rig.offered if frames]
    said = [sample for _, sample in day.rig.recorded if sample.subject in SAFETY]
    starts = [number for number in range(1, len(journals)) if number % 61 == 0]
    lengths = set()
    for start in Random(1).sample(starts, 4):  # noqa: S311 - the same ones each time
        run = run_of(journals[start:])
        if run is None:
            continue
        repeated = list(run_again(run.core(day.rig.settings), run.inputs))
        told = [sample for _, samples in repeated for sample in samples if sample.subject in SAFETY]
        sent = [frames for frames, _ in repeated if frames]
        # The journal's last batch, and so the last ticks, are not in it.
        missing = next(count for count in range(4) if told[-1] == said[-1 - count])
        assert told == said[len(said) - missing - len(told) : len(said) - missing]
        assert sent == bursts[len(bursts) - len(sent) :]
        lengths.add(len(told))
    assert len(lengths) >= 3


def test_the_places_are_told_from_seconds_of_quiet_on(day: RestfulDay) -> None:
    """After each drive, and never soon after a request."""
    inputs = [one for journal in day.rig.journals for one in inputs_of(journal)]
    asked_ns = 0
    places = 0
    for one in inputs:
        if one[0] == Kind.REQUEST:
            asked_ns = one[1]
        elif one[0] == Kind.REST:
            places += 1
            assert one[1] - asked_ns >= QUIET_NS
    assert places > 10


def test_without_such_a_place_there_is_nothing_to_run(day: RestfulDay) -> None:
    """Nor if it comes before enough feedback was seen."""
    journals = day.rig.journals
    resting = [any(one[0] == Kind.REST for one in inputs_of(journal)) for journal in journals]
    first = resting.index(True)
    seconds = len([j for j in journals if j.time_ns < journals[first].time_ns])
    assert seconds > 0
    assert run_of(journals[1:first]) is None
    assert not list(rerun(day.rig.settings, journals[1:first]))
    begins = run_of(journals[first:])
    assert begins is not None
    assert begins.warm_up[-1][0] == Kind.REST
    assert begins.warm_up[-1][1] - begins.warm_up[0][1] <= WARM_UP_NS
    assert begins.warm_up[-1][1] - inputs_of(journals[first])[0][1] > WARM_UP_NS - 50_000_000


# Beside the run that it would have been.

Recorded = tuple[Settings, list[Journal]]
Act = Callable[[GatewayRig, Operator], None]


def drive_out(act: Act = lambda _rig, _operator: None) -> Recorded:
    """Somebody drives with 1.5 m/s, something happens, and the robot is brought to rest."""
    day = Day(1, Variant.COARSE, ticks=0)
    rig = day.rig
    rig.run(0.6)
    operator = Operator(rig)
    operator.engage()
    operator.drive(1.5, 4.0, 3.0)
    act(rig, operator)
    operator.ask("disengage")
    rig.run(5)
    return rig.settings, day.rig.journals


Side = dict[type[Message], list[Any]]


def said(recorded: Recorded, **command: object) -> tuple[Side, Side]:
    """The messages of the recorded run and of the one with other settings, by class."""
    settings, run = recorded
    changed = msgspec.structs.replace(settings.command, **command)
    sides: tuple[Side, Side] = ({}, {})
    for one in what_if(settings, msgspec.structs.replace(settings, command=changed), run):
        message = codec.decode(BY_NAME[one.sample.subject], one.sample.payload)
        assert isinstance(message, Message)
        sides[one.is_other].setdefault(type(message), []).append(message)
    return sides


def stops(side: Side) -> list[Reason]:
    return [event.reason for event in side[SafetyEvent] if event.kind is EventKind.STOP]


def test_with_the_same_settings_both_runs_are_the_same() -> None:
    day = Day(1, Variant.FINE, ticks=1500)
    day.live()
    both = list(what_if(day.rig.settings, day.rig.settings, day.rig.journals))
    then = [one.sample for one in both if not one.is_other]
    assert len(then) > 1000
    assert then == [one.sample for one in both if one.is_other]
    assert not list(what_if(Settings(), Settings(), []))


def test_what_people_did_stays() -> None:
    """Bumper hits and drives by remote control stay as recorded; in the end both robots see the same."""

    def hit(rig: GatewayRig, _operator: Operator) -> None:
        rig.fault("bumper front on for 500ms")
        rig.run(3)

    def take_over(rig: GatewayRig, _operator: Operator) -> None:
        rig.fault("transmitter remote for 3s")
        rig.fault("sticks 0.8 5")
        rig.run(2.5)

    for side in said(drive_out(hit), speed_limit_mps=0.5):
        assert Reason.FRONT_BUMPER in stops(side)
    then, now = said(drive_out(take_over), speed_limit_mps=0.3)
    driven = [
        (recorded.speed_mps, tried.speed_mps)
        for recorded, tried in zip(then[RobotState], now[RobotState], strict=True)
        if recorded.mode is tried.mode is Mode.REMOTE
    ]
    assert len(driven) > 20
    assert driven[-1][0] == driven[-1][1] == pytest.approx(0.8, abs=0.05)
    assert then[RobotState][-1] == now[RobotState][-1]


NESTED = b"\x91" * 1000 + b"\x01"


@pytest.mark.parametrize(
    "payload", [NESTED, *map(by_night, [b"\x81\x91\x01\x01", b"\xc1", b"\x81\xa9challenge\x91\x01"])]
)
def test_whatever_somebody_asked_is_asked_of_both(payload: bytes) -> None:

    def ask(rig: GatewayRig, _operator: Operator) -> None:
        rig.put("stranger", "drive", payload)
        rig.run(0.1)

    for side in said(drive_out(ask), speed_limit_mps=0.5):
        strangers = [one.reason for one in side[Decision] if one.operator == "stranger"]
        assert strangers == [Reason.MALFORMED]
