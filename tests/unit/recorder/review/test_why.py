"""Why did the robot stop, or not move?"""

import re
from functools import cache
from pathlib import Path

import msgspec
import pytest

from gateway.chassis.frame import Frame
from recorder.reading.logs import Faults, find_logs
from recorder.reading.rows import Selection
from recorder.review.entries import ENDS, Entry, EntryKind
from recorder.review.events import read_events
from recorder.review.why import Explanation
from recorder.review.window import Step
from schemas.decisions import ArbiterState, Severity
from schemas.messages import Variant
from schemas.reasons import TEXTS, Reason, cure_of
from schemas.recording import RecorderEvent, RecorderEventKind
from tests.support.messages import MS, ROBOT, SECOND
from tests.support.nights import some_by_day
from tests.support.rigs import scenarios
from tests.support.rigs.day import Day
from tests.support.rigs.gateway import GUARDED, WALL_NS, Operator
from tests.support.rigs.recorded import RecordedRig, ask, ask_of, texts
from tests.support.rigs.scenarios import SCENARIOS, Scenario, acted, recorded

HOUR_NS = 3600 * SECOND
DAY_TICKS = 2500
LATCHING = {Reason.FRONT_BUMPER, Reason.REAR_BUMPER, Reason.REMOTE_STOP, Reason.IMPLAUSIBLE_SPEED, Reason.GUARD}
NORMAL = {Reason.DEADMAN, Reason.LEASE_TAKEN, Reason.LEASE_RELEASED, Reason.DISENGAGED, Reason.LEASE_EXPIRED}


HEADLINES = {scenarios.found_moving: "found moving at 0.60 m/s, with no client in command"}
REFUSED = {
    scenarios.stale_commands: Reason.TOO_OLD,
    scenarios.repeated_sequence: Reason.SEQUENCE,
}
"""A deadman with commands that were refused is cured by what makes them acceptable."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where a test's log goes."""
    return tmp_path / "log.mcap"


def _entries(path: Path, *kinds: EntryKind) -> list[Entry]:
    """What ``events`` tells of these kinds."""
    faults = Faults()
    return list(read_events(find_logs([path], faults), Selection(), faults, kinds=frozenset(kinds)))


def data_of(explanation: Explanation, step: Step, name: str) -> object:
    """The first number of this name in a step."""
    return next(link.data[name] for link in explanation.chain if link.step is step and name in link.data)


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda one: one.__name__)
def test_the_last_stop_has_its_cause_its_evidence_and_its_cure(scenario: Scenario, path: Path) -> None:
    """The right reason, shown by the right frame, silence or request, with the right numbers."""
    reason, words = SCENARIOS[scenario]
    explanation = ask(path, recorded(scenario))
    assert explanation.reason is reason, explanation.headline
    assert HEADLINES.get(scenario, TEXTS[reason].means) in explanation.headline
    assert TEXTS[reason].means in texts(explanation, Step.CAUSE)
    shown = texts(explanation, Step.EVIDENCE).lower()
    assert [word for word in words if word.lower() not in shown] == [], shown
    cured = REFUSED.get(scenario, reason)
    assert f"to cure {cured.value}: {cure_of(TEXTS[cured].cure, ROBOT)}" in texts(explanation, Step.CURE)
    assert (f"latched with this stop: {reason.value}" in texts(explanation, Step.LATCH)) is (reason in LATCHING)
    assert explanation.stop_ns == explanation.at_ns


@pytest.mark.parametrize("scenario", some_by_day(list(SCENARIOS), 3), ids=lambda one: one.__name__)
def test_the_same_is_found_where_the_events_are_missing(scenario: Scenario, path: Path) -> None:
    """The states alone tell the reason, and the answer says that they do."""
    reason, _ = SCENARIOS[scenario]
    explanation = ask(path, recorded(scenario, "safety/event"))
    assert explanation.reason is reason, explanation.headline
    assert "for the event is not in the log" in texts(explanation, Step.CAUSE)


@pytest.mark.parametrize("reason", sorted(NORMAL, key=str), ids=str)
def test_a_normal_stop_is_told_as_one(reason: Reason, path: Path) -> None:
    """Ramp at the normal deceleration, standstill, parking brake; time and way as the chassis had them."""
    scenario = next(one for one, (its, _) in SCENARIOS.items() if its is reason)
    explanation = ask(path, recorded(scenario))
    done = texts(explanation, Step.ACTION)
    assert "from 0.60 m/s to zero at 1.2 m/s2, the normal deceleration, in 490 ms" in done
    assert re.search(
        r"zero speed after 490 ms, parking brake after [67]\d0 ms, hold after 7\d0 ms, enables off after 1\.7",
        done,
    )
    assert "stopped: the robot is told nothing, and stands" in done
    assert data_of(explanation, Step.ACTION, "after_s") == pytest.approx(0.64, abs=0.02)
    # Half a second from 0.6 m/s, and the chassis lags by a tenth.
    assert data_of(explanation, Step.ACTION, "distance_m") == pytest.approx(0.21, abs=0.02)


def test_an_emergency_is_told_as_one(path: Path) -> None:
    """The bumper stops with 2 m/s2."""
    done = texts(ask(path, recorded(scenarios.front_bumper)), Step.ACTION)
    assert "from 0.60 m/s to zero at 2.0 m/s2, the emergency deceleration, in 290 ms" in done


def test_a_speed_in_doubt_gives_no_distance(path: Path) -> None:
    """Where the feedback's scale is what was wrong, how far the robot came is not claimed."""
    explanation = ask(path, recorded(scenarios.wrong_scale))
    assert "the speeds are in doubt: the distance is not known" in texts(explanation, Step.ACTION)
    assert data_of(explanation, Step.ACTION, "distance_m") is None


def test_a_way_without_feedback_gives_no_distance(path: Path) -> None:
    """Nobody saw it."""
    explanation = ask(path, recorded(scenarios.found_moving))
    assert "no drive feedback for 670 ms: the distance is not known" in texts(explanation, Step.ACTION)


def test_what_was_commanded_is_told_with_its_numbers(path: Path) -> None:
    """Speed, angle, sequence, operator, and how old it was."""
    explanation = ask(path, recorded(scenarios.deadman))
    assert data_of(explanation, Step.EVIDENCE, "silent_ms") == 310.0
    assert data_of(explanation, Step.EVIDENCE, "limit_ms") == 300.0
    assert data_of(explanation, Step.COMMAND, "requested_speed_mps") == 0.6
    assert data_of(explanation, Step.COMMAND, "operator") == "operator-1"
    assert data_of(explanation, Step.COMMAND, "request_sequence") == 69


def test_a_moment_before_the_stop_shows_the_robot_as_it_was(path: Path) -> None:
    """Engaged, and moving; and that a stop began soon after."""
    rig = acted(scenarios.front_bumper)
    stop_ns = ask(path, rig.log()).at_ns
    explanation = ask(path, rig.log(), stop_ns - 100 * MS)
    assert explanation.state is ArbiterState.ENGAGED
    assert "It was engaged and moved, at 0.60 m/s; 100 ms later a stop began" in explanation.headline
    assert explanation.reason is Reason.FRONT_BUMPER


def test_a_moment_of_driving_is_no_stop(path: Path) -> None:
    """What the robot did, and nothing else."""
    rig = acted(scenarios.deadman)
    stop_ns = ask(path, rig.log()).at_ns
    explanation = ask(path, rig.log(), stop_ns - 1200 * MS)
    assert explanation.reason is Reason.NONE
    assert explanation.headline.startswith("It was engaged and moved, at 0.")
    assert texts(explanation, Step.CAUSE) == ""
    assert "m/s2" in texts(explanation, Step.ARBITER)  # It was speeding up.


def test_a_latch_of_long_ago_is_traced_to_its_frame(path: Path) -> None:
    """A quarter of a minute later the robot is not engaged, and the frame of then is shown."""
    rig, operator = RecordedRig.driving()
    rig.fault("bumper front on for 700ms")
    operator.drive(0.6, 0.0, 0.2)
    rig.rest()
    rig.run(14)
    operator.take_lease()
    assert operator.reason("engage") is Reason.FRONT_BUMPER
    explanation = ask(path, rig.log(), rig.at_ns)
    assert explanation.state is ArbiterState.STANDBY
    assert "FrontBumper = 1" in texts(explanation, Step.EVIDENCE)
    assert "latched with this stop: front_bumper, and no reset of it is in the log" in texts(
        explanation, Step.LATCH
    )
    assert "one engage request of operator-1 was refused" in texts(explanation, Step.COMMAND)


def test_a_stop_that_could_not_be_carried_out_is_the_request(path: Path) -> None:
    """The remote control has the robot: the stop is refused, and latched."""
    rig, _ = RecordedRig.driving()
    rig.fault("transmitter remote for 9s")
    rig.run(1.0)
    rig.put("desk", "stop", b"")
    rig.tick()
    rig.run(1.0)
    explanation = ask(path, rig.log(), rig.at_ns)
    assert "the request itself" not in texts(explanation, Step.MISSING)
    said = texts(explanation, Step.EVIDENCE)
    assert "the request was stop, of desk" in said
    assert "; it was refused: the hand transmitter has the robot; latched; not carried out" in said


def test_another_latch_than_that_of_the_stop_has_evidence_of_its_own(path: Path) -> None:
    """A remote stop that came to a stopped robot is found although it stopped nothing."""
    rig, _ = RecordedRig.driving()
    rig.rest_after(1.0)
    rig.put("desk", "stop", b"")
    rig.tick()
    rig.run(14)
    explanation = ask(path, rig.log(), rig.at_ns)
    assert explanation.reason is Reason.DEADMAN
    assert explanation.headline.startswith("It was not engaged, and was latched 14.0")
    assert "s before that moment: a remote stop was received" in explanation.headline
    assert "it could not be engaged: a remote stop was received" in texts(explanation, Step.CAUSE)
    assert "the request was stop, of desk" in texts(explanation, Step.EVIDENCE)
    assert "to cure remote_stop: reset with 'cruiser reset cruiser-1'" in texts(explanation, Step.CURE)


def _another(dead_ns: int, later_s: float = 3, note: str = "", ended: str = "") -> RecordedRig:
    """A gateway that begins so long after another one died, and finds this note of its guard."""
    rig = RecordedRig.beginning(dead_ns + round(later_s * SECOND), run=2)
    if note:
        rig.core.latch_guard_stop(note, rig.now_ns)
    rig.run(1)
    if ended:
        rig.links = msgspec.structs.replace(rig.links, guard_says=ended)
    rig.run(3)
    return rig


NOTE = "2026-11-22T06:00:00.000+00:00 guard: the gateway is gone, last heartbeat 51 ms ago: stopping the robot"


def _dead_gateway(
    tmp_path: Path, later_s: float = 3, note: str = "", ended: str = "", recorder_says: str = ""
) -> int:
    """A stop, an engagement, and a gateway that dies while the robot drives; another begins 3 s later.

    Args:
        tmp_path: of the logs.
        later_s: so much later.
        note: what the guard had written down by then.
        ended: how its stop ended, as the other gateway says a second after that.
        recorder_says: of the death.

    Returns:
        when the one was last heard.
    """
    rig, _ = RecordedRig.driving(run=1)
    rig.rest_after(1.0)
    rig.run(2)
    operator = Operator(rig, "operator-2")
    operator.engage()
    operator.drive(0.6, 0.0, 1.5)
    dead_ns = rig.at_ns
    event = RecorderEventKind.GATEWAY
    said = RecorderEvent(dead_ns + MS, 0, Severity.ERROR, event, ROBOT, "", "", recorder_says)
    (tmp_path / "one.mcap").write_bytes(rig.log(recorder_says=[said] if recorder_says else []))
    (tmp_path / "two.mcap").write_bytes(_another(dead_ns, later_s, note, ended).log())
    return dead_ns


def test_a_gateway_that_died_is_told_and_no_stop_of_before(tmp_path: Path) -> None:
    """Between the two gateways, and after the next has begun: the old stop was cured, and is no answer."""
    dead_ns = _dead_gateway(tmp_path)
    between = ask_of([tmp_path], dead_ns + SECOND)
    assert between.is_answered
    assert (between.state, between.reason, between.stop_ns) == (None, Reason.NONE, None)
    assert abs((between.silent_ns or 0) - dead_ns) <= 60 * MS
    assert "The gateway fell silent 1.0" in between.headline
    assert "before that moment, engaged, at 0.60 m/s; another run began 2.0" in between.headline
    assert "deadman" not in texts(between, Step.CAUSE)
    after = ask_of([tmp_path], dead_ns + 3500 * MS)
    assert (after.state, after.reason, after.stop_ns) == (ArbiterState.STANDBY, Reason.NONE, None)
    assert after.headline.startswith("It was not engaged: nobody holds the lease")
    assert "The gateway fell silent 3.5" in after.headline
    assert after.silent_ns == between.silent_ns


@pytest.mark.parametrize("later_s", [3, 40])
@pytest.mark.parametrize("after_ns", [None, -400 * MS, SECOND])
def test_what_the_guard_of_a_dead_gateway_did_is_told_by_the_next(
    later_s: float, after_ns: int | None, tmp_path: Path
) -> None:
    """In the guard's own words, soon or late: those of its note, and those that came later; and that one began."""
    ended = "the robot stands; 180 frames sent"
    gone = "the gateway died, or the link to it: its token is gone, and it was engaged, and told 0.60 m/s"
    dead_ns = _dead_gateway(tmp_path, later_s, NOTE, ended, gone)
    explanation = ask_of([tmp_path], None if after_ns is None else dead_ns + after_ns)
    assert abs((explanation.silent_ns or 0) - dead_ns) <= 60 * MS, explanation.headline
    did = texts(explanation, Step.ACTION)
    assert f"the guard's note, found at the next start: {NOTE}" in did
    assert f"the guard's stop has ended: {ended}" in did
    assert "another run of the gateway began" in texts(explanation, Step.CAUSE)
    assert "guard" not in texts(explanation, Step.MISSING)


def _killed_again_and_again(tmp_path: Path) -> list[int]:
    """Three gateways that are killed 6 s apart while the robot drives; after the last one the log ends.

    Each says what the chassis does for 400 ms before its arbiter says anything, as a gateway does that starts.

    Returns:
        when each of them was last heard.
    """
    deaths: list[int] = []
    for run in (1, 2, 3):
        began_ns = deaths[-1] + 300 * MS if deaths else WALL_NS
        rig = RecordedRig.beginning(began_ns, run)
        rig.run(1.5)
        operator = Operator(rig, "operator-1")
        operator.engage()
        operator.drive(0.6, 0.0, 4.0)
        deaths.append(rig.at_ns)
        rig.recorded = [
            (at_ns, sample)
            for at_ns, sample in rig.recorded
            if sample.subject != "safety/state" or at_ns > began_ns + 400 * MS
        ]
        (tmp_path / f"{run}.mcap").write_bytes(rig.log())
    return deaths


def test_a_death_is_dated_as_in_events_whatever_the_next_gateway_says_first(tmp_path: Path) -> None:
    """What it says before its arbiter does is no sign of life of the dead one; the newest death is the answer."""
    *deaths, last_ns = _killed_again_and_again(tmp_path)
    entries = _entries(tmp_path, EntryKind.GATEWAY)
    assert len(entries) == len(deaths)
    for dead_ns in deaths:
        for after_ns in (100 * MS, 600 * MS, SECOND):
            explanation = ask_of([tmp_path], dead_ns + after_ns)
            heard_ns = explanation.silent_ns or 0
            assert dead_ns - 60 * MS <= heard_ns <= dead_ns, (after_ns, explanation.headline)
            assert ", engaged, at 0.60 m/s; another run began" in explanation.headline
    latest = ask_of([tmp_path])
    assert abs((latest.silent_ns or 0) - deaths[-1]) <= 60 * MS
    behind = ask_of([tmp_path], last_ns + SECOND)
    assert behind.silent_ns is None, "the death of another gateway, 7 s before, is no answer"
    assert behind.headline.startswith("The log does not hold that moment")


def test_a_stop_that_was_followed_by_an_engagement_is_no_answer(path: Path) -> None:
    """Where the log has no state to tell what was then, the stop of before is not taken for it."""
    rig, _ = RecordedRig.driving()
    rig.rest_after(1.0)
    stopped_ns = rig.at_ns
    operator = Operator(rig, "operator-2")
    operator.engage()
    operator.drive(0.6, 0.0, 1.5)
    data = rig.log(without=("safety/state",))
    assert ask(path, data, stopped_ns).reason is Reason.DEADMAN
    explanation = ask(path, data, rig.at_ns)
    assert (explanation.reason, explanation.stop_ns) == (Reason.NONE, None)
    assert not explanation.is_answered


def test_a_stop_of_long_ago_is_no_answer_where_no_state_is(path: Path) -> None:
    """What was since is not known; the stop is named, and said not to be the answer."""
    rig, _ = RecordedRig.driving()
    rig.rest_after(1.0)
    rig.run(15)
    explanation = ask(path, rig.log(without=("safety/state",)), rig.at_ns)
    assert (explanation.reason, explanation.stop_ns) == (Reason.NONE, None)
    assert not explanation.is_answered
    assert "what was since the last stop, 17.46 s before" in texts(explanation, Step.MISSING)


def test_of_a_stop_and_a_death_the_later_one_is_explained(tmp_path: Path) -> None:
    """Without a moment: the gateway that died while the robot drove, and not the stop that was cured before it."""
    dead_ns = _dead_gateway(tmp_path)
    explanation = ask_of([tmp_path])
    assert abs(explanation.at_ns - dead_ns) <= 60 * MS
    assert (explanation.reason, explanation.silent_ns is None) == (Reason.NONE, False)
    assert explanation.headline.startswith("It was engaged and moved, at 0.60 m/s. The gateway fell silent")
    alone = ask_of([tmp_path / "one.mcap"])
    assert alone.reason is Reason.DEADMAN


def test_a_stop_behind_a_death_is_the_last_thing(tmp_path: Path) -> None:
    """The gateway that came after the dead one has stopped the robot since."""
    first, _ = RecordedRig.driving(run=1)
    second = RecordedRig.beginning(first.at_ns + 3 * SECOND, run=2)
    second.run(0.6)
    operator = Operator(second, "operator-2")
    operator.engage()
    operator.drive(0.6, 0.0, 1.0)
    second.put("desk", "stop", b"")
    second.tick()
    second.rest()
    (tmp_path / "one.mcap").write_bytes(first.log())
    (tmp_path / "two.mcap").write_bytes(second.log())
    assert ask_of([tmp_path]).reason is Reason.REMOTE_STOP


@pytest.mark.parametrize(("before_ns", "words"), [(400 * MS, "4"), (60 * MS, "")])
def test_a_death_right_after_the_moment_is_told(before_ns: int, words: str, tmp_path: Path) -> None:
    """As a stop would be; with the guard that watched, and what the next gateway found."""
    dead_ns = _dead_gateway(tmp_path)
    explanation = ask_of([tmp_path], dead_ns - before_ns)
    assert explanation.state is ArbiterState.ENGAGED
    assert f"m/s. The gateway fell silent {words}" in explanation.headline
    assert "after that moment, engaged, at 0.60 m/s; another run began 3." in explanation.headline
    assert "what the guard did, which watched the gateway" in texts(explanation, Step.MISSING)
    assert "in the first drive feedback of the next gateway, the robot stood" in texts(explanation, Step.EVIDENCE)
    assert "silent" not in ask_of([tmp_path], dead_ns - 1200 * MS).headline


def test_a_recording_that_ends_at_work_is_said_to_end(path: Path) -> None:
    """Whether the gateway died nobody can tell then."""
    rig, operator = RecordedRig.driving()
    operator.drive(0.6, 0.0, 2.0)
    ends = "not in the log: the seconds behind this: the gateway died, or the recording ended"
    assert ends in texts(ask(path, rig.log(), rig.at_ns - 200 * MS), Step.MISSING)
    assert ends not in texts(ask(path, rig.log(), rig.at_ns - 1500 * MS), Step.MISSING)


def test_a_stop_of_another_run_is_no_answer(tmp_path: Path) -> None:
    """The robot was not engaged since, but the gateway that stopped it is gone, with all that it held."""
    rig, _ = RecordedRig.driving(run=1)
    rig.rest_after(1.0)
    (tmp_path / "one.mcap").write_bytes(rig.log())
    (tmp_path / "two.mcap").write_bytes(_another(rig.at_ns).log())
    assert ask_of([tmp_path], rig.at_ns).reason is Reason.DEADMAN
    for later_ns in (SECOND, 3500 * MS):
        explanation = ask_of([tmp_path], rig.at_ns + later_ns)
        assert (explanation.reason, explanation.stop_ns) == (Reason.NONE, None)
        assert "standby, standing; another run began" in explanation.headline


def test_a_moment_that_a_table_shows_is_that_of_the_stop(path: Path) -> None:
    """It is rounded, and may be a bit before it."""
    data = recorded(scenarios.found_moving)
    explanation = ask(path, data)
    assert ask(path, data, explanation.at_ns - MS).stop_ns == explanation.stop_ns


def test_what_waited_for_the_recorder_is_where_it_was_said(path: Path) -> None:
    """States and feedback of seconds that came in one burst: no clock is wrong for that."""
    rig, operator = RecordedRig.driving()
    operator.drive(0.6, 0.0, 3.0)
    at_ns = rig.at_ns
    operator.drive(0.3, 0.0, 1.0)
    rig.rest_after(1.0)
    in_time = ask(path, rig.log(), at_ns)
    kept = rig.recorded
    rig.recorded = [(max(one_ns, at_ns + 500 * MS), sample) for one_ns, sample in kept]
    data = rig.log()
    rig.recorded = kept
    late = ask(path, data, at_ns)
    assert late.headline == in_time.headline
    for step in (Step.MOTION, Step.ARBITER, Step.COMMAND):
        assert texts(late, step) == texts(in_time, step)


def test_a_parked_robot_stands_because_it_is_parked(path: Path) -> None:
    """Engaged, asked for a speed, and told none."""
    rig, operator = RecordedRig.ready()
    operator.take_lease()
    operator.ask("engage")
    rig.run(0.2)
    operator.drive(0.5, 0.0, 0.5)
    explanation = ask(path, rig.log(), rig.at_ns)
    assert explanation.headline == "It was engaged and stood: the parking brake is applied."
    assert "no speed is commanded until unpark" in texts(explanation, Step.ARBITER)
    assert "asked for 0.50 m/s, 0.0 deg; commanded was 0.00 m/s" in texts(explanation, Step.COMMAND)
    assert "to cure parked: allow drive commands to release it: 'cruiser unpark cruiser-1" in texts(
        explanation, Step.CURE
    )


def test_a_robot_that_rolls_is_not_said_to_stand(path: Path) -> None:
    """It is slower than what counts as standing, and its speed is not nothing."""
    rig, operator = RecordedRig.ready()
    operator.engage()
    operator.drive(0.5, 0.0, 0.28)
    explanation = ask(path, rig.log(), rig.at_ns)
    assert "and hardly moved, at 0.04 m/s" in explanation.headline
    assert "it hardly moved, at 0.04 m/s" in texts(explanation, Step.MOTION)
    assert "stood" not in texts(explanation, Step.MOTION) + explanation.headline


def test_zero_speed_is_nobodys_fault(path: Path) -> None:
    """It stands because its operator says so."""
    rig, operator = RecordedRig.ready()
    operator.engage()
    operator.drive(0.0, 0.0, 0.5)
    assert "operator-1 requested zero speed" in ask(path, rig.log(), rig.at_ns).headline


def test_a_robot_that_nobody_has_engaged_stands_for_that(path: Path) -> None:
    """And its cure is told."""
    rig, _ = RecordedRig.ready()
    rig.run(1)
    explanation = ask(path, rig.log(), rig.at_ns)
    assert "nobody holds the lease" in explanation.headline
    assert "to cure not_engaged: engage with 'cruiser drive cruiser-1'" in texts(explanation, Step.CURE)
    assert explanation.reason is Reason.NONE


def test_a_robot_whose_clock_is_wrong_gets_the_same_answer(path: Path) -> None:
    """An hour ahead, or behind: the times are those of the recorder."""
    for ahead_ns in (HOUR_NS, -HOUR_NS):
        rig = acted(scenarios.one_silent_frame)
        rig.robot_ahead_ns = ahead_ns
        data = rig.log()
        rig.robot_ahead_ns = 0
        explanation = ask(path, data)
        assert explanation.reason is Reason.FEEDBACK_MISSING
        assert "came 110 ms before the stop" in texts(explanation, Step.EVIDENCE)
        assert abs(explanation.at_ns + ahead_ns - ask(path, rig.log()).at_ns) < 50 * MS


@cache
def _day() -> bytes:
    """The log of a day whose robot sets its clock by hours, and whose recorder does not."""
    day = Day(6, Variant.COARSE, DAY_TICKS)
    day.live()
    return day.rig.log()


def test_what_was_said_at_another_time_is_none_of_the_moment_s(path: Path) -> None:
    """A decision that is told after the clock was set back by hours may bear any time, and is none of before."""
    path.write_bytes(_day())
    engaged = _entries(path, EntryKind.ENGAGED)
    assert len(engaged) == 3
    for one in engaged:
        chain = ask_of([path], one.time_ns + 5 * MS).chain
        far_ns = [abs((link.time_ns or one.time_ns) - one.time_ns) for link in chain if link.step is Step.COMMAND]
        assert max(far_ns, default=0) < 15 * SECOND


def test_of_a_day_in_which_everything_happens_every_stop_is_explained(path: Path) -> None:
    """Each by its own reason, although the robot's clock is set by hours in between."""
    path.write_bytes(_day())
    entries = _entries(path, *ENDS, EntryKind.CLOCK)
    assert EntryKind.CLOCK in {one.kind for one in entries}
    stops = [one for one in entries if one.reason is not Reason.NONE]
    assert len({one.reason for one in stops}) > 3
    for stop in stops:
        explanation = ask_of([path], stop.time_ns)
        assert explanation.reason is stop.reason, explanation.headline
        assert abs((explanation.stop_ns or 0) - stop.time_ns) <= 20 * MS


def test_limits_are_those_of_the_log_or_said_to_be_the_start_values(path: Path) -> None:
    """The configuration is an attachment; without it nothing is claimed."""
    rig = acted(scenarios.deadman)
    assert "the limit is 300 ms (by its configuration)" in texts(ask(path, rig.log()), Step.EVIDENCE)
    without = ask(path, rig.log(with_info=False))
    assert "the start value; no configuration is in the log" in texts(without, Step.EVIDENCE)


@pytest.mark.parametrize(
    ("scenario", "missing", "says"),
    [
        (scenarios.one_silent_frame, ("can/{bus}/rx", "journal"), "not in the log: the raw frames of this time"),
        (scenarios.checksums, ("can/{bus}/rx", "journal"), "not in the log: the raw frames of this time"),
        (
            scenarios.other_commander,
            ("can/{bus}/rx", "journal"),
            "not in the log: the frames of the other computer",
        ),
        (scenarios.deadman, ("safety/decision",), "not in the log: the requests of this time"),
        (scenarios.lease_expired, ("safety/decision",), "not in the log: the requests of this time"),
        (scenarios.remote_stop, ("safety/decision",), "not in the log: the request itself (stop)"),
        (scenarios.deadman, ("chassis/drive",), "not in the log: the drive feedback of this time"),
        (
            scenarios.deadman,
            ("safety/state", "safety/event"),
            "not in the log: the arbiter's state at this moment",
        ),
    ],
)
def test_what_the_log_does_not_show_is_said(
    scenario: Scenario, missing: tuple[str, ...], says: str, path: Path
) -> None:
    """Nothing is claimed of it."""
    explanation = ask(path, recorded(scenario, *missing))
    assert says in texts(explanation, Step.MISSING)


def test_decoded_frames_stand_in_for_raw_ones(path: Path) -> None:
    """The bumper is seen in chassis/body, and the answer says that there is nothing rawer."""
    explanation = ask(path, recorded(scenarios.front_bumper, "can/{bus}/rx", "journal"))
    assert "chassis/body said front_bumper = True" in texts(explanation, Step.EVIDENCE)


def test_the_journal_stands_in_for_raw_frames(path: Path) -> None:
    """A gateway that publishes no raw frames has them in its journal all the same."""
    whole, without = (ask(path, recorded(scenarios.front_bumper, *gone)) for gone in ((), ("can/{bus}/rx",)))
    assert "frame 0x18C4D9EF" in texts(without, Step.EVIDENCE)
    assert texts(without, Step.EVIDENCE) == texts(whole, Step.EVIDENCE)


@cache
def starved(early_ticks: int = 0) -> RecordedRig:
    """A driven robot whose gateway does not get to read its bus for 120 ms.

    Args:
        early_ticks: before that its frames were read so many ticks late.
    """
    rig, _ = RecordedRig.driving()
    unread: list[tuple[int, Frame]] = []

    def hold(frame: Frame) -> None:
        unread.append((rig.now_ns, frame))

    def read(until_ns: int) -> None:
        while unread and unread[0][0] <= until_ns:
            rig.core.receive_frame(unread.pop(0)[1], rig.now_ns)

    rig.corrupt = hold
    for _ in range(4 if early_ticks else 0):
        rig.tick()
        read(rig.now_ns - early_ticks * 10 * MS)
    rig.tick(12)
    rig.corrupt = lambda frame: frame
    read(rig.now_ns)
    rig.rest()
    return rig


def test_a_silence_is_shown_by_when_the_arbiter_was_given_the_frames(path: Path) -> None:
    """The bus had them all the time, and a starved gateway did not read them: no frame contradicts the stop."""
    explanation = ask(path, starved().log())
    assert explanation.reason is Reason.FEEDBACK_MISSING
    silences = [link for link in explanation.chain if "waiting" in link.data]
    assert len(silences) == 4
    for link in silences:
        assert link.data["limit_ms"] == 100
        assert link.data["age_ms"] == 110
        assert link.data["waiting"] == 11
        assert "came 110 ms before the stop, the limit is 100 ms" in link.text
        assert link.text.endswith(
            "the bus had 11 more by then, the last at the stop, which the arbiter had not been given"
        )


def test_frames_that_were_not_read_are_counted(path: Path) -> None:
    """A gateway that does not keep up: so many were waiting, by the bus's and the journal's times."""
    rig, _ = RecordedRig.driving()
    unread: list[Frame] = []
    rig.corrupt = unread.append
    rig.links = msgspec.structs.replace(GUARDED, is_behind=True)
    rig.tick()
    waiting = len(unread)
    rig.corrupt = lambda frame: frame
    rig.links = GUARDED
    for frame in unread:
        rig.core.receive_frame(frame, rig.now_ns)
    rig.rest()
    explanation = ask(path, rig.log())
    assert explanation.reason is Reason.FEEDBACK_LATE
    assert waiting > 0
    assert data_of(explanation, Step.EVIDENCE, "waiting") == waiting
    assert f"the arbiter had not been given {waiting} that the bus had" in texts(explanation, Step.EVIDENCE)


def test_a_frame_that_waited_says_for_how_long(path: Path) -> None:
    """The bus had it 20 ms before the arbiter was given it."""
    explanation = ask(path, starved(early_ticks=2).log())
    silence = next(link for link in explanation.chain if "waiting" in link.data)
    assert "came 110 ms before the stop (the bus had it 20.0 ms earlier), the limit is 100 ms" in silence.text
    assert (silence.data["age_ms"], silence.data["bus_age_ms"], silence.data["waiting"]) == (110, 130, 13)


def test_without_the_journal_it_is_said_that_the_time_is_that_of_the_bus(path: Path) -> None:
    """It may contradict the stop, and the answer says why."""
    explanation = ask(path, starved().log(without=("journal",)))
    shown = texts(explanation, Step.EVIDENCE)
    assert "the last Auto_GearFeedBack came at the stop, the limit is 100 ms" in shown
    assert "when the arbiter was given the frames is not in the log" in shown


def test_a_death_that_a_recorder_saw_is_told_where_no_other_gateway_follows(path: Path) -> None:
    """The log ends with it: at the moment, soon before and long after it, and where no moment is asked about."""
    rig, operator = RecordedRig.driving()
    operator.drive(0.6, 0.0, 2.0)
    dead_ns = rig.at_ns
    words = "the gateway died, or the link to it: its token is gone, and it was engaged, and told 0.60 m/s"
    said = RecorderEvent(dead_ns, 0, Severity.ERROR, RecorderEventKind.GATEWAY, ROBOT, "", "", words)
    data = rig.log(recorder_says=[said])
    for at_ns in (None, dead_ns - 200 * MS, dead_ns + SECOND, dead_ns + 30 * SECOND):
        explanation = ask(path, data, at_ns)
        if at_ns is not None and at_ns > dead_ns + 2 * SECOND:
            assert "The log does not hold that moment" in explanation.headline
            continue
        assert explanation.silent_ns == dead_ns, explanation.headline
        assert words in explanation.headline
        assert words in texts(explanation, Step.CAUSE)
        assert "is not told" not in texts(explanation, Step.MISSING)
    assert ask(path, data, dead_ns - 1500 * MS).silent_ns is None


@pytest.mark.parametrize("seconds", [0.13, 0.5, 2.0, 3.0])
@pytest.mark.parametrize("after_s", [0.05, 0.4, 1.5])
def test_a_gateway_that_hung_is_not_told_as_dead(seconds: float, after_s: float, path: Path) -> None:
    """The guard's stop is told with its first frame, its standstill and its distance, by the times of the bus."""
    rig, _ = RecordedRig.driving(0.8)
    heard_ns = rig.at_ns
    words = "the gateway died, or the link to it: its token is gone, and it was engaged"
    gone = RecorderEvent(heard_ns + 30 * MS, 0, Severity.ERROR, RecorderEventKind.GATEWAY, ROBOT, "", "", words)
    rig.hang(seconds)
    rig.run(4.0)
    explanation = ask(path, rig.log(recorder_says=[gone]), heard_ns + round(after_s * SECOND))
    assert explanation.headline.startswith("The gateway's loop stood still for ")
    assert "the guard began to stop the robot" in explanation.headline
    assert (explanation.reason, explanation.silent_ns) == (Reason.GUARD, None)
    began_ms = ((explanation.stop_ns or 0) - heard_ns) / MS
    assert 80 <= began_ms <= 100
    assert data_of(explanation, Step.ACTION, "after_s") == pytest.approx(0.45, abs=0.25)
    assert data_of(explanation, Step.ACTION, "distance_m") == pytest.approx(0.2, abs=0.12)
    told = explanation.headline + "".join(link.text for link in explanation.chain)
    assert "died" not in told
    assert "another run" not in told


@pytest.mark.parametrize("after_s", [0.0, 1.0])
def test_where_the_guard_died_too_the_way_is_told_by_the_first_frames_of_the_next_gateway(
    after_s: float, tmp_path: Path
) -> None:
    """It drove on at its last command, and stood only once the next gateway had found it moving."""
    first, _ = RecordedRig.driving(0.8, run=1)
    dead_ns = first.at_ns
    second = first.followed(2.8)
    second.run(4.0)
    (tmp_path / "one.mcap").write_bytes(first.log())
    (tmp_path / "two.mcap").write_bytes(second.log())
    explanation = ask_of([tmp_path], dead_ns + round(after_s * SECOND))
    assert "still moved, at 0.80 m/s: it drove on for at least 2." in texts(explanation, Step.EVIDENCE)
    assert "; it stood after " in texts(explanation, Step.EVIDENCE)
    assert "the next gateway found: " in texts(explanation, Step.ACTION)
    assert "not in the log: what the guard did" in texts(explanation, Step.MISSING)


def test_a_clock_that_is_set_back_leaves_the_last_stop_the_last(path: Path) -> None:
    """Robot and recorder share the clock: the later stop has the earlier time."""
    rig, operator = RecordedRig.driving()
    rig.put("desk", "stop", b"")
    rig.rest_after(1.0)
    rig.wall_ns -= HOUR_NS
    rig.recorder_ns -= HOUR_NS
    operator.take_lease()
    operator.reset()
    operator.ask("engage")
    operator.drive(0.6, 0.0, 1.5)
    rig.rest_after(1.0)
    explanation = ask(path, rig.log())
    assert explanation.reason is Reason.DEADMAN, explanation.headline
    assert [one.kind for one in _entries(path, EntryKind.CLOCK, EntryKind.GAP)] == [EntryKind.CLOCK]
