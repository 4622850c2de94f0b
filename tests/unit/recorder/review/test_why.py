"""Why did the robot stop, or not move: given these logs and a moment, what the answer says."""

import random
import re
from collections.abc import Iterator, Sequence
from functools import cache, partial
from pathlib import Path

import msgspec
import pytest

from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Row, Selection
from recorder.reading.topics import Topic
from recorder.review.entries import ENDS, Entry, EntryKind
from recorder.review.events import read_events
from recorder.review.evidence import EVIDENCE, evidence_of
from recorder.review.moment import Story
from recorder.review.why import SHARED, Explanation
from recorder.review.window import BODY, EvidenceWindow, Limits, Step, span
from schemas.can_word import EXTENDED
from schemas.decisions import RUN_TICKS, Journal
from schemas.journal import Kind
from schemas.messages import Variant
from schemas.reasons import TEXTS, Reason, cure_of
from tests.support.messages import MS, ROBOT, SECOND
from tests.support.reading import entry
from tests.support.rigs import scenarios
from tests.support.rigs.day import Day
from tests.support.rigs.gateway import WALL_NS
from tests.support.rigs.recorded import RecordedRig, ask, ask_of, texts
from tests.support.rigs.scenarios import ENDED, GONE, NOTE, SCENARIOS, Scenario, logs_of, recorded

DAY_TICKS = 2500
LATCHING = {
    *(Reason.FRONT_BUMPER, Reason.REAR_BUMPER, Reason.REMOTE_STOP, Reason.IMPLAUSIBLE_SPEED, Reason.GUARD),
    *(Reason.ROLLING, Reason.NOT_MOVING, Reason.FEEDBACK_FROZEN, Reason.STEERING),
}
HEADLINES = {scenarios.found_moving: "found moving at 0.60 m/s, with no client in command"}
REFUSED = {scenarios.stale_commands: Reason.TOO_OLD, scenarios.repeated_sequence: Reason.SEQUENCE}
"""A deadman with commands that were refused is cured by what makes them acceptable."""

SHORT = {
    "NOTE": NOTE,
    "ENDED": ENDED,
    "GONE": GONE,
    "KILLED": "driving; run 1; rest; run 2; operator operator-2; engage; drive 0.6 1.5; mark",
}
ROWS = """
== a normal stop has ramp, standstill and parking brake
given deadman
last
    action: from 0.60 m/s to zero at 1.2 m/s2 in 490 ms
    action: zero speed after 490 ms, parking brake after ...0 ms, hold after 7...0 ms, enables off after 1.7
    action: at 0.60 m/s, was below 0.05 m/s after 6...0 ms and 0.2
    action: stopped: at standstill, no commands sent
== a speed in doubt gives no distance
given wrong_scale
last
    action: the speeds are in doubt: the distance is not known
== what was commanded is told with its numbers
given deadman
last
    evidence: seq 69 from operator-1...310 ms before the stop: 0.60 m/s...300 ms (from its configuration)
    command: seq 69 from operator-1...requested 0.60 m/s
-1200
    headline: It was engaged and moved, at 0. | reason: none | no cause
== a moment before the stop shows the robot as it was
given front_bumper
-100
    headline: It was engaged and moved, at 0.60 m/s; 100 ms later a stop began | state: engaged
    reason: front_bumper
== a stop ends with the next engagement
given driving; says disengage; rest; operator operator-1; engage; drive 0.6 1.0; says disengage; rest; from \
disengaged
50
    evidence: the request was disengage from operator-1 | no evidence: command followed
    action: stopped: at standstill, no commands sent, after 2.25 s | no action: moved again
== a stop that the remote control cuts short keeps its cause
given driving; says disengage; run 0.2; fault transmitter remote for 9s; until standby; run 1; from \
hand_transmitter
-20
    headline: It was being stopped: the holder of the lease disengaged.
    no action: stopped:
== a stop that was followed by an engagement is no answer
given driving; run 1; rest; operator operator-2; engage; drive 0.6 1.5; without safety/state
-3000
    reason: deadman
0
    reason: none | stop_ms: none | state: none | silent_ms: none
== a clock that is set back leaves the last stop the last
given driving; stop; rest; clock -3600; take; reset; ask engage; drive 0.6 1.5; run 1; rest
last
    reason: deadman
== a recording that ends at work is said to end
given driving; drive 0.6 2.0
-200
    missing: the seconds after this: the gateway died, or the recording ended
-1500
    no missing: the recording ended
== after a takeover the sticks move the robot on
given driving; fault transmitter remote for 3s; drive 0.6 0.6; fault sticks 0.4 5; until stopping; rest; from \
hand_transmitter
-100
    headline: 100 ms later the gateway let go: the remote control has the robot
    evidence: read Mode = remote, at the takeover
20
    reason: hand_transmitter | action: the gateway sends nothing
    no action: stopped:
== the stop that comes later is none of the takeover's
given driving; fault transmitter remote for 3s; drive 0.6 0.6; fault sticks 0.4 5; until stopping; rest; from \
found_moving
-100
    reason: hand_transmitter | state: standby | headline: It was not engaged. The last stop was
    cause: it could not be engaged: the robot moves | no action: stopped:
-5
    headline: It was not engaged; 5.0 ms later a stop began: found moving at 0.3
    cause: it could not be engaged: the remote control has the robot | evidence: read Mode = remote
    no missing
100
    reason: found_moving | no command: valid drive command
== a latch of long ago is traced to its frame
given driving; fault bumper front on for 700ms; drive 0.6 0.2; rest; run 14; take; says engage front_bumper
0
    state: standby | evidence: FrontBumper = 1
    latch: latched with this stop: front_bumper; no reset of it is in the log
    command: one engage request from operator-1 was refused
== another latch than that of the stop has evidence of its own
given driving; run 1; rest; stop; run 14
0
    reason: deadman
    headline: It was not engaged, and was latched 14.0...s before that moment: a remote stop was received
    cause: it could not be engaged: a remote stop was received | latch: by desk: remote_stop
    cure: to cure remote_stop: reset with 'cruiser reset cruiser-1'
== what was reset is not to be reset
given driving; stop; rest; take; reset; run 0.3
-900
    cure: to cure remote_stop: reset with 'cruiser reset cruiser-1'
0
    cure: to cure remote_stop: engage with 'cruiser drive cruiser-1' | latch: reset by operator-1
== a parked robot stands because it is parked
given ready; take; ask engage; run 0.2; drive 0.5 0.5
0
    headline: It was engaged and stood: the parking brake is applied.
    command: requested 0.50 m/s, 0.0 deg; commanded 0.00 m/s
    cure: to cure parked: allow drive commands to release it: 'cruiser unpark cruiser-1
== zero speed is nobody's fault
given ready; engage; drive 0 0.5
0
    headline: operator-1 requested zero speed
== a new engagement has no command yet
given driving; says disengage; rest; take; begin engage; run 0.1
0
    state: engaged | command: no drive command was accepted since it was engaged | no command: 0.60
    no headline: 0.60
== a pressed bumper is not in the way of a robot that goes away from it
given driving; fault bumper front on for 60s; drive 0.6 0.2; rest; take; says reset; engage; drive -0.5 0.2
0
    headline: It was engaged, commanded -0.0 | no cause | no cure: front_bumper
== one that stands for its operator could not have gone there
given driving; fault bumper front on for 60s; drive 0.6 0.2; rest; take; says reset; engage; drive 0.0 0.3
0
    headline: It was engaged and stood: operator-1 requested zero speed.
    cause: it could not be driven forward: the front bumper was hit, and is still pressed
== one that is to go there stands for the bumper, which was reset
given driving; fault bumper front on for 60s; drive 0.6 0.2; rest; take; says reset; engage; drive 0.5 0.5
0
    headline: It was engaged and stood: the front bumper was hit.
    cause: it could not be driven forward: the front bumper was hit, and is still pressed
    evidence: FrontBumper = 1 | cure: to cure front_bumper: drive backward
== a gateway that died is told, and no stop of before
given KILLED; another 3; run 4
last
    reason: none | silent_ms: 0 | headline: It was engaged and moved, at 0.60 m/s. The gateway went silent
-1200
    no headline: silent
-400
    state: engaged
    headline: m/s. The gateway went silent 4...after that moment, engaged, at 0.60 m/s; it restarted 3.
    missing: not in the log: what the guard did
    evidence: in the next gateway's first drive feedback, the robot stood
-60
    headline: m/s. The gateway went silent
1000
    state: none | reason: none | stop_ms: none | silent_ms: 0 | no cause: deadman
    headline: The gateway went silent 1.0...engaged, at 0.60 m/s; it restarted 2.0
3500
    state: standby | reason: none | stop_ms: none | silent_ms: 0
    headline: It was not engaged: no operator holds the lease...The gateway went silent 3.5
== a death is dated by the last state, whatever the next gateway says first
given ready; run 0.9; engage; drive 0.6 4; mark; another 0.3; run 1.5; engage; drive 0.6 4; mute 0.4
given ready; engage; drive 0.6 1; another 0.3; run 1.5; engage; drive 0.6 4; mute 0.4; mark; another 0.3; run \
1.5; mute 0.4
100 600 1000
    silent_ms: 0 | headline: , engaged, at 0.60 m/s; it restarted
last
    silent_ms: 0
== a death that a recorder saw is told where no other gateway follows
given driving; drive 0.6 2; mark; gone 0
last -200 1000
    silent_ms: 0 | headline: GONE | cause: GONE | no missing: is not told
30000
    headline: The log does not cover that moment
-1500
    silent_ms: none
== diary: a gateway that was killed, and its guard stopped the robot
given KILLED; another 3; note; run 1; ended; run 3
500
    silent_ms: 0
    action: NOTE | action: ENDED | reason: none
== diary: a gateway and its guard, both killed
given driving 0.8; mark; followed 2.8; run 4
0 1000
    evidence: still moved, at 0.80 m/s: it drove at least 2...and stood after
    action: the next gateway reported: | missing: not in the log: what the guard did
== diary: a gateway that hung is not told as dead
given driving 0.8; mark; gone 30; hang 0.13; run 4
given driving 0.8; mark; gone 30; hang 0.5; run 4
given driving 0.8; mark; gone 30; hang 2; run 4
given driving 0.8; mark; gone 30; hang 3; run 4
50 400 1500
    reason: guard | stop_ms: 90 | silent_ms: none | no headline: died | no cause: died | no cause: restarted
    headline: The gateway's loop hung for ...engaged, at 0.80 m/s: the guard began to stop the robot 9
    evidence: the guard began 9...frames, the first:  | action: was below 0.05 m/s after
== what its guard did is told by the next gateway, soon or late, and a recorder's word changes nothing
given KILLED; gone 0; another 3; note; run 1; ended; run 3
given KILLED; gone 0; another 40; note; run 1; ended; run 3
last -400 1000
    silent_ms: 0 | cause: the gateway restarted | no missing: guard
    action: the guard's note, found at the next start: NOTE | action: the guard's stop has ended: ENDED
== what the log does not hold is said: raw frames
given one_silent_frame; without journal
given checksums; without journal
last
    missing: not in the log: the frames of this time
== and requests
given deadman; without safety/decision
given lease_expired; without safety/decision
last
    missing: not in the log: the requests of this time
== and the arbiter
given deadman; without safety/state, safety/event
last
    missing: not in the log: the arbiter's state at this moment
== without a configuration the limits are the defaults
given deadman; unnamed
last
    evidence: the default; no configuration is in the log
== a silence is shown by when the arbiter was given the frames
given driving; starve; rest
last
    reason: feedback_missing
    evidence: valid Auto_GearFeedBack was received 110 ms before the stop...limit is 100 ms...; 11 more were on \
the bus, not read yet
"""
"""A name; scripts of logs (see ``script``); moments of each, in milliseconds from its time, or its ``last`` stop.

Of each moment what the answer says: ``headline: words`` or ``cause: words`` stand in a sentence of that step,
``...`` between two of them; ``no cause: words`` in none, and ``no cause`` says that there is no sentence of it.
``reason``, ``state``, ``stop_ms`` and ``silent_ms`` are the answer's, the times from those of the logs on.
"""


def lines(explanation: Explanation, zero_ns: int) -> Iterator[tuple[str, str]]:
    yield "headline", explanation.headline
    yield "reason", explanation.reason.value
    yield "state", "none" if explanation.state is None else explanation.state.value
    for name, time_ns in (("stop_ms", explanation.stop_ns), ("silent_ms", explanation.silent_ns)):
        yield name, "none" if time_ns is None else f"{(time_ns - zero_ns) / MS:.0f}"
    yield from ((link.step.value, link.text) for link in explanation.chain)


def wrong(explanation: Explanation, said: Sequence[str], zero_ns: int = 0) -> list[str]:
    found = list(lines(explanation, zero_ns))

    def holds(one: str) -> bool:
        step, _, words = one.removeprefix("no ").partition(": ")
        pattern = ".*".join(map(re.escape, words.split("...")))
        there = any(step == it and re.search(pattern, text) for it, text in found)
        return there is not one.startswith("no ")

    return [one for one in said if not holds(one)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "log.mcap"


@pytest.mark.parametrize("row", ROWS.split("\n== ")[1:], ids=lambda row: row.partition("\n")[0])
def test_the_answer_says(row: str, tmp_path: Path) -> None:
    for short, whole in SHORT.items():
        row = row.replace(short, whole)
    scripts = re.findall("^given (.*)$", row, re.MULTILINE)
    cases = re.findall(r"^((?:last|-?\d).*)\n((?:    .*\n?)+)", row, re.MULTILINE)
    assert scripts
    assert cases
    for script in scripts:
        logs, zero_ns = logs_of(script)
        for path in tmp_path.iterdir():
            path.unlink()
        for number, data in enumerate(logs):
            (tmp_path / f"{number}.mcap").write_bytes(data)
        for moments, said in cases:
            for moment in moments.split():
                at_ns = None if moment == "last" else zero_ns + int(moment) * MS
                explanation = ask_of([tmp_path], at_ns)
                expected = re.split(r" \| |\n\s*", said.strip())
                shown = "\n".join(f"{step}: {text}" for step, text in lines(explanation, zero_ns))
                assert wrong(explanation, expected, zero_ns) == [], (script, moment, shown)


UNACTED = {
    *(Reason.BUS_OFF, Reason.BUS_ERRORS, Reason.NO_REALTIME, Reason.VARIANT_UNKNOWN, Reason.MODE_NOT_AUTO),
    *(Reason.BRAKE_SLIPS, Reason.OVERSPEED, Reason.GATE, Reason.GRANT_EXPIRED, Reason.GRANT_REVOKED, Reason.NONE),
}
"""Causes that this rig does not act out, and those that need signed mode."""


def test_the_diary_has_thirty_stops_and_each_cause_among_them() -> None:
    assert len(SCENARIOS) + ROWS.count("== diary: ") >= 30
    assert set(EVIDENCE) - {reason for reason, _ in SCENARIOS.values()} == UNACTED


@pytest.mark.parametrize("scenario", SCENARIOS, ids=str)
def test_the_last_stop_has_its_cause_its_evidence_and_its_cure(scenario: Scenario, path: Path) -> None:
    reason, words = SCENARIOS[scenario]
    explanation = ask(path, recorded(scenario))
    cured = REFUSED.get(scenario, reason)
    said = [
        f"reason: {reason.value}",
        f"headline: {HEADLINES.get(scenario, TEXTS[reason].means)}",
        f"cause: {TEXTS[reason].means}",
        f"cure: to cure {cured.value}: {cure_of(TEXTS[cured].cure, ROBOT)}",
        f"{'' if reason in LATCHING else 'no '}latch: latched with this stop: {reason.value}",
    ]
    assert wrong(explanation, said) == [], explanation.headline
    shown = texts(explanation, Step.EVIDENCE).lower()
    assert [word for word in words if word.lower() not in shown] == [], shown
    assert explanation.stop_ns == explanation.at_ns


# What holds between two answers, or over a day.


@cache
def _day() -> bytes:
    """The log of a day whose robot sets its clock by hours, and whose recorder does not."""
    day = Day(6, Variant.COARSE, DAY_TICKS)
    day.live()
    return day.rig.log()


def _entries(path: Path, *kinds: EntryKind) -> list[Entry]:
    path.write_bytes(_day())
    faults = Faults()
    return list(read_events(find_logs([path], faults), Selection(), faults, kinds=frozenset(kinds)))


def test_of_a_day_in_which_everything_happens_every_stop_is_explained(path: Path) -> None:
    entries = _entries(path, *ENDS, EntryKind.CLOCK)
    assert EntryKind.CLOCK in {one.kind for one in entries}
    stops = [one for one in entries if one.reason is not Reason.NONE]
    assert len({one.reason for one in stops}) > 3
    for stop in stops:
        explanation = ask_of([path], stop.time_ns)
        assert explanation.reason is stop.reason, explanation.headline
        assert abs((explanation.stop_ns or 0) - stop.time_ns) <= 20 * MS


@pytest.mark.parametrize("reason", Reason, ids=lambda one: one.value)
def test_of_an_empty_log_nothing_is_claimed(reason: Reason) -> None:
    window = EvidenceWindow(ROBOT, WALL_NS, 0, Limits())
    window.detail = "Auto_DriveFeedBack, Auto_GearFeedBack"
    assert window.named_frames == ["Auto_GearFeedBack", "Auto_DriveFeedBack"]
    window.settle()
    links = evidence_of(reason)(window)
    assert {link.step for link in links} <= {Step.MISSING}
    assert all(link.text for link in links)


# Its parts.


FRAME = [Kind.FRAME, 1, [EXTENDED | BODY, bytes(8), WALL_NS]]
INPUTS = msgspec.msgpack.encode([FRAME, [Kind.TICK, 1, WALL_NS, 0, b"8"]] * 5)


def frames_of(*journals: Journal) -> int:
    """The number of frames of the body that the arbiter was given by then."""
    window = EvidenceWindow(ROBOT, WALL_NS, 0, Limits())
    for number, one in enumerate(journals):
        decode = partial(Journal, one.time_ns, one.sequence, one.run, one.first, one.count)
        topic = Topic("journal", "", "", "", b"", Journal, ROBOT, ROBOT, "", decode)
        window.take(Row(topic, number, WALL_NS, WALL_NS, one.inputs))
    window.settle()
    return len(window.frames(BODY))


@pytest.mark.parametrize(("run", "first", "known"), [(7, 10, 10), (7, 11, 5), (8, 10, 5)])
def test_a_gap_of_the_journal_and_another_run_end_what_is_known(run: int, first: int, known: int) -> None:
    assert frames_of(Journal(WALL_NS, 0, 7, 0, 10, INPUTS), Journal(WALL_NS, 1, run, first, 10, INPUTS)) == known


def test_a_damaged_journal_never_raises() -> None:
    chance = random.Random(5)  # noqa: S311 - the same damage each time
    wrong: list[object] = [[], [[]], [[3]], [[3, None, 5]], [[0, 1, 2], [3, 1, WALL_NS]], {"a": 1}]
    damaged = [msgspec.msgpack.encode(one) for one in wrong]
    for _ in range(2000):
        one = bytearray(INPUTS)
        for _ in range(chance.randrange(1, 4)):
            one[chance.randrange(len(one))] = chance.randrange(256)
        damaged.append(bytes(one))
    for data in damaged:
        assert frames_of(Journal(WALL_NS, 0, 7, 0, 10, data)) <= 5


def test_a_reset_is_of_the_latches_that_it_names_in_its_run() -> None:
    latch = entry(EntryKind.LATCH, 1, "latched until a reset", tick=10, reason=Reason.REMOTE_STOP)
    others = [
        entry(EntryKind.RESET, 2, "reset: front_bumper", tick=20),
        entry(EntryKind.RESET, 3, "reset: nothing was latched", tick=30),
        entry(EntryKind.RESET, 4, "reset: remote_stop", tick=10 + RUN_TICKS),
    ]
    own = entry(EntryKind.RESET, 5, "reset: front_bumper, remote_stop", tick=50)
    assert Story([latch, *others]).reset_of(latch) is None
    assert Story([latch, *others, own]).reset_of(latch) == own


def test_of_two_gateways_under_one_name_no_answer_is_given(path: Path) -> None:
    rig, _ = RecordedRig.driving(run=1)
    other = RecordedRig.beginning(rig.at_ns + SECOND, 2)
    other.run(1.0)
    rig.recorded += other.recorded
    rig.run(3.0)
    assert ask(path, rig.log()).headline == SHARED


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (99_940_000, "99.9 ms"),
        (99_960_000, "100 ms"),
        (999_600_000, "1.00 s"),
        (125 * SECOND, "2 min 5 s"),
        (12_000 * SECOND, "3 h 20 min"),
        (-310 * MS, "310 ms"),
    ],
)
def test_a_length_of_time_is_as_fine_as_it_is_short(ns: int, text: str) -> None:
    assert span(ns) == text
