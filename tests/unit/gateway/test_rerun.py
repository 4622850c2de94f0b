"""A recorded day, run again from its log, from a place of rest, and beside the one that it would have been."""

from collections.abc import Callable, Iterator
from functools import cache
from io import BytesIO
from random import Random
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from gateway import rerun as module
from gateway.chassis.frame import Frame
from gateway.choice import CHASSIS
from gateway.command.restart import QUIET_NS
from gateway.core import Core
from gateway.journal import BrokenJournalError, JournalGapError, follow, inputs_of
from gateway.rerun import WARM_UP_NS, give, rerun, run_again, run_of, what_if
from recorder.encoding.protobuf import compile_encoder
from schemas import codec
from schemas.can_word import EXTENDED
from schemas.codec import Sample
from schemas.configuration import TomlSource, merge
from schemas.decisions import Decision, EventKind, Journal, SafetyEvent, SafetyState
from schemas.journal import COMMAND_RULES, Kind
from schemas.messages import Message, Mode, RobotState, Variant
from schemas.reasons import Reason
from schemas.settings import Settings
from schemas.subjects import BY_DBC_MESSAGE, BY_NAME
from tests.support.nights import by_night
from tests.support.rigs.day import DAY_TICKS, MINUTE_TICKS, STARTED_NS, Day, RestfulDay, restful_day
from tests.support.rigs.gateway import GatewayRig, Operator

OF_FRAMES = {subject.name for subject in BY_DBC_MESSAGE.values()}
SAFETY: dict[str, type[Message]] = {
    "safety/decision": Decision,
    "safety/event": SafetyEvent,
    "safety/state": SafetyState,
}


class ReadBack:
    """What a log alone says."""

    def __init__(self, data: bytes) -> None:
        reader = make_reader(BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
        (configuration,) = (
            attachment.data
            for attachment in reader.iter_attachments()
            if attachment.name.endswith("configuration.toml")
        )
        self.settings = merge(TomlSource("configuration.toml", configuration.decode()), {}, {})
        self.records: dict[str, list[bytes]] = {}
        prefix = f"{self.settings.robot.root}/{self.settings.robot.name}/"
        for _, channel, message in reader.iter_messages(log_time_order=False):
            self.records.setdefault(channel.topic.removeprefix(prefix), []).append(message.data)
        self.journals = [
            Journal(**{field: getattr(one.decoded_message, field) for field in Journal.__struct_fields__})
            for one in reader.iter_decoded_messages([f"{prefix}journal"], log_time_order=False)
        ]
        self.sent = [
            (one.decoded_message.time_ns, one.decoded_message.identifier, one.decoded_message.data)
            for one in reader.iter_decoded_messages([f"{prefix}can/can0/tx"], log_time_order=False)
        ]

    def run_again(self) -> Iterator[tuple[list[Frame], list[Sample]]]:
        """The core, run again."""
        inputs = list(follow(self.journals, 0))
        core = Core(CHASSIS, self.settings, "", inputs[0][1], self.journals[0].run)
        return run_again(core, inputs)


def frames_of(samples: list[Sample]) -> list[tuple[int, int, bytes]]:
    """Time, identifier and data of the frames that were published as sent."""
    frames: list[tuple[int, int, bytes]] = []
    for sample in samples:
        if sample.subject == "can/{bus}/tx":
            batch: Any = codec.decode(BY_NAME[sample.subject], sample.payload)
            words = [word & ~EXTENDED for word in batch.can_id]
            frames += zip(batch.frame_time_ns, words, batch.data, strict=True)
    return frames


@cache
def lived(seed: int, variant: Variant, ticks: int = DAY_TICKS) -> Day:
    """Such a day."""
    day = Day(seed, variant, ticks)
    day.live()
    return day


@pytest.mark.parametrize(
    ("seed", "variant", "ticks"),
    [
        (19, Variant.COARSE, DAY_TICKS),
        by_night(19, Variant.COARSE, MINUTE_TICKS),
        by_night(2, Variant.FINE, MINUTE_TICKS),
    ],
)
def test_a_recorded_day_run_again_comes_out_the_same(seed: int, variant: Variant, ticks: int) -> None:
    """From the log alone: every decision, event and state byte for byte, and every frame offered and sent."""
    day = lived(seed, variant, ticks)
    log = ReadBack(day.rig.log())
    offered: list[list[Frame]] = []
    samples: list[Sample] = []
    for frames, published in log.run_again():
        offered.append(frames)
        samples += published
    for name, kind in SAFETY.items():
        encode = compile_encoder(kind)
        again = [
            encode(codec.decode(BY_NAME[name], sample.payload)) for sample in samples if sample.subject == name
        ]
        recorded = log.records[name]
        # The last batch of the journal, and so the last ticks of the quiet end, is not in the log.
        assert 0 <= len(recorded) - len(again) <= (2 if name == "safety/state" else 0)
        assert again == recorded[: len(again)], name
    assert frames_of(samples) == log.sent
    bursts = [frames for frames in offered if frames]
    assert bursts == [frames for frames in day.rig.offered if frames]
    chassis = [sample for sample in samples if sample.subject in OF_FRAMES]
    assert chassis == [s for _, s in day.rig.recorded if s.subject in OF_FRAMES][: len(chassis)]


def test_the_day_is_worth_running_again() -> None:
    """In it the robot drives, is refused, stopped and latched, loses bus and guard, and comes to rest."""
    day = lived(19, Variant.COARSE)
    rig = day.rig
    assert rig.now_ns - STARTED_NS >= DAY_TICKS * 10_000_000
    assert len(rig.bursts) > 1500
    speeds_mps = {round(state["Auto_DriveCmd"]["TargetVelocity"], 1) for _, state in rig.bursts}  # type: ignore[arg-type]
    assert len(speeds_mps) > 10
    verdicts = {decision.reason for decision in rig.decided}
    assert {Reason.NONE, Reason.MALFORMED, Reason.UNKNOWN_VERB, Reason.STOPPING} <= verdicts
    stops = {event.reason for event in rig.events}
    assert len(stops) >= 10, stops
    assert {Reason.REMOTE_STOP, Reason.SHUTDOWN, Reason.LEASE_TAKEN, Reason.DEADMAN} <= stops


def short(act: Callable[[Day], object] = lambda _day: None, seconds: float = 2) -> Day:
    """Two seconds in which nobody drives."""
    day = Day(3, Variant.COARSE)
    act(day)
    day.rig.run(seconds)
    return day


def test_a_gap_is_noticed_wherever_a_run_is_run_again() -> None:
    """Bit by bit too: what comes before it has come out, and nothing that looks like a run comes after."""
    log = ReadBack(short().rig.log())
    del log.journals[20]
    with pytest.raises(JournalGapError):
        list(log.run_again())
    with pytest.raises(JournalGapError, match="are missing"):
        list(rerun(log.settings, log.journals))


BEGUN: dict[str, tuple[Callable[[Day], object], EventKind, Reason, str]] = {
    "latched by the guard": (
        lambda day: day.rig.core.latch_guard_stop("yesterday guard: it is gone", day.rig.now_ns),
        EventKind.LATCH,
        Reason.GUARD,
        "; yesterday guard: it is gone",
    ),
    "with a warning": (
        lambda day: day.rig.core.warn("somebody has our name", day.rig.now_ns),
        EventKind.FAULT,
        Reason.NONE,
        "somebody has our name",
    ),
}


@pytest.mark.parametrize(("act", "kind", "reason", "text"), BEGUN.values(), ids=BEGUN)
def test_what_a_run_began_with_is_run_again_so(
    act: Callable[[Day], object], kind: EventKind, reason: Reason, text: str
) -> None:
    """An event that nothing in the bus or the requests explains is in the journal as well."""
    day = short(act)
    events = [
        [one.payload for one in samples if one.subject == "safety/event"]
        for samples in (
            (s for _, samples in ReadBack(day.rig.log()).run_again() for s in samples),
            (one for _, one in day.rig.recorded),
        )
    ]
    assert events[0] == events[1]
    (event,) = (codec.decode(BY_NAME["safety/event"], payload) for payload in events[0])
    assert isinstance(event, SafetyEvent)
    assert (event.kind, event.reason, event.text.endswith(text)) == (kind, reason, True)


def test_a_journal_of_before_has_six_links_and_the_speed_limit_of_its_time() -> None:
    """It does not say whether there was real-time priority, which lowered no limit then."""
    core = Core(CHASSIS, Settings(), "", 0)
    give(core, (Kind.LINKS, 5, True, 1, True, False, 2, False))
    give(core, (Kind.TICK, 10, 11, 0))
    assert core.command is not None
    seen = core.command.arbiter.monitor.chassis
    links = (seen.bus_losses, seen.guarded, seen.guard_stops, seen.guard_says, seen.realtime)
    assert links == (1, True, 2, "", True)


def test_another_run_number_gives_other_leases() -> None:
    """The comparison can fail: the run number is part of the log for a reason."""
    day = short(seconds=1)
    Operator(day.rig).take_lease()
    day.rig.run(1)
    log = ReadBack(day.rig.log())
    log.journals = [msgspec.structs.replace(journal, run=1) for journal in log.journals]
    again = [s.payload for _, samples in log.run_again() for s in samples if s.subject == "safety/decision"]
    assert again
    assert again != [s.payload for _, s in day.rig.recorded if s.subject == "safety/decision"]


def test_a_run_may_come_bit_by_bit() -> None:
    """The same comes out of journals that are read one after the other, and at last what is still in batches."""
    log = ReadBack(short(seconds=1).rig.log())
    samples = [sample for _, published in log.run_again() for sample in published]
    again = list(rerun(log.settings, iter(log.journals)))
    assert again[: len(samples)] == samples
    assert {sample.subject for sample in again[len(samples) :]} <= {"can/{bus}/rx", "can/{bus}/tx", "journal"}
    assert not list(rerun(log.settings, iter(())))


def made_up(first: int, *inputs: object) -> Journal:
    """A journal that no gateway said."""
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
    with pytest.raises(BrokenJournalError, match="more than 100 inputs come in no time"):
        list(rerun(Settings(), [made_up(0, *[one] * 200)]))


def test_what_no_core_was_given_is_a_broken_journal() -> None:
    """Whatever a core makes of it: no error that nobody expects comes of a log."""
    with pytest.raises(BrokenJournalError, match="what no core was given"):
        list(rerun(Settings(), [made_up(0, (Kind.TICK, -1, 5, 0, b""))]))


# From a place where the gateway was at rest.


@pytest.fixture(scope="module")
def day() -> RestfulDay:
    """Such a day, with a place of rest wherever there is one."""
    return restful_day(1, rounds=3)


def test_from_any_place_of_rest_on_all_comes_out_the_same(day: RestfulDay) -> None:
    """Decisions, events and states byte for byte, with their sequences, and every frame with its counter."""
    journals = day.rig.journals
    bursts = [frames for frames in day.rig.offered if frames]
    said = [sample for _, sample in day.rig.recorded if sample.subject in SAFETY]
    starts = [number for number in range(1, len(journals)) if number % 61 == 0]
    lengths = set()
    for start in Random(1).sample(starts, 4):  # noqa: S311 - the same ones each time
        run = run_of(journals[start:])
        if run is None:
            continue
        again = list(run_again(run.core(day.rig.settings), run.inputs))
        told = [sample for _, samples in again for sample in samples if sample.subject in SAFETY]
        sent = [frames for frames, _ in again if frames]
        # The journal's last batch, and so the last ticks, are not in it.
        missing = next(count for count in range(4) if told[-1] == said[-1 - count])
        assert told == said[len(said) - missing - len(told) : len(said) - missing]
        assert sent == bursts[len(bursts) - len(sent) :]
        lengths.add(len(told))
    assert len(lengths) >= 3


def test_the_places_are_told_from_seconds_of_quiet_on(day: RestfulDay) -> None:
    """There are some after each drive, and none while anybody asks anything."""
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
    """Nor with one that comes before enough was seen."""
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
    """What the two runs say, by class: the recorded one, and the one with other settings."""
    settings, run = recorded
    changed = msgspec.structs.replace(settings.command, **command)
    sides: tuple[Side, Side] = ({}, {})
    for one in what_if(settings, msgspec.structs.replace(settings, command=changed), run):
        message = codec.decode(BY_NAME[one.sample.subject], one.sample.payload)
        assert isinstance(message, Message)
        sides[one.is_other].setdefault(type(message), []).append(message)
    return sides


def stops(side: Side) -> list[Reason]:
    """Why the robot was stopped."""
    return [event.reason for event in side[SafetyEvent] if event.kind is EventKind.STOP]


def test_with_the_same_settings_both_runs_are_the_same() -> None:
    """Every sample, whatever happens in between; nothing comes of nothing."""
    day = Day(1, Variant.FINE, ticks=1500)
    day.live()
    both = list(what_if(day.rig.settings, day.rig.settings, day.rig.journals))
    then = [one.sample for one in both if not one.is_other]
    assert len(then) > 1000
    assert then == [one.sample for one in both if one.is_other]
    assert not list(what_if(Settings(), Settings(), []))


def test_what_people_did_stays() -> None:
    """A bumper that was hit is hit. While the hand transmitter has the robot, the recorded speed is the speed.

    Once both stand with nobody in command, the two see the same.
    """

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
    """A request is anybody's bytes, nested as deep as it may be."""

    def ask(rig: GatewayRig, _operator: Operator) -> None:
        rig.put("stranger", "drive", payload)
        rig.run(0.1)

    for side in said(drive_out(ask), speed_limit_mps=0.5):
        strangers = [one.reason for one in side[Decision] if one.operator == "stranger"]
        assert strangers == [Reason.MALFORMED]
