"""Which logs go, and whether there is room."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.record.retention import RESUME_SHARE, ROLL_BYTES, DiskLimits, Judgement, LogEntry, judge
from schemas.settings import INCIDENT_FLOOR_SHARE, INCIDENT_SHARE

SCALE = ROLL_BYTES // 80
"""Sizes here are written in these, so that they are small."""

ENTRIES = st.lists(
    st.builds(
        LogEntry,
        name=st.text("abc", min_size=1, max_size=4),
        bytes=st.integers(0, 400).map(lambda size: size * SCALE),
        started=st.sampled_from([f"20270115T08000{second}Z" for second in range(10)]),
        number=st.integers(1, 11),
        is_incident=st.sampled_from([False, False, False, True]),
        is_open=st.sampled_from([False, False, False, True]),
        is_stuck=st.sampled_from([False, False, False, True]),
    ),
    max_size=12,
    unique_by=lambda entry: entry.name,
).map(
    lambda entries: [
        msgspec.structs.replace(entry, is_own=entry.is_open)
        for entry in entries
        if not (entry.is_open and entry.is_stuck)
    ]
)
LIMITS = st.builds(
    DiskLimits,
    budget_bytes=st.sampled_from([0, 500 * SCALE, 1000 * SCALE]),
    floor_bytes=st.sampled_from([0, 200 * SCALE]),
)
FREE = st.integers(0, 500).map(lambda size: size * SCALE)


def used(entries: list[LogEntry]) -> int:
    """What they take together."""
    return sum(entry.bytes for entry in entries)


def without(entries: list[LogEntry], judgement: Judgement) -> list[LogEntry]:
    """What is left."""
    return [entry for entry in entries if entry.name not in judgement.delete]


def is_within(entries: list[LogEntry], free_bytes: int, limits: DiskLimits) -> bool:
    """Whether the limits are kept."""
    return free_bytes >= limits.floor_bytes and (not limits.budget_bytes or used(entries) <= limits.budget_bytes)


@given(ENTRIES, FREE, LIMITS, st.booleans())
def test_only_what_may_go_goes_the_oldest_first(
    entries: list[LogEntry],
    free_bytes: int,
    limits: DiskLimits,
    is_full: bool,  # noqa: FBT001 - drawn
) -> None:
    """Incidents and what is being written never do, and nothing is deleted twice."""
    judgement = judge(entries, free_bytes, limits, is_full=is_full)
    may_go = [entry for entry in entries if not (entry.is_incident or entry.is_open or entry.is_stuck)]
    may_go.sort(key=lambda entry: (entry.started, entry.number, entry.name))
    assert list(judgement.delete) == [entry.name for entry in may_go[: len(judgement.delete)]]


@given(ENTRIES, FREE, LIMITS)
def test_where_there_is_room_the_limits_are_kept_and_no_log_goes_in_vain(
    entries: list[LogEntry], free_bytes: int, limits: DiskLimits
) -> None:
    """One file less would not have been enough; and where nothing is enough, nothing goes."""
    judgement = judge(entries, free_bytes, limits, is_full=False)
    left = without(entries, judgement)
    freed_bytes = used(entries) - used(left)
    if not judgement.has_room:
        assert judgement.delete == ()
        may_go = [entry for entry in entries if not (entry.is_incident or entry.is_open or entry.is_stuck)]
        rest = [entry for entry in entries if entry not in may_go]
        assert not is_within(rest, free_bytes + used(may_go), limits)
    elif not judgement.roll:
        assert is_within(left, free_bytes + freed_bytes, limits)
        if judgement.delete:
            last = next(entry for entry in entries if entry.name == judgement.delete[-1])
            assert not is_within([*left, last], free_bytes + freed_bytes - last.bytes, limits) or not last.bytes


@given(ENTRIES, FREE, LIMITS)
def test_logs_are_ended_only_when_that_makes_room_and_is_worth_it(
    entries: list[LogEntry], free_bytes: int, limits: DiskLimits
) -> None:
    """Then recording goes on meanwhile, and what is ended may go next."""
    judgement = judge(entries, free_bytes, limits, is_full=False)
    if judgement.roll:
        assert judgement.has_room
        open_bytes = used([entry for entry in entries if entry.is_open and not entry.is_incident])
        assert open_bytes >= ROLL_BYTES
        ended = [
            msgspec.structs.replace(entry, is_open=entry.is_open and entry.is_incident, is_own=False)
            for entry in entries
        ]
        assert judge(ended, free_bytes, limits, is_full=False).has_room


@given(ENTRIES, FREE, LIMITS)
def test_a_recording_that_goes_on_does_not_stop_at_the_next_byte(
    entries: list[LogEntry], free_bytes: int, limits: DiskLimits
) -> None:
    """It goes on only when a part of the limits is free beyond them."""
    judgement = judge(entries, free_bytes, limits, is_full=True)
    if judgement.has_room and not judgement.roll:
        left = without(entries, judgement)
        freed_bytes = used(entries) - used(left)
        spare = int(RESUME_SHARE * limits.floor_bytes)
        assert free_bytes + freed_bytes >= limits.floor_bytes + spare
        assert not limits.budget_bytes or used(left) * (1 + RESUME_SHARE) < limits.budget_bytes + 1


@given(ENTRIES, FREE, LIMITS, st.booleans())
def test_incidents_have_a_share_of_their_own(
    entries: list[LogEntry],
    free_bytes: int,
    limits: DiskLimits,
    is_full: bool,  # noqa: FBT001 - drawn
) -> None:
    """Of the budget, and of the reserve that logs leave free; whatever the logs take."""
    incident_bytes = used([entry for entry in entries if entry.is_incident])
    in_budget = not limits.budget_bytes or incident_bytes < INCIDENT_SHARE * limits.budget_bytes
    above_floor = free_bytes >= INCIDENT_FLOOR_SHARE * limits.floor_bytes
    judgement = judge(entries, free_bytes, limits, is_full=is_full)
    assert judgement.has_incident_room == (in_budget and above_floor)


def log(name: str, size: int, *, is_open: bool = False) -> LogEntry:
    """A log, whose name is its start."""
    return LogEntry(name, size, name, is_open=is_open, is_own=is_open)


def test_what_an_earlier_recorder_left_is_no_reason_to_end_files() -> None:
    """It is not this one's to end: nothing would come of it but many small files."""
    left = LogEntry("1", 5000 * SCALE, "1", is_open=True)
    judgement = judge([left, log("2", 100 * SCALE)], 0, DiskLimits(budget_bytes=1000 * SCALE), is_full=False)
    assert judgement == Judgement((), has_room=False, has_incident_room=True, roll=False)


@pytest.mark.parametrize(
    ("open_bytes", "free_bytes", "judgement"),
    [
        # What is ended is enough.
        (99, 6000, Judgement(("1",), has_room=True, has_incident_room=True, roll=False)),
        # Only with what is being written there would be enough; all that may go goes at once.
        (950, 6000, Judgement(("1", "2"), has_room=True, has_incident_room=True, roll=True)),
        # Not even then.
        (300, 3000, Judgement((), has_room=False, has_incident_room=True, roll=False)),
        # What is being written is just enough to be worth it, and too little.
        (80, 4220, Judgement(("1", "2"), has_room=True, has_incident_room=True, roll=True)),
        (79, 4220, Judgement((), has_room=False, has_incident_room=True, roll=False)),
    ],
)
def test_what_is_being_written_is_ended_when_the_rest_is_not_enough(
    open_bytes: int, free_bytes: int, judgement: Judgement
) -> None:
    """And only then, if it makes a difference."""
    sizes = {"3": open_bytes, "2": 300, "1": 402}
    entries = [log(name, size * SCALE, is_open=name == "3") for name, size in sizes.items()]
    limits = DiskLimits(800 * SCALE, 5000 * SCALE)
    assert judge(entries, free_bytes * SCALE, limits, is_full=False) == judgement


def test_what_is_ended_and_just_enough_ends_nothing_else() -> None:
    """Nor is a byte too little where all of it together is just enough."""
    entries = [log("1", 300 * SCALE), log("2", 600 * SCALE, is_open=True)]
    judgement = judge(entries, 0, DiskLimits(budget_bytes=600 * SCALE), is_full=False)
    assert (judgement.delete, judgement.roll) == (("1",), False)
    judgement = judge(entries, 0, DiskLimits(floor_bytes=900 * SCALE), is_full=False)
    assert (judgement.delete, judgement.roll, judgement.has_room) == (("1",), True, True)


@pytest.mark.parametrize(("more_bytes", "has_room"), [(-1, True), (0, False)])
def test_incidents_may_fill_their_share_and_no_more(more_bytes: int, *, has_room: bool) -> None:
    """Of the budget; the byte that fills it is the last."""
    incident = msgspec.structs.replace(log("1", int(INCIDENT_SHARE * 1000 * SCALE) + more_bytes), is_incident=True)
    assert judge([incident], 0, DiskLimits(budget_bytes=1000 * SCALE), is_full=False).has_incident_room is has_room


@pytest.mark.parametrize(
    ("limits", "free_bytes", "is_full", "has_room"),
    [
        (DiskLimits(1000, 0), 0, False, True),
        (DiskLimits(999, 0), 0, False, False),
        (DiskLimits(1019, 0), 0, True, False),
        (DiskLimits(1020, 0), 0, True, True),
        (DiskLimits(0, 1000), 1000, False, True),
        (DiskLimits(0, 1000), 999, False, False),
        (DiskLimits(0, 1000), 1019, True, False),
        (DiskLimits(0, 1000), 1020, True, True),
    ],
)
def test_to_go_on_takes_more_room_than_not_to_stop(
    limits: DiskLimits,
    free_bytes: int,
    is_full: bool,  # noqa: FBT001 - pytest gives it
    has_room: bool,  # noqa: FBT001 - pytest gives it
) -> None:
    """Else every byte that somebody frees would begin a file."""
    entries = [msgspec.structs.replace(log("1", 1000), is_incident=True)]
    assert judge(entries, free_bytes, limits, is_full=is_full).has_room == has_room


def test_without_limits_nothing_goes() -> None:
    """However full the disk is."""
    entries = [LogEntry("a", 10**12, "20270115T080000Z")]
    assert judge(entries, 0, DiskLimits(), is_full=True) == Judgement(
        (), has_room=True, has_incident_room=True, roll=False
    )


def logs_of(robot: str, *sizes: int, hour: int = 0, is_written: bool = False) -> list[LogEntry]:
    """Logs of a robot, one an hour, the last of which may be being written."""
    starts = [f"20270115T{hour + number:02}0000Z" for number in range(len(sizes))]
    entries = [
        LogEntry(f"{robot}-{start}", size * SCALE, start, robot=robot)
        for start, size in zip(starts, sizes, strict=True)
    ]
    if is_written:
        entries[-1] = msgspec.structs.replace(entries[-1], is_open=True, is_own=True)
    return entries


def bytes_of(robot: str, entries: list[LogEntry]) -> int:
    """What a robot's logs take, in SCALE."""
    return used([entry for entry in entries if entry.robot == robot]) // SCALE


def test_made_up_robots_cost_the_true_one_no_more_than_its_fair_share() -> None:
    """Its oldest logs go until each robot takes as much; from then on theirs go, too, however new they are."""
    entries = [*logs_of("cruiser-1", *[100] * 10)]
    for number in range(9):
        entries += logs_of(f"spoof-{number}", *[100] * 10, hour=10)
    judgement = judge(entries, 0, DiskLimits(budget_bytes=1000 * SCALE), is_full=False)
    left = without(entries, judgement)
    robots = {entry.robot for entry in entries}
    assert {robot: bytes_of(robot, left) for robot in robots} == dict.fromkeys(robots, 100)
    assert [entry.started for entry in left if entry.robot == "cruiser-1"] == ["20270115T090000Z"]


def test_the_logs_of_the_robot_that_takes_most_go_although_others_are_older() -> None:
    """Its oldest first. A robot that was quiet for long keeps what it has."""
    entries = [*logs_of("quiet", 50, 50), *logs_of("loud", 300, 300, 300, hour=10)]
    judgement = judge(entries, 0, DiskLimits(budget_bytes=500 * SCALE), is_full=False)
    assert judgement.delete == ("loud-20270115T100000Z", "loud-20270115T110000Z")


def test_what_a_robot_writes_now_counts_in_its_share() -> None:
    """Its older log goes, before the still older one of a robot that takes less."""
    entries = [*logs_of("quiet", 300), *logs_of("loud", 100, 500, hour=10, is_written=True)]
    judgement = judge(entries, 0, DiskLimits(budget_bytes=850 * SCALE), is_full=False)
    assert judgement.delete == ("loud-20270115T100000Z",)


def test_made_up_robots_have_one_share_together_where_robots_are_known() -> None:
    """A thousand names are worth no more than one."""
    entries = logs_of("cruiser-1", *[100] * 10)
    for number in range(1000):
        entries += logs_of(f"spoof-{number}", 10, hour=10)
    limits = DiskLimits(budget_bytes=2000 * SCALE, known=frozenset({"cruiser-1"}), keep_s=0)
    left = without(entries, judge(entries, 0, limits, is_full=False))
    assert bytes_of("cruiser-1", left) == 1000
    assert used(left) <= 2000 * SCALE


@pytest.mark.parametrize("keep_s", [0, 1, 3600, 7200, 7201])
def test_the_last_hours_of_a_known_robot_stay(keep_s: int) -> None:
    """Back from where its newest log begins; a log reaches up to the next. What else is there goes before."""
    entries = [*logs_of("cruiser-1", 10, 10, 10, 10, 10), *logs_of("spoof", 1, 1, hour=10)]
    limits = DiskLimits(budget_bytes=SCALE, known=frozenset({"cruiser-1"}), keep_s=keep_s)
    kept = {0: 1, 1: 2, 3600: 2, 7200: 3, 7201: 4}[keep_s]
    limits = msgspec.structs.replace(limits, budget_bytes=kept * 10 * SCALE)
    judgement = judge(entries, 0, limits, is_full=False)
    hours = [name.partition("T")[2][:2] for name in judgement.delete]
    assert hours == [*(f"{hour:02}" for hour in range(5 - kept)), "10", "11"]
    assert judgement.has_room


@pytest.mark.parametrize("starts", [("a", "b"), ("00010101T000000Z", "00010101T003000Z")])
def test_of_a_known_robot_whose_starts_are_no_times_the_newest_log_stays(starts: tuple[str, str]) -> None:
    """Anybody can name a file: one that cannot be reckoned with, or an hour before the first year."""
    own = [LogEntry(f"cruiser-1-{start}", 100 * SCALE, start, robot="cruiser-1") for start in starts]
    limits = DiskLimits(budget_bytes=150 * SCALE, known=frozenset({"cruiser-1"}), keep_s=3600)
    judgement = judge([*own, *logs_of("spoof", 50)], 0, limits, is_full=False)
    assert judgement.delete == (own[0].name,)


def test_what_strangers_write_is_ended_before_the_last_hours_of_a_known_robot_go() -> None:
    """It may go as soon as it is a whole log."""
    entries = [*logs_of("cruiser-1", 300, 100, is_written=True), *logs_of("spoof", 600, hour=10, is_written=True)]
    limits = DiskLimits(budget_bytes=900 * SCALE, known=frozenset({"cruiser-1"}), keep_s=7200)
    assert judge(entries, 0, limits, is_full=False) == Judgement(
        (), has_room=True, has_incident_room=True, roll=True
    )


def test_when_nothing_else_is_left_a_known_robot_records_on() -> None:
    """Its own oldest log goes, even of its last hours: a robot that stops recording loses more."""
    entries = logs_of("cruiser-1", 300, 300, 300, is_written=True)
    limits = DiskLimits(budget_bytes=800 * SCALE, known=frozenset({"cruiser-1"}), keep_s=7200)
    assert judge(entries, 0, limits, is_full=False) == Judgement(
        ("cruiser-1-20270115T000000Z",), has_room=True, has_incident_room=True, roll=False
    )


def test_when_even_that_is_not_enough_what_a_known_robot_writes_is_ended() -> None:
    """So that it may go in its turn: recording goes on."""
    entries = logs_of("cruiser-1", 300, 600, is_written=True)
    limits = DiskLimits(budget_bytes=200 * SCALE, known=frozenset({"cruiser-1"}), keep_s=7200)
    assert judge(entries, 0, limits, is_full=False) == Judgement(
        ("cruiser-1-20270115T000000Z",), has_room=True, has_incident_room=True, roll=True
    )


def test_an_incident_of_a_stranger_that_is_being_written_is_no_log_yet() -> None:
    """It counts as an incident until it is whole: no log is ended for it."""
    [incident] = [
        msgspec.structs.replace(entry, is_incident=True) for entry in logs_of("spoof", 600, is_written=True)
    ]
    limits = DiskLimits(budget_bytes=1000 * SCALE, known=frozenset({"cruiser-1"}))
    entries = [incident, *logs_of("cruiser-1", 500)]
    assert judge(entries, 0, limits, is_full=False) == Judgement(
        ("cruiser-1-20270115T000000Z",), has_room=True, has_incident_room=False, roll=False
    )


def test_incidents_of_strangers_go_like_logs_where_robots_are_known() -> None:
    """Else made-up alarms would fill what a known robot's incidents may take, and nothing would ever free it."""
    incidents = [msgspec.structs.replace(entry, is_incident=True) for entry in logs_of("spoof", 300, 300)]
    limits = DiskLimits(budget_bytes=1000 * SCALE)
    assert judge(incidents, 0, limits, is_full=False).has_incident_room is False
    known = msgspec.structs.replace(limits, known=frozenset({"cruiser-1"}))
    assert judge(incidents, 0, known, is_full=False).has_incident_room
    entries = [*incidents, *logs_of("cruiser-1", 500)]
    assert judge(entries, 0, known, is_full=False).delete == (incidents[0].name,)


@given(
    st.lists(st.tuples(st.integers(0, 50), st.booleans(), st.integers(0, 40)), min_size=30, max_size=120),
    st.sampled_from([0, 1000]),
    st.sampled_from([0, 300]),
)
def test_a_recorder_goes_on_for_ever_within_its_limits(
    seconds: list[tuple[int, bool, int]], budget_bytes: int, floor_bytes: int
) -> None:
    """Whatever it writes each second, whether its files are short or long, on a disk that others fill a bit."""
    limits = DiskLimits(budget_bytes * SCALE, floor_bytes * SCALE)
    entries: list[LogEntry] = []
    others_bytes = 0
    for second, (grows_bytes, ends, others_grow_bytes) in enumerate(seconds):
        others_bytes = min(600 * SCALE, others_bytes + others_grow_bytes * SCALE)
        started = f"{second:03}"
        before = next((entry for entry in entries if entry.is_open), LogEntry(started, 0, started))
        entries = [entry for entry in entries if not entry.is_open]
        size = before.bytes + grows_bytes * SCALE
        entries.append(LogEntry(before.name, size, before.started, is_open=not ends, is_own=not ends))
        free_bytes = 3000 * SCALE - others_bytes - used(entries)
        judgement = judge(entries, free_bytes, limits, is_full=False)
        assert judgement.has_room
        free_bytes += used(entries) - used(without(entries, judgement))
        entries = without(entries, judgement)
        if judgement.roll:
            entries = [LogEntry(entry.name, entry.bytes, entry.started) for entry in entries]
        else:
            assert is_within(entries, free_bytes, limits)


def test_what_is_safe_elsewhere_goes_first() -> None:
    """However young it is; then the oldest of the rest."""
    entries = [
        LogEntry("old", 100, "20270115T080000Z"),
        LogEntry("young and safe", 100, "20270115T080002Z", is_safe=True),
        LogEntry("younger", 100, "20270115T080003Z"),
    ]
    assert judge(entries, 0, DiskLimits(budget_bytes=200), is_full=False).delete == ("young and safe",)
    assert judge(entries, 0, DiskLimits(budget_bytes=100), is_full=False).delete == ("young and safe", "old")


def test_the_last_hours_of_a_known_robot_stay_also_where_they_are_safe() -> None:
    """They are kept to be asked on the robot. When nothing else is left they go, those first that are safe."""
    limits = DiskLimits(budget_bytes=200, known=frozenset({"a"}), keep_s=7200.0)
    entries = [
        LogEntry("stranger", 100, "20270115T080000Z", robot="b"),
        LogEntry("older", 100, "20270115T080001Z", robot="a"),
        LogEntry("newest, safe", 100, "20270115T080002Z", robot="a", is_safe=True),
    ]
    assert judge(entries, 0, limits, is_full=False).delete == ("stranger",)
    assert judge(entries[1:], 0, msgspec.structs.replace(limits, budget_bytes=100), is_full=False).delete == (
        "newest, safe",
    )


@pytest.mark.parametrize(("age_s", "goes"), [(3599.0, False), (3600.0, True)])
def test_an_incident_that_is_safe_elsewhere_stays_for_a_while(age_s: float, *, goes: bool) -> None:
    """So that somebody can see it there; until then it takes the room of incidents."""
    entry = LogEntry("safe", 100, "20270115T080000Z", is_incident=True, is_safe=True, age_s=age_s)
    judgement = judge([entry], 0, DiskLimits(budget_bytes=50, keep_incidents_s=3600.0), is_full=False)
    assert (judgement.delete == ("safe",), judgement.has_incident_room) == (goes, goes)


def test_an_incident_goes_when_it_is_safe_elsewhere_and_leaves_its_room_to_others() -> None:
    """One that is not safe never does, and one that is being written is not safe whatever a note says."""
    safe = LogEntry("safe", 100, "20270115T080000Z", is_incident=True, is_safe=True)
    unsafe = LogEntry("unsafe", 100, "20270115T080000Z", is_incident=True)
    written = LogEntry("written", 100, "20270115T080000Z", is_incident=True, is_safe=True, is_open=True)
    assert judge([safe, unsafe, written], 0, DiskLimits(budget_bytes=200), is_full=False).delete == ("safe",)
    assert judge([safe, safe], 0, DiskLimits(budget_bytes=300), is_full=False).has_incident_room
    assert not judge([unsafe, unsafe], 0, DiskLimits(budget_bytes=300), is_full=False).has_incident_room
