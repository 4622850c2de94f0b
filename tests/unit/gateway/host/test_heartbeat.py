import os
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.port import Actuation
from gateway.guard.stopper import Beat, Cause, GuardStatus, StopOutcome
from gateway.host.guard_main import Heartbeat
from schemas.messages import GearPosition, Variant

TIMES_NS = st.integers(0, 2**62)
FINITE = st.floats(allow_nan=False)
BEATS = st.builds(
    Beat,
    now_ns=TIMES_NS,
    is_active=st.booleans(),
    is_mute=st.booleans(),
    is_closing=st.booleans(),
    variant=st.sampled_from(Variant),
    last=st.builds(
        Actuation,
        enabled=st.booleans(),
        gear=st.sampled_from(GearPosition),
        speed_mps=FINITE,
        angle_deg=FINITE,
        parking=st.booleans(),
    ),
    counters=st.binary(min_size=8, max_size=8),
)
STATUSES = st.builds(
    GuardStatus,
    now_ns=TIMES_NS,
    is_ready=st.booleans(),
    is_sending=st.booleans(),
    stops=st.integers(0, 2**62),
    cause=st.sampled_from(Cause),
    outcome=st.sampled_from(StopOutcome),
)


@pytest.fixture
def heartbeat() -> Iterator[Heartbeat]:
    memory = Heartbeat.create()
    yield memory
    memory.close()


def test_fresh_memory_holds_nothing(heartbeat: Heartbeat) -> None:
    """Neither side takes zeros for a sign of life."""
    assert heartbeat.read_beat() is None
    assert heartbeat.read_status() is None


@given(st.lists(st.one_of(BEATS, STATUSES), min_size=1, max_size=8))
def test_the_other_side_reads_the_newest_of_each(values: list[Beat | GuardStatus]) -> None:
    """Through a descriptor of its own, as another process has it; the two ways do not disturb each other."""
    mine = Heartbeat.create()
    theirs = Heartbeat(os.dup(mine.descriptor))
    beat, status = None, None
    for value in values:
        if isinstance(value, Beat):
            beat = value
            mine.write_beat(value)
        else:
            status = value
            theirs.write_status(value)
        assert theirs.read_beat() == beat
        assert mine.read_status() == status
    mine.close()
    theirs.close()


@given(st.lists(BEATS, min_size=2, max_size=4, unique_by=lambda beat: beat.now_ns), st.data())
def test_a_torn_beat_is_never_believed(beats: list[Beat], data: st.DataObject) -> None:
    """Whatever part of a write has arrived, in whatever order, the reader sees the beat before it or the whole."""
    memory = Heartbeat.create()
    for beat in beats[:-1]:
        memory.write_beat(beat)
    before = memory._memory[:]
    memory.write_beat(beats[-1])
    after = memory._memory[:]
    changed = [at for at in range(len(after)) if before[at] != after[at]]
    arrived = data.draw(st.sets(st.sampled_from(changed)))
    memory._memory[:] = bytes(after[at] if at in arrived else before[at] for at in range(len(after)))
    seen = memory.read_beat()
    assert seen == (beats[-1] if arrived == set(changed) else beats[-2])
    memory.close()
