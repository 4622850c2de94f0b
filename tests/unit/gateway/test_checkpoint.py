"""A core that goes on from a checkpoint does what the one before it did."""

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
from gateway.chassis.layout import Encoder, MessageDecoder, MessageLayout
from gateway.chassis.port import Chassis
from gateway.choice import CHASSIS
from gateway.command.flow import TickEffects
from gateway.core import Core
from gateway.journal import RENAMED, CheckpointError, Input, JournalWriter, checkpoint, follow, inputs_of
from gateway.rerun import give, rerun, run_again, run_of
from schemas.codec import Sample
from schemas.decisions import ArbiterState
from schemas.journal import Kind
from schemas.messages import Variant
from schemas.settings import CommandSettings, Settings
from schemas.subjects import Subject
from tests.support.nights import by_night
from tests.support.rigs.day import DAY_TICKS, Day

SAFETY = ("safety/decision", "safety/event", "safety/state")
FOLLOWED = 4000
"""Inputs, half a second's, after which a difference would have shown."""


@cache
def lived(seed: int, variant: Variant = Variant.COARSE, ticks: int = DAY_TICKS) -> Day:
    """A day with a checkpoint each second, in the midst of whatever happens."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core_module, "CHECKPOINT_PERIOD_NS", 1_000_000_000)
        day = Day(seed, variant, ticks)
        day.live()
    return day


def inputs_of_day(day: Day) -> list[Input]:
    """All that the core was given."""
    return list(follow(day.rig.journals, 0))


def effects(returned: TickEffects | list[Sample]) -> object:
    """What comes of an input, but for the journal, which begins anew."""
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
    """From any tick on: every frame with its counter, every reply, every sample with its sequence."""
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
            then[place - 1] = msgspec.msgpack.encode(checkpoint(first))
        if place in chosen:
            taken[place] = msgspec.msgpack.encode(checkpoint(first))
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
                assert msgspec.msgpack.encode(checkpoint(second)) == then[place], place


def test_taking_one_changes_nothing() -> None:
    """The core shares nothing with it, and two of one moment are equal."""
    day = lived(1)
    core = day.rig.core
    one = msgspec.msgpack.encode(checkpoint(core))
    assert msgspec.msgpack.encode(checkpoint(core)) == one
    again = Core(CHASSIS, day.rig.settings, "", 0)
    again.resume(one)
    # What the journal of the first has written is its own.
    assert msgspec.msgpack.encode(checkpoint(again)) == one


def test_a_part_of_a_driven_run_is_run_again_from_its_checkpoint() -> None:
    """Where nothing was at rest; decisions, events and states are those of the day, byte for byte."""
    day = lived(1)
    journals = day.rig.journals
    said = [sample for _, sample in day.rig.recorded if sample.subject in SAFETY]
    for start in (len(journals) // 5, len(journals) // 2):
        run = run_of(journals[start:])
        assert run is not None
        assert run.state
        again = [
            sample
            for _, samples in run_again(run.core(day.rig.settings), run.inputs)
            for sample in samples
            if sample.subject in SAFETY
        ]
        missing = next(count for count in range(4) if again[-1] == said[-1 - count])
        assert again == said[len(said) - missing - len(again) : len(said) - missing]
        assert len(again) > len(said) * (len(journals) - start) / len(journals) / 2


def test_a_checkpoint_is_taken_once_a_period() -> None:
    """Also while somebody drives."""
    day = lived(1)
    kept = [one[2] for journal in day.rig.journals for one in inputs_of(journal) if one[0] == Kind.CHECKPOINT]
    assert 35 <= len(kept) <= 50


def test_once_a_minute_by_default() -> None:
    """A minute's journal is hundreds of times larger."""
    day = Day(5, Variant.COARSE, ticks=0)
    day.rig.run(130)
    kept = [one for journal in day.rig.journals for one in inputs_of(journal) if one[0] == Kind.CHECKPOINT]
    assert len(kept) == 2
    assert len(kept[0][3]) < 64_000


def test_other_settings_begin_at_rest_alone() -> None:
    """A state under other limits is one that they would not have come to."""
    day = lived(1)
    middle = day.rig.journals[len(day.rig.journals) // 2 :]
    assert run_of(middle) is not None
    run = run_of(middle, at_rest=True)
    assert run is None or run.warm_up


def damaged() -> Iterator[bytes]:
    """Checkpoints that no core of this version has taken."""
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
    """It is resumed, or refused by its one error."""
    state = bytearray(msgspec.msgpack.encode(checkpoint(lived(1, ticks=300).rig.core)))
    state[place % len(state) : place % len(state) + len(junk)] = junk
    try:
        Core(CHASSIS, Settings(), "", 0).resume(bytes(state))
    except CheckpointError:
        return


def test_a_run_whose_checkpoints_do_not_fit_begins_at_its_next_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of another version are passed over."""
    day = lived(1)
    middle = day.rig.journals[len(day.rig.journals) // 2 :]
    monkeypatch.setattr(module, "CLASSES", {})
    run = run_of(middle)
    assert run is None or run.warm_up
    assert list(rerun(day.rig.settings, middle[:3])) == []


def left_out(value: Any, kinds: set[type]) -> None:  # noqa: ANN401 - of any kind
    """Gather the classes of all that a checkpoint leaves out."""
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
    """Whoever gives the core a state of another class sees here that the class has no alias."""
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


def test_no_checkpoint_says_where_a_class_stands() -> None:
    """Classes move; a log stays."""
    state = msgspec.msgpack.encode(checkpoint(lived(1).rig.core))
    assert b"gateway." not in state
    assert b"schemas." not in state


def test_a_renamed_attribute_keeps_its_name_in_checkpoints(monkeypatch: pytest.MonkeyPatch) -> None:
    """In both directions."""
    core = lived(1).rig.core
    state = msgspec.msgpack.encode(checkpoint(core))
    monkeypatch.setitem(RENAMED, "Arbiter", {"tick_number": "number_at_first"})
    renamed = msgspec.msgpack.encode(checkpoint(core))
    assert b"number_at_first" in renamed
    again = Core(CHASSIS, lived(1).rig.settings, "", 0)
    again.resume(renamed)
    assert msgspec.msgpack.encode(checkpoint(again)) == renamed
    monkeypatch.undo()
    assert msgspec.msgpack.encode(checkpoint(again)) == state
