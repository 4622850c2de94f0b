"""All of one robot, from its messages one by one."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import END_OF_TIME_NS, Row
from recorder.reading.topics import Topic
from recorder.review.drives import ENTRIES_MAX
from recorder.review.events import Timeline
from recorder.review.report.account import (
    DRIVERS_MAX,
    FAULTS_MAX,
    OTHERS,
    REFUSALS_MAX,
    REMOTE_CONTROL,
    Account,
)
from recorder.review.report.findings import Drawn, RobotReport, RobotSummary
from schemas.decisions import ArbiterState, EventKind, Verdict
from schemas.messages import Message, Mode
from schemas.reasons import Reason
from tests.support.drives import drive_messages
from tests.support.messages import PERIOD_NS, SECOND, WALL_NS, arbiter, event, health, key_of, refusal, state


def row_of(message: Message, log_ns: int) -> Row:
    """A row that has been decoded already."""
    key = key_of(type(message))
    topic = Topic(key, "", "", "", b"", type(message), "cruiser-1", "cruiser-1", "", lambda _: message)
    return Row(topic, message.sequence, log_ns, message.time_ns, b"")


def report_of(
    *messages: Message,
    off_ns: int = 0,
    late: Sequence[tuple[int, Message]] = (),
    spans: Sequence[tuple[int, int]] = (),
    to_ns: int = END_OF_TIME_NS,
) -> RobotReport:
    """Of messages that were received when they were sent, by a clock that is so much ahead; then of late ones.

    They stand in logs that go from and to these times, read up to ``to_ns``.
    """
    account = Account("cruiser-1", "fleet/cruiser-1")
    timeline = Timeline(Faults())
    for log_ns, message in [*((message.time_ns + off_ns, message) for message in messages), *late]:
        account.take(message, message.time_ns, log_ns)
        timeline.take(row_of(message, log_ns), message)
    logs = [LogFile(Path("log.mcap"), 1, *span, frozenset({("fleet", "cruiser-1")})) for span in spans]
    for ending in timeline.endings(logs, to_ns):
        account.end(ending)
    for entry in timeline.end():
        account.take_entry(entry)
    report = account.sum_up({}, {})
    assert report is not None
    return report


def summary_of(*messages: Message) -> RobotSummary:
    """In figures."""
    return report_of(*messages).summary


def charts_of(*messages: Message) -> Drawn:
    """Over time."""
    (drawn,) = report_of(*messages).drawn
    return drawn


def test_a_drive_in_figures() -> None:
    """How far, how fast, how often stopped and why, who drove, what was refused."""
    summary = summary_of(*drive_messages(201))
    assert summary.distance_m == pytest.approx(10.0)
    assert [summary.moving_s, summary.known_s, summary.top_mps] == pytest.approx([10.0, 10.0, 1.0])
    assert (summary.start_ns, summary.end_ns) == (WALL_NS, WALL_NS + 200 * PERIOD_NS)
    assert summary.stops == {"front_bumper": 1}
    (driver,) = summary.drivers
    # The first state came before anybody was known to drive.
    assert driver.name == "operator-1"
    assert driver.seconds == pytest.approx(10.0, abs=0.06)
    assert driver.distance_m == pytest.approx(10.0, abs=0.06)
    (refused,) = summary.refusals
    assert (refused.request, refused.operator, refused.reason, refused.count) == (
        "drive",
        "operator-2",
        "no_lease",
        1,
    )


def test_who_drives_is_told_by_mode_and_lease() -> None:
    """The remote control in remote; the holder of the lease while engaged; nobody else."""
    messages: list[Message] = [state(0)]
    for number in range(1, 61):
        engaged = ArbiterState.ENGAGED if number <= 20 else ArbiterState.STANDBY
        mode = Mode.REMOTE if number > 40 else Mode.AUTO
        messages += [arbiter(number, state=engaged), state(number, mode=mode)]
    seconds = {driver.name: driver.seconds for driver in summary_of(*messages).drivers}
    assert seconds == {"operator-1": pytest.approx(1.0), REMOTE_CONTROL: pytest.approx(1.0)}


def test_what_is_there_twice_counts_once() -> None:
    """As in an incident beside its log."""
    once = summary_of(*drive_messages())
    twice = summary_of(*(message for message in drive_messages() for _ in range(2)))
    assert twice == once


def test_commands_are_drawn_while_the_chassis_is_told_something() -> None:
    """In standby the line is broken; the limits are always drawn."""
    messages = [
        arbiter(number, state=ArbiterState.STANDBY if 5 <= number < 9 else ArbiterState.ENGAGED)
        for number in range(12)
    ]
    lines = charts_of(*messages).lines
    assert [point is None for point in lines["output_speed_mps"]] == [False] * 5 + [True] + [False] * 3
    assert None not in lines["speed_limit_mps"]


def test_what_was_asked_for_is_drawn_while_it_holds() -> None:
    """The state repeats the last command while the robot is stopped; nobody asks for that any more."""
    was = {5: ArbiterState.STOPPING, 6: ArbiterState.STOPPING, 7: ArbiterState.ENGAGING}
    messages = [arbiter(number, state=was.get(number, ArbiterState.ENGAGED)) for number in range(12)]
    lines = charts_of(*messages).lines
    for line in ("target_speed_mps", "target_angle_deg"):
        drawn = [None if point is None else (point[0] - WALL_NS) // PERIOD_NS for point in lines[line]]
        assert drawn == [0, 1, 2, 3, 4, None, 8, 9, 10, 11]
    assert None not in lines["output_speed_mps"]


def test_values_that_are_no_numbers_are_not_drawn() -> None:
    """Neither are those that the robot does not know."""
    lines = charts_of(
        *(state(number, speed_mps=(None, float("nan"), 1.0)[number % 3]) for number in range(9))
    ).lines
    assert [point[1] for point in lines["speed_mps"] if point is not None] == [1.0] * 3
    assert lines["speed_mps"].count(None) == 2


def test_an_event_is_placed_on_the_path() -> None:
    """Where the robot was then, whenever the event was asked for."""
    charts = charts_of(*(state(number) for number in range(101)), event(40))
    (moment,) = charts.moments
    assert [moment.x_m, moment.y_m] == pytest.approx([2.0, 0.0], abs=0.06)


def test_what_was_asked_for_later_stands_where_it_happened() -> None:
    """By the robot's time, though it was received long after."""
    late = event(20)
    drive_on = (one for number in range(100) for one in (state(number), arbiter(number)))
    report = report_of(*drive_on, late=[(late.time_ns + 60 * SECOND, late)])
    assert [moment.time_ns for moment in report.moments] == [late.time_ns]
    assert report.summary.end_ns < WALL_NS + 10 * SECOND


def test_a_clock_that_is_years_off_is_not_believed() -> None:
    """The time axis is the recorder's then, for all that is said, and has no hole of years."""
    summary = report_of(*drive_messages(), off_ns=50 * 365 * 24 * 3600 * SECOND).summary
    assert (summary.end_ns - summary.start_ns) == 199 * PERIOD_NS
    assert summary.gaps == 0


def test_health_counts_what_came_while_the_log_was_written() -> None:
    """Not what was before; a gateway that began anew counts from 0."""
    summary = summary_of(
        health(0, lost=5), health(20, lost=7), health(40, lost=3, losses=1), health(60, lost=3, losses=1)
    )
    assert summary.health == {"lost frames": 5, "losses of the bus": 1}


def test_faults_that_no_frame_counts_are_counted_too() -> None:
    """By kind, in the words of the events; what the frames count is not said twice."""
    summary = summary_of(
        health(0, lost=0, faults={"period": 4}),
        health(20, lost=1, faults={"period": 15, "silence": 10, "alive_lost": 1}),
        health(40, lost=0, faults={"period": 2}),
    )
    assert summary.health == {
        "lost frames": 1,
        "faults of frames: period": 13,
        "faults of frames: silence": 10,
    }


def test_kinds_of_faults_without_end_cost_no_memory_without_end() -> None:
    """A damaged log may hold any."""
    summary = summary_of(
        *(health(number, lost=0, faults={f"kind-{number}": 1}) for number in range(2 * FAULTS_MAX))
    )
    assert 0 < len(summary.health) <= FAULTS_MAX


def test_names_without_end_cost_no_memory_without_end() -> None:
    """Operators can be made up: the first ones are told one by one, the others are counted."""
    messages: list[Message] = [state(0)]
    many = 3 * max(DRIVERS_MAX, REFUSALS_MAX)
    for number in range(1, many + 1):
        name = f"operator-{number}"
        messages += [arbiter(number, lease_holder=name), state(number), refusal(number, operator=name)]
    summary = summary_of(*messages, *(event(number) for number in range(ENTRIES_MAX + 5)))
    assert len(summary.drivers) == DRIVERS_MAX + 1
    assert OTHERS in {driver.name for driver in summary.drivers}
    assert (len(summary.refusals), summary.refused) == (REFUSALS_MAX, many)
    assert summary.other_refusals == many - REFUSALS_MAX
    assert summary.stops == {"front_bumper": 1}
    report = report_of(*(event(number) for number in range(ENTRIES_MAX + 5)))
    assert (len(report.moments), report.more_moments) == (ENTRIES_MAX, 5)


def test_accepted_requests_and_other_events_are_no_stops() -> None:
    """They are counted as what they are."""
    accepted = refusal(1, verdict=Verdict.ACCEPTED, reason=Reason.NONE)
    summary = summary_of(accepted, event(2, EventKind.ENGAGED))
    assert (summary.accepted, summary.refused, summary.stops, summary.events) == (1, 0, {}, {"engaged": 1})


def test_a_robot_that_said_nothing_is_no_report() -> None:
    """It was only named."""
    assert Account("cruiser-1", "fleet/cruiser-1").sum_up({}, {}) is None


@pytest.mark.parametrize("engaged", [ArbiterState.ENGAGED, ArbiterState.STOPPING, ArbiterState.STANDBY])
def test_a_log_that_ends_in_the_middle_of_a_drive_says_so(engaged: ArbiterState) -> None:
    """What came after is not known; in standby there is nothing to say."""
    report = report_of(
        *(arbiter(number, state=engaged) for number in range(5)), spans=[(WALL_NS, WALL_NS + 5 * PERIOD_NS)]
    )
    assert report.summary.ends_commanding is (engaged is not ArbiterState.STANDBY)
    told = [(moment.kind, moment.severity, moment.text) for moment in report.moments]
    ends = ("gap", "warning", f"the log ends here: {engaged.value}, commanded 1.00 m/s")
    assert told == [ends] * report.summary.ends_commanding


def test_a_period_that_ends_in_the_middle_of_a_drive_is_no_end_of_the_log() -> None:
    """The log goes on."""
    report = report_of(
        *(arbiter(number) for number in range(5)),
        spans=[(WALL_NS, WALL_NS + 60 * SECOND)],
        to_ns=WALL_NS + 5 * PERIOD_NS,
    )
    assert not report.summary.ends_commanding
    assert report.summary.outages == []


def test_a_period_that_ends_in_a_pause_of_the_recorder_accuses_no_gateway() -> None:
    """Nobody was there to hear it: the log ends, as far as is known, and another one begins behind the period."""
    spans = [(WALL_NS, WALL_NS + 5 * PERIOD_NS), (WALL_NS + 60 * SECOND, WALL_NS + 90 * SECOND)]
    report = report_of(*(arbiter(number) for number in range(5)), spans=spans, to_ns=WALL_NS + 30 * SECOND)
    assert report.summary.outages == []
    (moment,) = report.moments
    assert moment.text == "the log ends here: engaged, commanded 1.00 m/s"


@pytest.mark.parametrize("is_commanding", [True, False])
def test_a_gateway_of_which_nothing_comes_any_more_fell_silent(is_commanding: bool) -> None:  # noqa: FBT001 - a case
    """The log goes on without it; that matters more if it commanded the robot."""
    engaged = ArbiterState.ENGAGED if is_commanding else ArbiterState.STANDBY
    report = report_of(
        *(arbiter(number, state=engaged) for number in range(5)), spans=[(WALL_NS, WALL_NS + 60 * SECOND)]
    )
    (outage,) = report.summary.outages
    assert (outage.heard_ns, outage.began_ns) == (WALL_NS + 4 * PERIOD_NS, None)
    assert outage.is_commanding is is_commanding
    (moment,) = report.moments
    assert moment.severity == ("error" if is_commanding else "warning")
    assert moment.text.startswith("nothing of the arbiter for 59.8 s, up to the end: the gateway fell silent")
    assert not report.summary.ends_commanding
