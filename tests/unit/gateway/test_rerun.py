"""A recorded day, run again from its log."""

from collections.abc import Iterator
from functools import cache
from io import BytesIO
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from gateway import rerun as module
from gateway.chassis.frame import Frame
from gateway.choice import CHASSIS
from gateway.core import Core
from gateway.journal import BrokenJournalError, JournalGapError, read
from gateway.rerun import give, rerun, run_again, run_of
from recorder.encoding.protobuf import compile_encoder
from schemas import codec
from schemas.can_word import EXTENDED
from schemas.codec import Sample
from schemas.configuration import TomlSource, merge
from schemas.decisions import Decision, EventKind, Journal, SafetyEvent, SafetyState
from schemas.journal import COMMAND_RULES, Kind
from schemas.messages import Message, Variant
from schemas.reasons import Reason
from schemas.settings import Settings
from schemas.subjects import BY_DBC_MESSAGE, BY_NAME
from tests.support.nights import by_night
from tests.support.rigs.day import DAY_TICKS, MINUTE_TICKS, STARTED_NS, Day
from tests.support.rigs.gateway import Operator

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
        inputs = list(read(self.journals))
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


def test_a_log_that_misses_a_batch_is_refused() -> None:
    """Nothing that looks like a run comes out of it."""
    day = Day(3, Variant.COARSE)
    day.rig.run(2)
    log = ReadBack(day.rig.log())
    del log.journals[20]
    with pytest.raises(JournalGapError):
        list(log.run_again())


def the_event_again(day: Day) -> SafetyEvent:
    """The one event of this day, which is the same when the day is run again."""
    again = [s.payload for _, samples in ReadBack(day.rig.log()).run_again() for s in samples if is_event(s)]
    assert again == [s.payload for _, s in day.rig.recorded if is_event(s)]
    (event,) = (codec.decode(BY_NAME["safety/event"], payload) for payload in again)
    assert isinstance(event, SafetyEvent)
    return event


def is_event(sample: Sample) -> bool:
    """It is of the events that people read."""
    return sample.subject == "safety/event"


def test_a_run_that_began_latched_by_the_guard_is_run_again_so() -> None:
    """Row 'the guard has stopped the robot: latched, also across a restart': what the note said is an input."""
    day = Day(3, Variant.COARSE)
    day.rig.core.latch_guard_stop("yesterday guard: the gateway is gone", day.rig.now_ns)
    day.rig.run(2)
    event = the_event_again(day)
    assert (event.kind, event.reason) == (EventKind.LATCH, Reason.GUARD)
    assert event.text.endswith("; yesterday guard: the gateway is gone")


def test_what_a_run_began_with_a_warning_of_is_run_again_so() -> None:
    """An event that nothing in the bus or the requests explains is in the journal as well."""
    day = Day(3, Variant.COARSE)
    day.rig.core.warn("somebody has our name", day.rig.now_ns)
    day.rig.run(2)
    event = the_event_again(day)
    assert (event.kind, event.text) == (EventKind.FAULT, "somebody has our name")


def test_a_journal_of_before_has_six_links_and_the_speed_limit_of_its_time() -> None:
    """It does not say whether there was real-time priority, which lowered no limit then."""
    core = Core(CHASSIS, Settings(), "", 0)
    give(core, (Kind.LINKS, 5, True, 1, True, False, 2, False))
    give(core, (Kind.TICK, 10, 11, 0))
    assert core.command is not None
    seen = core.command.arbiter.monitor.chassis
    assert (seen.bus_losses, seen.guarded, seen.guard_stops, seen.guard_says, seen.realtime) == (
        1,
        True,
        2,
        "",
        True,
    )


def test_another_run_number_gives_other_leases() -> None:
    """The comparison can fail: the run number is part of the log for a reason."""
    day = Day(3, Variant.COARSE)
    day.rig.run(1)
    Operator(day.rig).take_lease()
    day.rig.run(1)
    log = ReadBack(day.rig.log())
    log.journals = [msgspec.structs.replace(journal, run=1) for journal in log.journals]
    again = [s.payload for _, samples in log.run_again() for s in samples if s.subject == "safety/decision"]
    assert again
    assert again != [s.payload for _, s in day.rig.recorded if s.subject == "safety/decision"]


def test_a_run_may_come_bit_by_bit() -> None:
    """The same comes out of journals that are read one after the other, and at last what is still in batches."""
    day = Day(3, Variant.COARSE)
    day.rig.run(1)
    log = ReadBack(day.rig.log())
    samples = [sample for _, published in log.run_again() for sample in published]
    again = list(rerun(log.settings, iter(log.journals)))
    assert again[: len(samples)] == samples
    assert {sample.subject for sample in again[len(samples) :]} <= {"can/{bus}/rx", "can/{bus}/tx", "journal"}
    assert not list(rerun(log.settings, iter(())))


def test_a_gap_is_noticed_wherever_a_run_is_run_again() -> None:
    """Bit by bit too: what comes before it has come out, and nothing that looks like a run comes after."""
    day = Day(3, Variant.COARSE)
    day.rig.run(2)
    log = ReadBack(day.rig.log())
    del log.journals[20]
    with pytest.raises(JournalGapError, match="are missing"):
        list(rerun(log.settings, log.journals))


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
