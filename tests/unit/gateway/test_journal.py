"""The journal of the core's inputs, and a core that resumes from a checkpoint."""

import gc
import json
from collections.abc import Iterator
from functools import cache
from random import Random
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway import core as core_module
from gateway import journal as module
from gateway.chassis.frame import EXTENDED, FD, REMOTE, Frame
from gateway.chassis.layout import Encoder, MessageDecoder, MessageLayout
from gateway.chassis.port import Chassis
from gateway.choice.chassis import CHASSIS
from gateway.command.flow import TickEffects
from gateway.command.restart import Carried
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.journal import (
    RENAMED,
    BrokenJournalError,
    CheckpointError,
    Input,
    JournalGapError,
    JournalWriter,
    checkpoint,
    follow,
)
from gateway.rerun import give, rerun, run_of
from gateway.telemetry.health import Links
from schemas import codec
from schemas.codec import Sample
from schemas.decisions import ArbiterState, Journal
from schemas.journal import Kind
from schemas.messages import Variant
from schemas.settings import CommandSettings, Settings
from schemas.subjects import BY_NAME, Subject
from tests.support.frames import CHALLENGE, MS, WALL_NS
from tests.support.nights import by_night
from tests.support.rigs.day import DAY_TICKS, Day

# The inputs.


def journals(batches: list[int], run: int = 7) -> list[Journal]:
    """A run's journals with these numbers of inputs; each input has its place."""
    writer, place, taken = JournalWriter(run), 0, []
    for count in batches:
        for _ in range(count):
            writer.add((Kind.SHUT_DOWN, place))
            place += 1
        journal = writer.take(WALL_NS)
        assert journal is not None
        taken.append(journal)
    return taken


def inputs_at(core: Core, at_ms: int) -> list[Input]:
    """The inputs that the core publishes at a tick that makes a batch due, without that tick."""
    samples = core.tick(at_ms * MS, WALL_NS, 0, CHALLENGE).samples
    (sample,) = (sample for sample in samples if sample.subject == "journal")
    journal = codec.decode(BY_NAME["journal"], sample.payload)
    assert isinstance(journal, Journal)
    return list(follow([journal]))[:-1]


def test_inputs_come_back_in_their_order() -> None:
    """From any batches, also without the end. Each has its place, in plain MessagePack."""
    batches = journals([1, 300, 2, 70])
    assert [(one.run, one.sequence, one.first, one.count) for one in batches[:2]] == [(7, 0, 0, 1), (7, 1, 1, 300)]
    assert msgspec.msgpack.decode(batches[0].inputs) == [[5, 0]]
    for count, left in ((373, batches), (301, batches[:2])):
        assert list(follow(left, 0)) == [(Kind.SHUT_DOWN, place) for place in range(count)]
    assert JournalWriter(7).take(WALL_NS) is None


DAMAGED = {"empty": b"", "no opcode": b"\x91\xc1", "no UTF-8": b"\x91\x91\xa1\xff", "deep": b"\x91" * 10_000}


@pytest.mark.parametrize("inputs", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_journal_is_refused(inputs: bytes) -> None:
    (journal,) = journals([2])
    with pytest.raises(BrokenJournalError, match="inputs 0 on cannot be read"):
        list(follow([msgspec.structs.replace(journal, inputs=inputs)], 0))


@pytest.mark.parametrize(
    ("left", "why"),
    [
        # Also where the first is missing: run again from the midst, the core would be another one.
        *(
            ([one for one in journals([2, 3, 4, 5]) if one.sequence != missing], "are missing")
            for missing in range(3)
        ),
        # Those of two runs are of two cores, also where the places would fit.
        (journals([2]) + journals([2, 2], run=8), "run 8 begins"),
        (journals([2]) + journals([2, 2], run=8)[1:], "run 8 begins"),
    ],
)
def test_a_journal_with_a_gap_is_refused(left: list[Journal], why: str) -> None:
    with pytest.raises(JournalGapError, match=why):
        list(follow(left, 0))


def test_every_input_of_the_core_is_written_down() -> None:
    """Each kind with its time and all that the core was given; of the links only what the core decides by."""
    core = Core(CHASSIS, Settings(), "1.2.3", 0, run=7)
    frames = [
        Frame(EXTENDED | 0x18C4D1EF, bytes(8), WALL_NS),
        Frame(0x123 | REMOTE, b"", 5, 0, 3),
        Frame(0x7, bytes(64), 6, FD),
    ]
    for at_ns, frame in enumerate(frames):
        core.receive_frame(frame, at_ns)
    core.receive_request(RawRequest(9, "stop", "first", b"\xff\x00", 2), 3)
    core.update_links(Links(bus_up=True, bus_losses=1, guarded=True), 4)
    core.update_links(Links(bus_up=True, bus_losses=1, guarded=True, zenoh_peers=5, cpu_ns=7), 5)
    says = "it has given up"
    core.update_links(
        Links(bus_up=True, bus_losses=1, guarded=True, guard_stops=1, guard_says=says, realtime=True), 6
    )
    core.latch_guard_stop("the robot stands", 7)
    core.warn("somebody is there", 7)
    core.take_over(Carried({"remote_stop": ""}, "remote_stop", "by a desk"), 7)
    core.shut_down(8)
    assert inputs_at(core, 0) == [
        (Kind.FRAME, 0, [EXTENDED | 0x18C4D1EF, bytes(8), WALL_NS, 0, 0]),
        (Kind.FRAME, 1, [0x123 | REMOTE, b"", 5, 0, 3]),
        (Kind.FRAME, 2, [0x7, bytes(64), 6, FD, 0]),
        (Kind.REQUEST, 3, 9, "stop", "first", b"\xff\x00", 2, ""),
        (Kind.LINKS, 4, True, 1, True, False, 0, False, False, ""),
        (Kind.LINKS, 6, True, 1, True, False, 1, False, True, "it has given up"),
        (Kind.GUARD_STOP, 7, "the robot stands"),
        (Kind.WARNING, 7, "somebody is there"),
        (Kind.CARRIED, 7, [{"remote_stop": ""}, "remote_stop", "by a desk", False, {}, False]),
        (Kind.SHUT_DOWN, 8),
    ]
    core.sent(0, 8, WALL_NS + 8)
    core.tick(10 * MS, WALL_NS + 10, 11, CHALLENGE)
    assert inputs_at(core, 50) == [
        (Kind.SENT, 8, 0, WALL_NS + 8),
        (Kind.TICK, 10 * MS, WALL_NS + 10, 11, CHALLENGE),
    ]


# Checkpoints.

SAFETY = ("safety/decision", "safety/event", "safety/state")
FOLLOWED = 4000
"""Inputs, half a second's, after which a difference would have shown."""


@cache
def lived(seed: int, variant: Variant = Variant.COARSE, ticks: int = DAY_TICKS) -> Day:
    """A day with a checkpoint each second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core_module, "CHECKPOINT_PERIOD_NS", 1_000_000_000)
        day = Day(seed, variant, ticks)
        day.live()
    return day


def inputs_of_day(day: Day) -> list[Input]:
    return list(follow(day.rig.journals, 0))


def state_of(core: Core) -> bytes:
    return msgspec.msgpack.encode(checkpoint(core))


def effects(returned: TickEffects | list[Sample]) -> object:
    """The effects of an input, without the journal, which begins again."""
    if isinstance(returned, TickEffects):
        said = [sample for sample in returned.samples if sample.subject != "journal"]
        return returned.frames, returned.replies, said, returned.events
    return returned


@pytest.mark.parametrize(
    ("seed", "variant", "places"),
    [
        (1, Variant.COARSE, 10),
        *(by_night(*row, 25) for row in ((1, Variant.COARSE), (2, Variant.FINE), (3, Variant.COARSE))),
    ],
)
def test_whatever_happens_it_goes_on_as_before(seed: int, variant: Variant, places: int) -> None:
    """From any tick on, every frame with its counter, every reply, and every sample with its sequence."""
    day = lived(seed, variant)
    inputs = inputs_of_day(day)
    ticks = [place for place, one in enumerate(inputs) if one[0] == Kind.TICK]
    chosen = set(Random(seed).sample(ticks, places))  # noqa: S311 - the same ones each time
    first = Core(CHASSIS, day.rig.settings, "", inputs[0][1], day.rig.journals[0].run)
    taken: dict[int, bytes] = {}
    then: dict[int, bytes] = {}
    before: list[object] = []
    states = set()
    for place, one in enumerate(inputs):
        if place - 1 in chosen:
            then[place - 1] = state_of(first)
        if place in chosen:
            taken[place] = state_of(first)
            assert first.command is not None
            states.add(first.command.arbiter.state)
        before.append(effects(give(first, one)))
    assert {ArbiterState.ENGAGED, ArbiterState.STANDBY} < states
    for place, state in taken.items():
        second = Core(CHASSIS, day.rig.settings, "", inputs[0][1], day.rig.journals[0].run)
        second.resume(state)
        for number in range(place, min(len(inputs), place + FOLLOWED)):
            assert effects(give(second, inputs[number])) == before[number], (place, inputs[number])
            if number == place:
                # What is not the same then may show minutes later.
                assert state_of(second) == then[place], place


def test_taking_one_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of one moment are equal. They hold no module names, and renamed attributes keep their names."""
    day = lived(1)
    core = day.rig.core
    one = state_of(core)
    assert state_of(core) == one
    again = Core(CHASSIS, day.rig.settings, "", 0)
    again.resume(one)
    # What the journal of the first has written is its own.
    assert state_of(again) == one
    assert b"gateway." not in one
    assert b"schemas." not in one
    monkeypatch.setitem(RENAMED, "Arbiter", {"tick_number": "number_at_first"})
    renamed = state_of(core)
    assert b"number_at_first" in renamed
    again = Core(CHASSIS, day.rig.settings, "", 0)
    again.resume(renamed)
    assert state_of(again) == renamed
    monkeypatch.undo()
    assert state_of(again) == one


def test_a_checkpoint_is_taken_once_a_period() -> None:
    """Also during a drive; once a minute by default."""
    quiet = Day(5, Variant.COARSE, ticks=0)
    quiet.rig.run(130)
    often, seldom = (
        [len(one[3]) for one in inputs_of_day(day) if one[0] == Kind.CHECKPOINT] for day in (lived(1), quiet)
    )
    assert 35 <= len(often) <= 50
    assert len(seldom) == 2
    assert seldom[0] < 64_000


def damaged() -> Iterator[bytes]:
    tree = checkpoint(lived(1, ticks=300).rig.core)
    text = json.dumps(tree, default=lambda raw: {"bytes": raw.hex()})
    for before, after in (
        ('"Core"', '"Arbiter"'),
        ('"Arbiter"', '"Core"'),
        ('"Arbiter"', '"gateway.command.arbiter:Arbiters"'),
        ('"Arbiter"', '"subprocess:Popen"'),
        ('"Arbiter"', '"gateway.command.flow:CommandFlow"'),
        ('"Arbiter"', '"gateway.loop:GatewayLoop"'),
        ('"Arbiter"', '"msgspec"'),
        ('"tick_number"', '"tick"'),
        ('"tick_number"', '"__class__"'),
        ('"held"', '"kept"'),
    ):
        assert before in text
        changed = json.loads(
            text.replace(before, after),
            object_hook=lambda one: bytes.fromhex(one["bytes"]) if one.keys() == {"bytes"} else one,
        )
        yield msgspec.msgpack.encode(changed)
    state = msgspec.msgpack.encode(tree)
    yield from (b"", state[:-1], b"\xc0", msgspec.msgpack.encode(["seen", 7]), msgspec.msgpack.encode(["object"]))
    yield msgspec.msgpack.encode(["list", [], None])


def test_one_that_does_not_fit_is_refused() -> None:
    """Damaged, made up, or of a version whose core holds other things; no class of others is ever made."""
    for state in damaged():
        with pytest.raises(CheckpointError):
            Core(CHASSIS, Settings(), "", 0).resume(state)


@given(st.binary(max_size=200), st.integers(0, 30_000))
def test_no_bytes_do_anything_else(junk: bytes, place: int) -> None:
    state = bytearray(msgspec.msgpack.encode(checkpoint(lived(1, ticks=300).rig.core)))
    state[place % len(state) : place % len(state) + len(junk)] = junk
    try:
        Core(CHASSIS, Settings(), "", 0).resume(bytes(state))
    except CheckpointError:
        return


def test_a_run_whose_checkpoints_do_not_fit_begins_at_its_next_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of another version are skipped, and all if the settings differ."""
    day = lived(1)
    middle = day.rig.journals[len(day.rig.journals) // 2 :]
    assert run_of(middle) is not None
    run = run_of(middle, at_rest=True)
    assert run is None or run.warm_up
    monkeypatch.setattr(module, "CLASSES", {})
    run = run_of(middle)
    assert run is None or run.warm_up
    assert list(rerun(day.rig.settings, middle[:3])) == []


def left_out(value: Any, kinds: set[type]) -> None:  # noqa: ANN401 - of any kind
    """Collect the classes that a checkpoint leaves out."""
    seen: set[int] = set()
    waiting = [*vars(value).values()]
    while waiting:
        one = waiting.pop()
        if id(one) in seen:
            continue
        seen.add(id(one))
        if module._tag(type(one)) == "constant":
            kinds.add(type(one))
            continue
        if isinstance(one, dict):
            waiting += [*one, *one.values()]
        elif isinstance(one, list | tuple | set | frozenset) or type(one).__name__ == "deque":
            waiting += one
        elif type(one).__module__.startswith(("gateway", "schemas")):
            waiting += [entry for entry in gc.get_referents(one) if not isinstance(entry, type)]


MADE_WITH = {Chassis, CommandSettings, Encoder, JournalWriter, MessageDecoder, MessageLayout, Subject}
"""A new core of the same settings has these."""


def test_nothing_is_left_out_but_what_a_core_is_made_with() -> None:
    """A new class in the core's state needs an alias."""
    day = lived(1)
    inputs = inputs_of_day(day)
    core = Core(CHASSIS, day.rig.settings, "", inputs[0][1], day.rig.journals[0].run)
    kinds: set[type] = set()
    for place, one in enumerate(inputs):
        give(core, one)
        if place % 199 == 0:
            left_out(core, kinds)
    plain = {FunctionType, MethodType, BuiltinFunctionType}
    assert kinds - plain <= {*MADE_WITH, type, type(Settings)}, kinds
