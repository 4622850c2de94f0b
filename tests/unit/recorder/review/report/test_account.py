"""A robot in figures: from its messages, and out of logs."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from recorder.reading.logs import Faults, LogFile, find_logs
from recorder.reading.rows import END_OF_TIME_NS, Row, Selection
from recorder.reading.topics import Topic
from recorder.review.drives import ENTRIES_MAX, MARGIN_NS, Outage
from recorder.review.entries import EntryKind
from recorder.review.events import Timeline
from recorder.review.report import account
from recorder.review.report.account import (
    DRIVERS_MAX,
    MOST,
    OTHERS,
    REFUSALS_MAX,
    Account,
    Versions,
)
from recorder.review.report.findings import InForce, RobotReport, RobotSummary
from recorder.review.report.gather import read_report
from schemas.decisions import ArbiterState, Severity
from schemas.messages import GatewayInfo, Message, Variant
from schemas.recording import RecorderEvent, RecorderEventKind
from tests.support.drives import drive_messages, drives_over, restart, write_messages
from tests.support.logs import Log
from tests.support.messages import (
    PERIOD_NS,
    SECOND,
    WALL_NS,
    arbiter,
    event,
    gateway_info,
    key_of,
    refusal,
    sample_of,
    state,
)
from tests.support.reading import report_of


def row_of(message: Message, log_ns: int) -> Row:
    key = key_of(type(message))
    topic = Topic(key, "", "", "", b"", type(message), "cruiser-1", "cruiser-1", "", lambda _: message)
    return Row(topic, message.sequence, log_ns, message.time_ns, b"")


def summed_up(
    *messages: Message, off_ns: int = 0, spans: Sequence[tuple[int, int]] = (), to_ns: int = END_OF_TIME_NS
) -> RobotReport:
    """Of messages that were received when they were sent, by a clock that is so much ahead."""
    account = Account("cruiser-1", "fleet/cruiser-1")
    timeline = Timeline(Faults())
    for message in messages:
        account.take(message, message.time_ns, message.time_ns + off_ns)
        timeline.take(row_of(message, message.time_ns + off_ns), message)
    logs = [LogFile(Path("log.mcap"), 1, *span, frozenset({("fleet", "cruiser-1")})) for span in spans]
    for ending in timeline.endings(logs, to_ns):
        account.end(ending)
    for entry in timeline.end():
        account.take_entry(entry)
    report = account.sum_up({})
    assert report is not None
    return report


def summary_of(*messages: Message) -> RobotSummary:
    return summed_up(*messages).summary


def test_what_was_asked_for_is_drawn_while_it_holds() -> None:
    was = {5: ArbiterState.STOPPING, 6: ArbiterState.STOPPING, 7: ArbiterState.ENGAGING}
    messages = [arbiter(number, state=was.get(number, ArbiterState.ENGAGED)) for number in range(12)]
    lines = summed_up(*messages).drawn[0].lines
    for line in ("target_speed_mps", "target_angle_deg"):
        drawn = [None if point is None else (point[0] - WALL_NS) // PERIOD_NS for point in lines[line]]
        assert drawn == [0, 1, 2, 3, 4, None, 8, 9, 10, 11]
    assert None not in lines["output_speed_mps"]


def test_a_clock_that_is_years_off_is_not_believed() -> None:
    summary = summed_up(*drive_messages(), off_ns=50 * 365 * 24 * 3600 * SECOND).summary
    assert (summary.end_ns - summary.start_ns) == 199 * PERIOD_NS
    assert summary.gaps == 0


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


ENDS_HERE = "gap warning the log ends here: engaged, commanded 1.00 m/s"
FELL = "no arbiter state for 59.8 s, until the end: the gateway went silent,"


@pytest.mark.parametrize(
    ("state_then", "spans_s", "to_s", "told", "is_silent"),
    [
        (ArbiterState.ENGAGED, [(0, 0.25)], None, ENDS_HERE, False),
        (ArbiterState.STOPPING, [(0, 0.25)], None, ENDS_HERE.replace("engaged", "stopping"), False),
        (ArbiterState.STANDBY, [(0, 0.25)], None, "", False),
        # The period ends, not the log; or it ends in a pause of the recorder, which accuses no gateway.
        (ArbiterState.ENGAGED, [(0, 60)], 0.25, "", False),
        (ArbiterState.ENGAGED, [(0, 0.25), (60, 90)], 30, ENDS_HERE, False),
        # The log goes on without it; that matters more if it commanded the robot.
        (ArbiterState.ENGAGED, [(0, 60)], None, f"gap error {FELL} engaged, commanded 1.00 m/s", True),
        (ArbiterState.STANDBY, [(0, 60)], None, f"gap warning {FELL} standby", True),
    ],
)
def test_a_log_that_ends_in_the_middle_of_a_drive_says_so(
    state_then: ArbiterState,
    spans_s: list[tuple[float, float]],
    to_s: float | None,
    told: str,
    is_silent: bool,  # noqa: FBT001 - a case
) -> None:
    spans = [(WALL_NS + round(begin * SECOND), WALL_NS + round(end * SECOND)) for begin, end in spans_s]
    to_ns = END_OF_TIME_NS if to_s is None else WALL_NS + round(to_s * SECOND)
    report = summed_up(*(arbiter(number, state=state_then) for number in range(5)), spans=spans, to_ns=to_ns)
    said = [f"{one.kind.value} {one.severity.value} {one.text}" for one in report.moments]
    assert said == ([told] if told else [])
    assert report.summary.ends_commanding is ("ends here" in told)
    is_commanding = state_then is ArbiterState.ENGAGED
    silent = [Outage(WALL_NS + 4 * PERIOD_NS, None, is_commanding)]
    assert report.summary.outages == silent * is_silent


def test_a_name_in_two_logs_is_two_robots(tmp_path: Path) -> None:
    """Each recorder knows but one of the name; neither's gateway, nor what is said of it, is the other's."""
    paths = []
    for root in ("fleet", "depot"):
        log = Log()
        log.receive(sample_of(gateway_info(0, f"[robot]\nroot = '{root}'\n"), root=root))
        for message in drive_messages(20):
            log.receive(sample_of(message, root=root), wall_ns=message.time_ns)
        full = (Severity.WARNING, RecorderEventKind.FULL, "cruiser-1", "", "")
        said = RecorderEvent(WALL_NS + 9, 0, *full, f"of {root}")
        log.add_own(f"{root}/@recorder/vm/event", said, 0)
        paths.append(tmp_path / f"{root}.mcap")
        paths[-1].write_bytes(log.close())
    for one, root in zip(report_of(*paths).robots, ("depot", "fleet"), strict=True):
        hash_of_its_own = gateway_info(0, f"[robot]\nroot = '{root}'\n").configuration_sha256
        assert one.summary.name == f"{root}/cruiser-1"
        assert [known.configuration_sha256 for known in one.summary.in_force] == [hash_of_its_own]
        assert [moment.text for moment in one.moments if moment.kind is EntryKind.RECORDER] == [f"of {root}"]


def died(path: Path) -> Path:
    """A log in which a gateway dies at 9.95 s, and another one with another configuration begins at 13 s."""
    log = Log()
    told = {0: gateway_info(0, "[command]\nspeed_limit_mps = 2.222\n")}
    told[260] = gateway_info(260, "[command]\nspeed_limit_mps = 0.6\n")
    for message in restart(200, 60):
        number = (message.time_ns - WALL_NS) // PERIOD_NS
        if number in told:
            log.receive(sample_of(told.pop(number)), wall_ns=message.time_ns)
        log.receive(sample_of(message), wall_ns=message.time_ns)
    path.write_bytes(log.close())
    return path


@pytest.mark.parametrize(
    ("from_number", "to_number", "is_again"),
    [(220, 280, True), (100, 250, False), (262, 280, None), (100, 190, None)],
)
def test_a_period_knows_of_a_gateway_that_died_in_it(
    tmp_path: Path,
    from_number: int,
    to_number: int,
    is_again: bool | None,  # noqa: FBT001 - a case
) -> None:
    faults = Faults()
    logs = find_logs([died(tmp_path / "a.mcap")], faults)
    period = WALL_NS + from_number * PERIOD_NS, WALL_NS + to_number * PERIOD_NS
    (robot,) = read_report(logs, Selection(from_ns=period[0], to_ns=period[1]), faults).robots
    assert [one.began_ns is not None for one in robot.summary.outages] == ([] if is_again is None else [is_again])
    assert not robot.summary.ends_commanding
    assert robot.summary.start_ns >= period[0]


def test_an_incident_beside_its_log_tells_nothing_twice(tmp_path: Path) -> None:
    data = died(tmp_path / "a.mcap").read_bytes()
    once = report_of(tmp_path / "a.mcap").robots[0]
    (tmp_path / "b.mcap").write_bytes(data)
    twice = report_of(tmp_path / "a.mcap", tmp_path / "b.mcap").robots[0]
    assert twice.moments == once.moments
    assert twice.summary.outages == once.summary.outages
    assert twice.summary.in_force == once.summary.in_force


def test_what_was_before_the_beginning_of_the_log_is_not_in_the_report(tmp_path: Path) -> None:
    """A recorder asks a gateway for what it did not hear, and gets the stops and requests of an hour ago too."""
    log = Log()
    for number in range(100):
        log.receive(sample_of(state(number)), wall_ns=WALL_NS + number * PERIOD_NS)
    before = [one(-72_000, sequence=49, tick=1) for one in (event, refusal)]
    for message in (*before, event(50), refusal(50)):
        log.receive(sample_of(message), wall_ns=WALL_NS + 100 * PERIOD_NS)
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    (robot,) = report_of(path).robots
    assert robot.summary.start_ns == WALL_NS
    assert (robot.summary.stops, robot.summary.refused) == ({"front_bumper": 1}, 1)
    assert [moment.time_ns for moment in robot.moments] == [WALL_NS + 50 * PERIOD_NS]


@pytest.mark.parametrize(
    ("from_s", "to_s", "gap_s"), [(0, 8, 3.9 + 0.05), (6, 14, 6.4), (0, 20, 8.3), (0, 4, 0.05), (None, None, 8.3)]
)
def test_a_pause_of_the_recorder_is_missing_in_any_period(
    tmp_path: Path, from_s: float | None, to_s: float | None, gap_s: float
) -> None:
    """Also in one that ends or begins within it: the distance is at least what is told."""
    paths = []
    for first, last in ((0, 82), (248, 400)):
        log = Log()
        for number in range(first, last):
            for message in (state(number), arbiter(number)):
                log.receive(sample_of(message), wall_ns=message.time_ns)
        paths.append(tmp_path / f"{first}.mcap")
        paths[-1].write_bytes(log.close())
    faults = Faults()
    period = Selection()
    if from_s is not None and to_s is not None:
        period = Selection(from_ns=WALL_NS + round(from_s * SECOND), to_ns=WALL_NS + round(to_s * SECOND))
    (robot,) = read_report(find_logs(paths, faults), period, faults).robots
    assert robot.summary.gap_s == pytest.approx(gap_s if gap_s > 0.5 else 0.0, abs=0.15)
    assert robot.summary.outages == []


def test_each_drive_of_many_days_is_for_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(account, "DRAWN_MAX", 5)
    (robot,) = report_of(write_messages(tmp_path / "a.mcap", drives_over(25, 12))).robots
    assert len(robot.drives) == 12
    assert [one.drive for one in robot.drawn] == robot.drives[-5:]
    for drawn in robot.drawn:
        drive = drawn.drive
        assert drive is not None
        assert (drive.stops, drive.missing_s, drive.worst) == (1, 0.0, "stopping: the front bumper was hit")
        assert drive.distance_m == pytest.approx(2.95)
        assert (drawn.places[0].time_ns, drawn.places[0].x_m) == (drive.start_ns, 0.0)
        assert drawn.start_ns == drive.start_ns - MARGIN_NS
        assert drawn.end_ns == min(drive.end_ns + MARGIN_NS, robot.summary.end_ns)
        assert [one.time_ns for one in drawn.moments if one.is_stop] == [drive.end_ns]
        times_ns = [point[0] for point in drawn.lines["speed_mps"] if point is not None]
        assert (times_ns[0], times_ns[-1]) == (drive.start_ns, drive.end_ns)
    assert robot.summary.distance_m == pytest.approx(12 * 2.95)
    assert robot.summary.stops == {"front_bumper": 12}


FAST = "[command]\nspeed_limit_mps = 2.222\n"
SLOW = "[command]\nspeed_limit_mps = 0.6\n"


def heard(*infos: GatewayInfo) -> Versions:
    versions = Versions()
    for one in infos:
        versions.hear(one)
    return versions


def noted(told: GatewayInfo) -> dict[str, str]:
    return {
        "variant": told.variant.value,
        "started_ns": str(told.started_ns),
        "configuration_sha256": told.configuration_sha256,
        **{f"versions.{name}": version for name, version in told.versions.items()},
    }


def since(found: list[InForce]) -> list[int]:
    return [(one.since_ns - WALL_NS) // PERIOD_NS for one in found]


def test_each_gateway_is_told_once() -> None:
    first = gateway_info(0, FAST, variant=Variant.UNKNOWN)
    versions = heard(first, gateway_info(0, FAST), gateway_info(90, SLOW), gateway_info(50, SLOW))
    found = versions.in_force()
    assert since(found) == [0, 50, 90]
    assert [one.variant for one in found] == ["coarse"] * 3
    assert since(versions.in_force(3 * SECOND))[0] == 3 * SECOND // PERIOD_NS
    versions.read(noted(gateway_info(50, SLOW)))
    assert versions.in_force() == found
    bare = Versions()
    bare.read(noted(gateway_info(50, SLOW)))
    assert (since(bare.in_force()), bare.in_force()[0].versions) == ([50], found[1].versions)


def test_metadata_of_no_sense_and_gateways_without_end_are_bounded() -> None:
    versions = heard(*(gateway_info(number) for number in range(MOST + 5)))
    for started in ("", "x", "-5", "1" * 5000, str(2**64)):
        versions.read({"started_ns": started})
    assert (len(versions.in_force()), versions.left_out) == (MOST, 5)
