"""What happened, in order."""

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Selection
from recorder.review import events
from recorder.review.entries import Entry, EntryKind
from recorder.review.events import read_events
from schemas.decisions import ArbiterState, EventKind, SafetyEvent, SafetyState, Severity
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.recording import GapReason, RecorderEvent, RecorderEventKind, RecordGap
from tests.support.logs import Log
from tests.support.messages import HEALTH, MS, ROBOT, SECOND, STANDBY, WALL_NS, gear, safety_event, sample_of
from tests.support.rigs import gateway, scenarios

TICK_NS = 10 * MS
FIRST_TICK = 10**11
AFTER = " (after this time, by the next gateway/health)"
"""Behind what has gone wrong between two healths."""

BEGAN = "the gateway restarted: earlier leases, engagement and latches are void"
GATEWAY = RecorderEventKind.GATEWAY


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "log.mcap"


def told(path: Path, data: bytes, selection: Selection | None = None) -> list[Entry]:
    path.write_bytes(data)
    faults = Faults()
    entries = list(read_events(find_logs([path], faults), selection or Selection(), faults))
    assert not faults, faults.told
    return entries


def at(tick: int, ahead_ns: int = 0) -> int:
    return WALL_NS + tick * TICK_NS + ahead_ns


def state(tick: int, sequence: int, ahead_ns: int = 0, **changes: Any) -> SafetyState:  # noqa: ANN401 - any field
    said = msgspec.structs.replace(
        STANDBY,
        time_ns=at(tick, ahead_ns),
        sequence=sequence,
        tick=FIRST_TICK + tick,
        challenge=tick.to_bytes(8, signed=True),
    )
    return msgspec.structs.replace(said, **changes)


def event(tick: int, sequence: int, kind: EventKind = EventKind.RESET, text: str = "") -> SafetyEvent:
    made = safety_event(kind, Severity.INFO, sequence)
    said = {"time_ns": at(tick), "tick": FIRST_TICK + tick, "operator": "operator-1"}
    return msgspec.structs.replace(made, **said, text=text or str(sequence))


def log_of(said: Iterable[tuple[int, Message]]) -> bytes:
    """A log of messages, each with its tick of receipt."""
    log = Log()
    for tick, message in said:
        log.receive(sample_of(message), wall_ns=at(tick) + 2 * MS)
    return log.close()


def test_what_comes_later_than_the_window_says_so(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "HELD_MAX", 10)
    said = [(100 + n, event(100 + n, 100 + n)) for n in range(50)]
    entries = told(path, log_of([*said, (200, event(5, 5))]))
    resets = [one for one in entries if one.kind is EntryKind.RESET]
    assert sorted(int(one.text) for one in resets) == [5, *range(100, 150)]
    assert [one.text for one in resets if one.is_late] == ["5"]


@pytest.mark.parametrize("steps_recorder", [False, True])
def test_a_gateway_behind_a_step_of_the_clock_did_not_fall_silent(path: Path, *, steps_recorder: bool) -> None:
    rig = scenarios.stepped_clock(steps_recorder=steps_recorder)
    start_ns = gateway.WALL_NS
    found = told(path, rig.log(), Selection(from_ns=start_ns + SECOND, to_ns=start_ns + 6 * SECOND))
    assert not [one.text for one in found if "went silent" in one.text]
    assert [one.text for one in found if one.kind is EntryKind.GAP and "ends here" not in one.text] == []
    if steps_recorder:
        assert EntryKind.CLOCK in {one.kind for one in told(path, rig.log())}


def test_what_the_recorder_says_is_told(path: Path) -> None:
    gap = RecordGap(WALL_NS + SECOND, 0, "fleet/cruiser-1/safety/event", GapReason.DISK, WALL_NS, WALL_NS + 5, 12)
    said = RecorderEvent(WALL_NS + 9, 0, Severity.ERROR, RecorderEventKind.FULL, "", "", "operator-1", "no room")
    log = Log()
    log.receive(sample_of(gear(0)))
    log.add_own("fleet/@recorder/depot/gap", gap, 0)
    log.add_own("fleet/@recorder/depot/event", said, 0)
    entries = told(path, log.close())
    assert [(one.kind, one.robot, one.count, one.operator) for one in entries] == [
        (EntryKind.GAP, ROBOT, 12, ""),
        (EntryKind.RECORDER, "", 1, "operator-1"),
    ]
    assert "the disk did not store them" in entries[0].text


RUNS = {"A": FIRST_TICK, "B": 5}
DRIVEN: dict[str, Any] = {"state": ArbiterState.ENGAGED, "engaged": True, "output_speed_mps": 0.8}

STORIES = """
== a clock set forward is one entry, and no silence
A 0-200; health 100; stop 150; A 200-400 +360000; health 300 +360000; stop 350 +360000
    150 stop info 1x: stop 0
    360200 clock warning 1x: the computer's clock was set by +3600.0 s
    360350 stop info 1x: stop 1
== a clock set back is one entry, and the order is that of the ticks
A 0-200; stop 150; A 200-400 -360000; stop 350 -360000
    150 stop info 1x: stop 0
    -359800 clock warning 1x: the computer's clock was set by -3600.0 s
    -359650 stop info 1x: stop 1
== a gateway that hung is no dead one
A 0-200 driven; health 100; gone 210; A 200-300 +398 driven; health 700 dropped; A 300-305 +398 driven
    100 fault warning 10x: request dropped unread: the loop hung for 4.0 s AFTER
    195 gap warning 1x: no arbiter state for 4.0 s: the gateway ran 5 ticks in that time, its loop hung
    210 gateway warning 1x: the recorder received nothing from the gateway for 4.0 s, then the same run \
continued: its loop had hung
== a recorder that stood still heard of no death
A 0-200; gone 210; A 200-1000 held 200-800
    210 gateway warning 1x: the recorder received nothing from the gateway for 6.0 s, then the same run \
continued: it had run on, the recorder or the link had stalled
== a gateway that another run follows has died
A 0-200 driven; gone 210; B 500-600
    195 gap error 1x: no arbiter state for 3.0 s: the gateway went silent, engaged, commanded 0.80 m/s
    210 gateway error 1x: the gateway died
    500 gateway error 1x: BEGAN; before that it was engaged, commanded 0.80 m/s
== a death is told of its robot where the log ends with it
A 0-5; gone 0
    0 gateway error 1x: the gateway died
== a link that stalls is no clock that was set
A 0-500 held 100-400; reset 500
    500 reset info 1x: reset 0
== states that waited for the recorder, in one burst, are no clock that is wrong
A 0-1000 held 0-150; reset 200
    200 reset info 1x: reset 0
== a clock that is found to be wrong some seconds later is no silence
A 0-1000 behind 500
    300 clock warning 1x: the robot's clock is 5.0 s behind the recorder's; times here are the recorder's
== two gateways of one name are said once
A 0-1000 & B 302-1000 driven
    305 gateway warning 1x: two gateways use this name: these entries are from both
== what was asked for later is told in its place
reset 500-510; reset 0-10 held 0-515
    0 reset info 1x: reset 2
    5 reset info 1x: reset 3
    500 reset info 1x: reset 0
    505 reset info 1x: reset 1
== samples that are missing are told, events by their sequence and states by their silence
A 0-100; reset 3; A 300-500; reset 400 skipping 6
    3 reset info 1x: reset 0
    3 gap warning 6x: 6 samples of fleet/cruiser-1/safety/event are not in the log
    95 gap warning 40x: no arbiter state for 2.0 s: 40 samples are missing
    400 reset info 1x: reset 7
"""
"""A name; what was said, from and to ticks of two runs; and the entries, with the tick of each.

``+360000`` ticks later by both clocks, ``held 200-800`` received at its end, ``behind 500`` by a clock that is so.
"""


def said_in(text: str) -> list[tuple[int, Message | RecorderEvent]]:
    """What a story says, each with its tick of receipt."""
    counts: Counter[str] = Counter()

    def step(words: list[str]) -> Iterator[tuple[int, Message | RecorderEvent]]:
        what, span, *more = words
        first, _, end = span.partition("-")
        later = next((int(one) for one in more if one[0] in "+-"), 0)
        held = range(*map(int, more[more.index("held") + 1].split("-"))) if "held" in more else range(0)
        behind = int(more[more.index("behind") + 1]) if "behind" in more else 0
        changes = DRIVEN if "driven" in more else {}
        for tick in range(int(first), int(end or int(first) + 1), 5):
            if what in RUNS:
                made: Any = state(tick, tick // 5, **changes)
                made = msgspec.structs.replace(made, tick=RUNS[what] + tick, time_ns=at(tick + later - behind))
            elif what == "gone":
                made = RecorderEvent(at(tick), 0, Severity.ERROR, GATEWAY, ROBOT, "", "", "the gateway died")
            elif what == "health":
                drops = 10 if "dropped" in more else 0
                fields = {"uptime_s": tick / 100, "faults": {}, "feedback": [], "inbox_drops": drops}
                fields |= {"time_ns": at(tick + later), "sequence": counts[what]}
                made = msgspec.structs.replace(HEALTH, **fields)
            else:
                number = counts["events"] + (int(more[-1]) if "skipping" in more else 0)
                counts["events"] = number + 1
                made = event(tick, number, EventKind(what), f"{what} {number}")
                reason = Reason.DEADMAN if what == "stop" else Reason.NONE
                made = msgspec.structs.replace(made, time_ns=at(tick + later), reason=reason)
            yield held.stop if tick in held else tick + later, made
        counts[what] += 1

    found = []
    for part in text.split("; "):
        beside = [one for words in part.split(" & ") for one in step(words.split())]
        found += sorted(beside, key=lambda one: one[0]) if " & " in part else beside
    return found


@pytest.mark.parametrize("story", STORIES.split("\n== ")[1:], ids=lambda one: one.partition("\n")[0])
def test_what_a_log_holds_is_told_as_what_it_was(story: str, path: Path) -> None:
    _, said, *expected = story.strip().split("\n")
    log = Log()
    for tick, message in said_in(said):
        if isinstance(message, RecorderEvent):
            log.add_own("fleet/@recorder/bench/event", message, 0)
        else:
            log.receive(sample_of(message), wall_ns=at(tick) + 2 * MS)
    for short, whole in (("BEGAN", BEGAN), (" AFTER", AFTER)):
        expected = [one.replace(short, whole) for one in expected]
    assert [
        f"    {(one.time_ns - WALL_NS) // TICK_NS} {one.kind.value} {one.severity.value} {one.count}x: {one.text}"
        for one in told(path, log.close())
        if "ends here" not in one.text
    ] == expected
