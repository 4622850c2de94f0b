"""What happened, in order."""

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Selection, read_rows
from recorder.review import events
from recorder.review.entries import Change, Entry, EntryKind, EntrySource
from recorder.review.events import read_events
from recorder.review.window import BY_IDENTIFIER
from schemas.decisions import (
    ArbiterState,
    Decision,
    EventKind,
    SafetyEvent,
    SafetyState,
    Severity,
)
from schemas.messages import GatewayHealth, Message
from schemas.reasons import TEXTS, Reason
from schemas.recording import GapReason, RecorderEvent, RecorderEventKind, RecordGap
from tests.support.logs import Log
from tests.support.messages import HEALTH, MS, ROBOT, SECOND, STANDBY, WALL_NS, gear, safety_event, sample_of
from tests.support.messages import refusal as refused
from tests.support.rigs import gateway, scenarios
from tests.support.rigs.recorded import RecordedRig
from tests.support.rigs.scenarios import SCENARIOS, Scenario, acted, recorded

TICK_NS = 10 * MS
FIRST_TICK = 10**11
AFTER = " (after this time, as the next gateway/health says)"
"""Behind what has gone wrong between two healths."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where a test's log goes."""
    return tmp_path / "log.mcap"


def told(
    path: Path, data: bytes, selection: Selection | None = None, kinds: Collection[EntryKind] = ()
) -> list[Entry]:
    """The entries of a log with this content."""
    path.write_bytes(data)
    faults = Faults()
    entries = list(read_events(find_logs([path], faults), selection or Selection(), faults, kinds=kinds))
    assert not faults, faults.told
    return entries


def at(tick: int, ahead_ns: int = 0) -> int:
    """The robot's time at a tick."""
    return WALL_NS + tick * TICK_NS + ahead_ns


def state(tick: int, sequence: int, ahead_ns: int = 0, **changes: Any) -> SafetyState:  # noqa: ANN401 - any field
    """A state of the arbiter; standing by if nothing else is said."""
    said = msgspec.structs.replace(
        STANDBY,
        time_ns=at(tick, ahead_ns),
        sequence=sequence,
        tick=FIRST_TICK + tick,
        challenge=tick.to_bytes(8, signed=True),
    )
    return msgspec.structs.replace(said, **changes)


def event(tick: int, sequence: int, kind: EventKind = EventKind.RESET, text: str = "") -> SafetyEvent:
    """An event."""
    made = safety_event(kind, Severity.INFO, sequence)
    words = text or str(sequence)
    return msgspec.structs.replace(
        made, time_ns=at(tick), tick=FIRST_TICK + tick, operator="operator-1", text=words
    )


def refusal(tick: int, sequence: int, reason: Reason = Reason.TOO_OLD, operator: str = "operator-1") -> Decision:
    """A drive command that was refused."""
    said = {"time_ns": at(tick), "tick": FIRST_TICK + tick, "age_ms": 500.0, "frames_sent": 5}
    detail = f"detail {sequence}"
    return refused(sequence, operator=operator, reason=reason, detail=detail, requested_speed_mps=0.5, **said)


def log_of(said: Iterable[tuple[int, Message]]) -> bytes:
    """A log of messages, each with its tick of receipt."""
    log = Log()
    for tick, message in said:
        log.receive(sample_of(message), wall_ns=at(tick) + 2 * MS)
    return log.close()


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda one: one.__name__)
def test_every_event_of_the_arbiter_is_told_once_in_its_order(scenario: Scenario, path: Path) -> None:
    """With its own time, operator, reason and text."""
    entries = [entry for entry in told(path, recorded(scenario)) if entry.source is EntrySource.EVENT]
    assert [(one.time_ns, one.tick, one.reason, one.operator, one.text) for one in entries] == [
        (one.time_ns, one.tick, one.reason, one.operator, one.text) for one in acted(scenario).events
    ]


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda one: one.__name__)
def test_what_events_say_is_not_derived_once_more(scenario: Scenario, path: Path) -> None:
    """But for the guard, whose coming and going no event tells."""
    derived = [entry for entry in told(path, recorded(scenario)) if entry.is_derived]
    assert {entry.kind for entry in derived} <= {EntryKind.GUARD}


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda one: one.__name__)
def test_without_events_the_states_tell_the_same_kinds(scenario: Scenario, path: Path) -> None:
    """Of stops, latches, engages and takeovers, each with its reason, and marked as derived."""
    kinds = {EntryKind.STOP, EntryKind.STOPPED, EntryKind.LATCH, EntryKind.ENGAGED, EntryKind.TAKEOVER}
    with_events = [one for one in told(path, recorded(scenario)) if one.kind in kinds]
    without = [one for one in told(path, recorded(scenario, "safety/event")) if one.kind in kinds]
    assert all(one.is_derived for one in without)

    def shown(entries: list[Entry]) -> list[tuple[EntryKind, Reason, int]]:
        return sorted(((one.kind, one.reason, one.time_ns) for one in entries), key=str)

    assert shown(without) == shown(with_events)


def test_a_stream_that_is_refused_is_one_entry(path: Path) -> None:
    """With a count, the first time and the last; another reason or operator is another entry."""
    said: list[tuple[int, Message]] = [(2 * n, refusal(2 * n, n)) for n in range(500)]
    said += [(1000, refusal(1000, 500, Reason.SEQUENCE)), (1001, refusal(1001, 501, operator="operator-2"))]
    entries = told(path, log_of(said))
    assert [(one.count, one.reason, one.operator) for one in entries] == [
        (500, Reason.TOO_OLD, "operator-1"),
        (1, Reason.SEQUENCE, "operator-1"),
        (1, Reason.TOO_OLD, "operator-2"),
    ]
    assert (entries[0].time_ns, entries[0].last_ns) == (at(0), at(998))
    assert entries[0].text == "drive refused: detail 499"
    assert {one.kind for one in entries} == {EntryKind.REFUSAL}


def test_a_pause_begins_another_entry(path: Path) -> None:
    """Ten seconds of nothing between two refusals."""
    entries = told(path, log_of([(0, refusal(0, 0)), (1, refusal(1, 1)), (1000, refusal(1000, 2))]))
    assert [one.count for one in entries] == [2, 1]


def test_what_was_asked_for_later_is_told_in_its_place(path: Path) -> None:
    """A recorder that comes late gets the past behind the present."""
    said = [(5000 + n, event(5000 + n, 500 + n)) for n in range(3)]
    said += [(5010, event(n * 10, n)) for n in range(500)]
    entries = told(path, log_of(said))
    assert [one.text for one in entries] == [str(n) for n in range(503)]
    assert not any(one.is_late for one in entries)


def test_what_comes_later_than_the_window_says_so(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is told all the same, and marked."""
    monkeypatch.setattr(events, "HELD_MAX", 10)
    said = [(100 + n, event(100 + n, 100 + n)) for n in range(50)]
    entries = told(path, log_of([*said, (200, event(5, 5))]))
    assert sorted(one.text for one in entries if one.kind is EntryKind.RESET) == sorted(
        [str(n) for n in range(100, 150)] + ["5"]
    )
    assert [one.text for one in entries if one.is_late and one.kind is EntryKind.RESET] == ["5"]


def test_what_is_there_twice_is_told_once(tmp_path: Path) -> None:
    """An incident beside its log, and a second recorder's log."""
    data = recorded(scenarios.deadman)
    for name in ("one.mcap", "two.mcap"):
        (tmp_path / name).write_bytes(data)
    faults = Faults()
    twice = list(read_events(find_logs([tmp_path], faults), Selection(), faults))
    assert twice == told(tmp_path / "one.mcap", data)


def test_several_robots_stand_side_by_side(tmp_path: Path) -> None:
    """By their time, each with its name; one alone if it is asked for."""
    one, two = acted(scenarios.deadman), acted(scenarios.remote_stop)
    (tmp_path / "one.mcap").write_bytes(one.log())
    (tmp_path / "two.mcap").write_bytes(two.log(robot="cruiser-2"))
    faults = Faults()
    logs = find_logs([tmp_path], faults)
    both = list(read_events(logs, Selection(), faults))
    assert {entry.robot for entry in both} == {ROBOT, "cruiser-2"}
    assert [entry.time_ns for entry in both] == sorted(entry.time_ns for entry in both)
    alone = list(read_events(logs, Selection(), faults, robots={"cruiser-2"}))
    assert alone == [entry for entry in both if entry.robot == "cruiser-2"]


def test_a_question_bounds_time_and_kind(path: Path) -> None:
    """The same entries, fewer of them."""
    data = recorded(scenarios.front_bumper)
    every = told(path, data)
    middle_ns = next(one.time_ns for one in every if one.kind is EntryKind.STOP)
    assert told(path, data, Selection(to_ns=middle_ns)) == [one for one in every if one.time_ns < middle_ns]
    assert told(path, data, Selection(from_ns=middle_ns)) == [one for one in every if one.last_ns >= middle_ns]
    kinds = frozenset({EntryKind.STOP})
    assert told(path, data, kinds=kinds) == [one for one in every if one.kind in kinds]


@pytest.mark.parametrize("ahead_ns", [3600 * SECOND, -3600 * SECOND, 5 * SECOND])
def test_a_clock_that_is_wrong_from_the_first_is_told_and_set_right(ahead_ns: int, path: Path) -> None:
    """Times are the recorder's."""
    said = [(n * 5, state(n * 5, n, ahead_ns)) for n in range(20)]
    late = msgspec.structs.replace(event(90, 0), time_ns=at(90, ahead_ns))
    entries = told(path, log_of([*said, (95, late)]))
    assert [one.kind for one in entries] == [EntryKind.CLOCK, EntryKind.RESET]
    assert ("ahead of" if ahead_ns > 0 else "behind") in entries[0].text
    assert abs(entries[1].time_ns - at(90)) < 10 * MS


@pytest.mark.parametrize("set_ns", [3600 * SECOND, -3600 * SECOND])
def test_a_clock_that_is_set_disturbs_no_order(set_ns: int, path: Path) -> None:
    """What is said in the very tick is in its place, and the setting is told."""
    said: list[tuple[int, Message]] = []
    for n in range(40):
        ahead_ns = set_ns if n >= 20 else 0
        moved = event(n * 5, n)
        said.append((n * 5, msgspec.structs.replace(moved, time_ns=moved.time_ns + ahead_ns)))
        said.append((n * 5, state(n * 5, n, ahead_ns)))
    entries = told(path, log_of(said))
    assert [one.text for one in entries if one.kind is EntryKind.RESET] == [str(n) for n in range(40)]
    (clock,) = (one for one in entries if one.kind is EntryKind.CLOCK)
    assert f"{set_ns / 1e9:+.1f} s" in clock.text


def test_what_waited_for_the_recorder_is_no_clock_that_is_wrong(path: Path) -> None:
    """States of 1.5 s that come in one burst, and then all in time: nothing is told of it, and times are right."""
    said: list[tuple[int, Message]] = [(max(150, n * 5), state(n * 5, n)) for n in range(200)]
    said.insert(40, (200, event(200, 0)))
    entries = told(path, log_of(said))
    assert [(one.kind, one.time_ns) for one in entries] == [(EntryKind.RESET, at(200))]


@pytest.mark.parametrize("steps_recorder", [False, True])
def test_a_gateway_behind_a_step_of_the_clock_did_not_fall_silent(path: Path, *, steps_recorder: bool) -> None:
    """Also where all that is read ends in the hole of the log times: the next state is of the same gateway."""
    rig = scenarios.stepped_clock(steps_recorder=steps_recorder)
    start_ns = gateway.WALL_NS
    found = told(path, rig.log(), Selection(from_ns=start_ns + SECOND, to_ns=start_ns + 6 * SECOND))
    assert not [one.text for one in found if "fell silent" in one.text]
    assert [one.text for one in found if one.kind is EntryKind.GAP and "ends here" not in one.text] == []
    if steps_recorder:
        assert EntryKind.CLOCK in {one.kind for one in told(path, rig.log())}


def test_samples_that_are_missing_are_told(path: Path) -> None:
    """Events by their sequence, states by their silence."""
    said: list[tuple[int, Message]] = [(n * 5, state(n * 5, n)) for n in range(100) if not 20 <= n < 60]
    said += [(3, event(3, 0)), (400, event(400, 7))]
    gaps = [one for one in told(path, log_of(sorted(said, key=lambda one: one[0]))) if one.kind is EntryKind.GAP]
    assert [(one.count, one.time_ns, one.last_ns) for one in gaps] == [
        (6, at(3), at(400)),
        (40, at(95), at(300)),
    ]


def test_what_the_recorder_says_is_told(path: Path) -> None:
    """Its events, and what it could not keep."""
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
    assert "the disk did not take or keep them" in entries[0].text


def test_a_gateway_that_only_listens_has_faults_and_no_more(path: Path) -> None:
    """They are in its health."""
    safety = ("safety/event", "safety/state", "safety/decision", "journal")
    entries = told(path, recorded(scenarios.one_silent_frame, *safety))
    assert {one.source for one in entries} == {EntrySource.HEALTH}
    assert f"frames stayed away{AFTER}" in {one.text for one in entries}


def test_one_outage_begins_once_and_ends_once(path: Path) -> None:
    """All feedback stays away and comes again: not a line for each frame and each of its faults."""
    rig, _ = RecordedRig.driving()
    rig.corrupt = lambda _frame: None
    rig.run(3.0)
    rig.corrupt = lambda frame: frame
    rig.rest_after(5.0)
    entries = [one for one in told(path, rig.log()) if one.source is EntrySource.HEALTH]
    faults = [(one.count, one.text.partition(": ")[2]) for one in entries if "silen" in one.text]
    assert faults == [(10, f"silent{AFTER}"), (10, "no longer at fault (silence)")]
    assert sum(one.count for one in entries if "missing frames" in one.text) == 1890
    assert len(entries) <= 4
    for one in entries:
        assert one.text.startswith("10 frames (")
        assert all(frame.name in one.text for frame in BY_IDENTIFIER.values() if frame.is_feedback)


def test_a_fault_stands_before_what_it_causes(path: Path) -> None:
    """The health that tells of it comes later: it began behind the health before."""
    entries = told(path, recorded(scenarios.one_silent_frame))
    (stop,) = (one for one in entries if one.kind is EntryKind.STOP)
    faults = [one for one in entries if one.source is EntrySource.HEALTH and "missing frames" not in one.text]
    assert faults
    for one in faults:
        assert one.time_ns <= stop.time_ns <= one.last_ns
        assert one.last_ns - one.time_ns == SECOND
        assert entries.index(one) < entries.index(stop)


def test_the_frame_whose_checksums_were_wrong_is_named(path: Path) -> None:
    """By the health's own counts."""
    entries = told(path, recorded(scenarios.checksums))
    (fault,) = (one for one in entries if "wrong checksum" in one.text)
    assert (fault.text, fault.count) == (f"Auto_DriveFeedBack: frames with a wrong checksum{AFTER}", 5)


def test_a_message_that_cannot_be_read_is_a_fault(path: Path) -> None:
    """The others are told."""
    data = recorded(scenarios.deadman)
    path.write_bytes(data)
    unread = Faults()
    timeline = events.Timeline(unread)
    for row in read_rows(find_logs([path], unread), Selection(), unread):
        is_event = row.topic.kind is SafetyEvent
        timeline.take(msgspec.structs.replace(row, data=b"\xff" * 5) if is_event else row)
    assert unread.count == 1  # The same of each is one fault.
    assert "safety/event: a message that cannot be read" in unread.told[0]
    assert EntryKind.STOP in {entry.kind for entry in timeline.end()}


def test_an_accepted_request_that_has_no_event_is_told(path: Path) -> None:
    """Unpark, here."""
    entries = told(path, recorded(scenarios.deadman))
    (unpark,) = (one for one in entries if one.kind is EntryKind.REQUEST)
    assert (unpark.request, unpark.operator, unpark.text) == ("unpark", "operator-1", "unpark, as asked")


def test_who_held_the_lease_is_told_with_an_event_that_nobody_did(path: Path) -> None:
    """The deadman's stop: its operator is empty, and the holder is not."""
    entries = told(path, recorded(scenarios.deadman))
    (stop,) = (one for one in entries if one.kind is EntryKind.STOP)
    assert (stop.operator, stop.holder) == ("", "operator-1")


def test_two_runs_of_a_gateway_in_one_log(path: Path) -> None:
    """The second run's samples count from zero again, and nothing is missing for that."""
    first, second = RecordedRig.ready(run=1)[0], RecordedRig.ready(run=2)[0]
    path.write_bytes(first.log())
    other = path.with_name("other.mcap")
    second.wall_ns += 60 * SECOND
    second.recorder_ns += 60 * SECOND
    second.run(1)
    other.write_bytes(second.log())
    faults = Faults()
    entries = list(read_events(find_logs([path, other], faults), Selection(), faults))
    assert EntryKind.GATEWAY in {one.kind for one in entries}
    assert not [one for one in entries if one.kind is EntryKind.GAP and "safety/event" in one.text]


@pytest.mark.parametrize("is_told", [True, False])
def test_a_gateway_that_was_told_to_end_did_not_fall_silent(tmp_path: Path, is_told: bool) -> None:  # noqa: FBT001
    """It says so itself, and the next one begins as is to be expected."""
    first, _ = RecordedRig.ready(run=1)
    if is_told:
        first.core.shut_down(first.now_ns)
    first.tick()
    second = RecordedRig(run=2)
    later_ns = first.at_ns + 3 * SECOND - second.at_ns
    second.wall_ns += later_ns
    second.recorder_ns += later_ns
    second.run(1)
    (tmp_path / "one.mcap").write_bytes(first.log())
    (tmp_path / "two.mcap").write_bytes(second.log())
    faults = Faults()
    entries = list(read_events(find_logs([tmp_path], faults), Selection(), faults))
    silences = [entry for entry in entries if "fell silent" in entry.text]
    assert bool(silences) is not is_told
    gateway = [(entry.severity, entry.reason) for entry in entries if entry.kind is EntryKind.GATEWAY]
    begun = (Severity.INFO if is_told else Severity.WARNING, Reason.NONE)
    assert gateway[-1] == begun
    assert ((Severity.INFO, Reason.SHUTDOWN) in gateway) is is_told


def test_a_gateway_that_a_recorder_saw_die_is_told_of_its_robot(path: Path) -> None:
    """As what it is, and not among what recorders do to their files."""
    log = Log()
    log.receive(sample_of(gear(0)), sample_of(state(0, 0)))
    gone = RecorderEvent(WALL_NS, 0, Severity.ERROR, RecorderEventKind.GATEWAY, ROBOT, "", "", "the gateway died")
    log.add_own("fleet/@recorder/bench/event", gone, 0)
    (entry,) = (one for one in told(path, log.close()) if one.kind is EntryKind.GATEWAY)
    assert (entry.robot, entry.severity, entry.source) == (ROBOT, Severity.ERROR, EntrySource.RECORDER)


HOUR = 360_000
"""In ticks."""

DRIVEN: dict[str, Any] = {"state": ArbiterState.ENGAGED, "engaged": True, "output_speed_mps": 0.8}


def health(tick: int, sequence: int, up_ticks: int, **changes: Any) -> GatewayHealth:  # noqa: ANN401 - any field
    """A health that is well, after so many ticks of the gateway's own."""
    said = {"time_ns": at(tick), "sequence": sequence, "uptime_s": up_ticks / 100, "faults": {}, "feedback": []}
    return msgspec.structs.replace(HEALTH, **{**said, **changes})


def run_of(first: int, ticks: range, later: int = 0, **changes: Any) -> list[tuple[int, Message]]:  # noqa: ANN401
    """States of a run, each with its tick of receipt: so many ticks later by both clocks."""
    return [
        (
            tick + later,
            msgspec.structs.replace(
                state(tick, tick // 5, **changes), tick=first + tick, time_ns=at(tick + later)
            ),
        )
        for tick in ticks
    ]


def stop(tick: int, sequence: int, later: int = 0) -> tuple[int, Message]:
    """A stop, likewise."""
    said = event(tick, sequence, EventKind.STOP, f"stop {sequence}")
    return tick + later, msgspec.structs.replace(said, time_ns=at(tick + later), reason=Reason.DEADMAN)


def token_gone(tick: int) -> RecorderEvent:
    """What a recorder says of a gateway whose token is gone."""
    return RecorderEvent(at(tick), 0, Severity.ERROR, RecorderEventKind.GATEWAY, ROBOT, "", "", "the gateway died")


RUN = FIRST_TICK

NEXT_HEALTH = " (after this time, as the next gateway/health says)"
SAME = "the recorder heard nothing of the gateway for {}, and then the same again: "
BEGAN = "another run of the gateway began: leases, engagement and latches of before are void"

STORIES: dict[str, tuple[list[tuple[int, Message]], list[tuple[EntryKind, Severity, str]]]] = {
    "a clock set forward is one entry, and no silence": (
        [
            *run_of(RUN, range(0, 200, 5)),
            (100, health(100, 0, 100)),
            stop(150, 0),
            *run_of(RUN, range(200, 400, 5), HOUR),
            (HOUR + 300, health(HOUR + 300, 1, 300)),
            stop(350, 1, HOUR),
        ],
        [
            (EntryKind.STOP, Severity.INFO, "stop 0"),
            (EntryKind.CLOCK, Severity.WARNING, "the computer's clock was set by +3600.0 s"),
            (EntryKind.STOP, Severity.INFO, "stop 1"),
        ],
    ),
    "a clock set back is one entry, and the order is that of the ticks": (
        [
            *run_of(RUN, range(0, 200, 5)),
            stop(150, 0),
            *run_of(RUN, range(200, 400, 5), -HOUR),
            stop(350, 1, -HOUR),
        ],
        [
            (EntryKind.STOP, Severity.INFO, "stop 0"),
            (EntryKind.CLOCK, Severity.WARNING, "the computer's clock was set by -3600.0 s"),
            (EntryKind.STOP, Severity.INFO, "stop 1"),
        ],
    ),
    "a gateway that hung is no dead one": (
        [
            *run_of(RUN, range(0, 200, 5), **DRIVEN),
            (100, health(100, 0, 100)),
            (210, token_gone(210)),
            *run_of(RUN, range(200, 300, 5), 398, **DRIVEN),
            (700, health(700, 1, 700, inbox_drops=10)),
            *run_of(RUN, range(300, 305, 5), 398, **DRIVEN),
        ],
        [
            (
                EntryKind.FAULT,
                Severity.WARNING,
                f"requests were dropped unread: the loop did not read for 4.0 s{NEXT_HEALTH}",
            ),
            (
                EntryKind.GAP,
                Severity.WARNING,
                "nothing of the arbiter for 4.0 s: the gateway made 5 ticks meanwhile: its loop stood still",
            ),
            (EntryKind.GATEWAY, Severity.WARNING, f"{SAME.format('4.0 s')}its loop had stood still"),
        ],
    ),
    "a recorder that stood still heard of no death": (
        [
            *run_of(RUN, range(0, 200, 5)),
            (210, token_gone(210)),
            *((max(tick, 800), said) for tick, said in run_of(RUN, range(200, 1000, 5))),
        ],
        [
            (
                EntryKind.GATEWAY,
                Severity.WARNING,
                f"{SAME.format('6.0 s')}it had run on: the recorder or the link stood still",
            ),
        ],
    ),
    "a gateway that another run follows has died": (
        [*run_of(RUN, range(0, 200, 5), **DRIVEN), (210, token_gone(210)), *run_of(5, range(500, 600, 5))],
        [
            (
                EntryKind.GAP,
                Severity.ERROR,
                "nothing of the arbiter for 3.0 s: the gateway fell silent, engaged, commanded 0.80 m/s",
            ),
            (EntryKind.GATEWAY, Severity.ERROR, "the gateway died"),
            (
                EntryKind.GATEWAY,
                Severity.ERROR,
                f"{BEGAN}; the one before was engaged, commanded 0.80 m/s",
            ),
        ],
    ),
    "what is latched in another run is not derived from what was before": (
        [*run_of(RUN, range(0, 25, 5), latched=[Reason.GATE]), *run_of(5, range(100, 105, 5))],
        [(EntryKind.GATEWAY, Severity.WARNING, BEGAN)],
    ),
    "a link that stalls is no clock that was set": (
        [
            *((tick if tick < 100 or tick >= 400 else 400, said) for tick, said in run_of(RUN, range(0, 500, 5))),
            *run_of(RUN, range(500, 505, 5), latched=[Reason.GATE]),
        ],
        [(EntryKind.LATCH, Severity.ERROR, f"latched until a reset: {TEXTS[Reason.GATE].means}")],
    ),
    "a clock that is found to be wrong some seconds later is no silence": (
        [(tick + 500, said) for tick, said in run_of(RUN, range(0, 1000, 5), -500)],
        [
            (
                EntryKind.CLOCK,
                Severity.WARNING,
                "the robot's clock is 5.0 s behind the recorder's; the times here are the recorder's",
            )
        ],
    ),
    "two gateways of one name are said once": (
        sorted(
            [*run_of(RUN, range(0, 1000, 5)), *run_of(5, range(302, 1000, 5), **DRIVEN)], key=lambda one: one[0]
        ),
        [
            (
                EntryKind.GATEWAY,
                Severity.WARNING,
                "two gateways speak under this name: these entries are of both",
            )
        ],
    ),
}


@pytest.mark.parametrize("story", STORIES)
def test_what_a_log_holds_is_told_as_what_it_was(story: str, path: Path) -> None:
    """A clock that was set, a gateway or a recorder that stood still, one that died, two of one name."""
    said, expected = STORIES[story]
    log = Log()
    for tick, message in said:
        if isinstance(message, RecorderEvent):
            log.add_own("fleet/@recorder/bench/event", message, 0)
        else:
            log.receive(sample_of(message), wall_ns=at(tick) + 2 * MS)
    found = [one for one in told(path, log.close()) if "ends here" not in one.text]
    assert [(one.kind, one.severity, one.text) for one in found] == expected


def test_ticks_of_events_are_bounded() -> None:
    """An event between two ticks is found, in whatever order they came; the oldest are forgotten."""
    robot = events.RobotTrack(ROBOT)
    for tick in (30, 10, 20):
        robot.add_event(EntryKind.STOP, tick)

    def tells(kind: EntryKind, after_tick: int, tick: int) -> bool:
        return robot.tells(Change(kind, Severity.INFO, Reason.NONE, "", "", after_tick, tick))

    assert tells(EntryKind.STOP, 19, 20)
    assert not tells(EntryKind.STOP, 20, 29)
    assert not tells(EntryKind.LATCH, 0, 100)
    for tick in range(events.TICKS_MAX):
        robot.add_event(EntryKind.STOP, 100 + tick)
    assert not tells(EntryKind.STOP, 0, 99)
