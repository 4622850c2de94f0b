"""A fleet: its samples and their limits, each robot's word, and the views."""

import io

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console, Group, RenderableType

from gateway.client import fleet
from gateway.client.fleet import (
    HEALTH_STALE_NS,
    NEWER_WORDS_MAX,
    STATE_STALE_NS,
    Bounds,
    Fleet,
    RobotStatus,
    SampleRead,
    Source,
    alarm,
    list_view,
    read_reply,
    read_sample,
    summary,
)
from gateway.client.refusal import refused
from gateway.telemetry.samples import Received, TokenChange
from schemas import codec, keys
from schemas.codec import PayloadFault
from schemas.decisions import ArbiterState, Reply, SafetyState
from schemas.messages import GatewayHealth, Message, Mode, RobotState, Variant
from schemas.reasons import Reason
from schemas.subjects import BY_NAME, BY_TYPE, BY_VERB, COMMANDS, RECORDER_SUBJECTS, SUBJECTS, Command, Subject
from tests.support.messages import HEALTH, ROOT, STANDBY, STATE, recorder_health
from tests.support.metrics import received, token
from tests.support.newer import NEW_WORD, grown_messages, newer, with_new_word
from tests.support.strategies import TEXTS, message_of

START_NS = 10**12


def fleet_that_heard(*heard: Received | TokenChange) -> Fleet:
    fleet = Fleet(ROOT)
    for one in heard:
        fleet.receive(one, START_NS)
    return fleet


@given(age_ns=st.integers(0, 10**11))
def test_an_old_value_is_never_reported(age_ns: int) -> None:
    report = fleet_that_heard(token(), received(STATE), received(HEALTH)).report("cruiser-1", START_NS + age_ns)
    assert (report.state is not None) == (age_ns < STATE_STALE_NS)
    assert (report.health is not None) == (age_ns < HEALTH_STALE_NS)
    assert report.state_age_s == age_ns / 1e9


@pytest.mark.parametrize(
    ("tokens", "linked", "connected"),
    [([], True, False), ([True], True, True), ([True, False], True, False), ([True], False, False)],
    ids=["never heard of", "there", "gone", "this end has lost Zenoh"],
)
def test_a_robot_is_connected_by_its_token(tokens: list[bool], *, linked: bool, connected: bool) -> None:
    fleet = fleet_that_heard(*(token(present=present) for present in tokens))
    fleet.linked = linked
    report = fleet.report("cruiser-1", START_NS)
    assert (report.connected, report.state, report.state_age_s, report.health) == (connected, None, None, None)


SMALL = Bounds(robots=2, recorders=1, name_length=4, sample_bytes=1000, forgotten_ns=60)
RECORDER, OTHER = received(recorder_health(), "r1"), received(recorder_health(), "r2")
LARGE = msgspec.structs.replace(received(STATE, "big"), payload=bytes(1001))


NO_SUBJECT = Received(f"{ROOT}/a/x", "text/plain", b"")
BOUNDED: dict[str, tuple[list[Received | TokenChange], int, str, str, int]] = {
    "as many as there may be": ([received(STATE, "a"), token("b")], 0, "ab", "a b", 0),
    "one too many displaces none": ([received(STATE, "a"), token("b"), token("c")], 0, "", "a b", 1),
    "and none that goes on": (
        [received(STATE, "a"), token("b"), token("c"), received(STATE, "a")],
        0,
        "",
        "a b",
        1,
    ),
    "recorders take no robot's place": ([RECORDER, OTHER, token("a"), token("b")], 0, "", "a b r1", 1),
    "a long name is one too many": ([received(STATE, "aaaa"), received(STATE, "aaaaa")], 0, "", "aaaa", 1),
    "a large sample, or of no subject, is ignored": ([LARGE, NO_SUBJECT, token("b")], 0, "", "b", 0),
    "silent, not yet forgotten": ([received(STATE, "a"), RECORDER], 59, "a r1", "a r1", 0),
    "silent for long, and seen": ([received(STATE, "a"), RECORDER], 60, "a r1", "", 0),
    "silent for long, unseen": ([received(STATE, "a"), RECORDER], 10**9, "", "a r1", 0),
    "a token holds": ([token("a"), token("b"), token("b", present=False)], 60, "ab", "a", 0),
    "too many: none goes early": ([token("a"), received(STATE, "b"), token("c")], 59, "", "a b", 1),
    "too many: a lost one goes": ([token("a"), received(STATE, "b"), token("c")], 60, "", "a", 1),
}


@pytest.mark.parametrize(("heard", "later_ns", "sees", "left", "refused"), BOUNDED.values(), ids=BOUNDED)
def test_a_fleet_is_bounded(
    heard: list[Received | TokenChange], later_ns: int, sees: str, left: str, refused: int
) -> None:
    fleet = Fleet(ROOT, SMALL)
    for one in heard:
        fleet.receive(one, START_NS)
    kinds = (fleet.robots, fleet.recorders)
    found = [name for kind in kinds for name in kind.names(START_NS + later_ns, lambda name: name in sees)]
    assert (found, sum(kind.refused for kind in kinds)) == (left.split(), refused)


def test_robots_are_kept_apart() -> None:
    other = msgspec.structs.replace(STATE, speed_mps=2.0)
    fleet = fleet_that_heard(received(STATE), received(other, "cruiser-2"), token("cruiser-3"))
    elsewhere = Received(f"else/{ROOT}/cruiser-4/state", BY_NAME["state"].encoding, codec.encode(STATE))
    fleet.receive(elsewhere, START_NS)
    fleet.receive(TokenChange("else/cruiser-5/gateway", present=True), START_NS)
    assert fleet.robots.names(START_NS) == ["cruiser-1", "cruiser-2", "cruiser-3"]
    assert fleet.report("cruiser-2", START_NS).state == other


def test_what_cannot_be_read_is_said_until_something_can() -> None:
    encoding = BY_NAME["state"].encoding
    fleet = fleet_that_heard(Received(f"{ROOT}/cruiser-1/state", encoding, b"\xc1"))
    assert "state" in fleet.report("cruiser-1", START_NS).unreadable
    fleet.receive(received(STATE, encoding=f"{encoding}99"), START_NS)
    report = fleet.report("cruiser-1", START_NS)
    assert report.state is None
    assert report.unreadable.startswith("state is version 199 of cruiser.RobotState")
    assert report.unreadable.endswith("upgrade this program")
    fleet.receive(received(STATE), START_NS)
    assert fleet.report("cruiser-1", START_NS).unreadable == ""


@given(
    key=st.text() | st.sampled_from([f"{ROOT}/a/{subject.name}" for subject in SUBJECTS]),
    encoding=st.text() | st.sampled_from([subject.encoding for subject in SUBJECTS]),
    payload=st.binary(),
)
def test_no_sample_makes_hearing_raise(key: str, encoding: str, payload: bytes) -> None:
    fleet = fleet_that_heard(Received(key, encoding, payload), TokenChange(key, present=True))
    for robot in fleet.robots.names(START_NS):
        assert fleet.report(robot, START_NS).robot == robot


def test_a_robot_of_a_newer_version_is_shown_as_far_as_it_is_known() -> None:
    state = BY_TYPE[type(STANDBY)]
    key = keys.build(ROOT, "cruiser-1", state)
    latched = Received(key, state.encoding, with_new_word(STANDBY, ("latched",)))
    fleet = fleet_that_heard(token(), received(STATE), latched, latched)
    report = fleet.report("cruiser-1", START_NS)
    assert report.safety is not None
    assert report.safety.latched[-1].value == NEW_WORD
    assert report.newer.count(f"safety/state: latched {NEW_WORD}") == 1
    for shown in (list_view([report])[0].plain, msgspec.json.encode(report).decode()):
        assert f"latched {NEW_WORD}" in shown
        assert "upgrade this program" in shown
    assert fleet.report("cruiser-2", START_NS).newer == ""


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_a_reply_of_a_newer_robot_is_read_as_far_as_it_is_known(command: Command) -> None:
    reply = command.reply(ok=False, reason=Reason.BUSY, detail="d", cure="c")
    read = read_reply(command, Received("key", command.reply_encoding, with_new_word(reply, ("reason",))))
    assert isinstance(read, Reply)
    assert (read.ok, read.reason.value, read.detail) == (False, NEW_WORD, "d")
    assert NEW_WORD in str(refused("cruiser-1", command.verb, read, "ann"))
    other = read_reply(command, Received("key", newer(command.reply_encoding), b""))
    assert isinstance(other, PayloadFault)
    assert other.detail.endswith("and this program knows 1: upgrade this program")


@given(grown=grown_messages())
def test_what_a_newer_sender_says_is_read(grown: tuple[Subject, Message, tuple[str, ...]]) -> None:
    subject, message, path = grown
    key = f"fleet/{'@recorder/' if subject in RECORDER_SUBJECTS else ''}a/{subject.name.format(bus='can0')}"
    source = Source()
    for word in (NEW_WORD, NEW_WORD, "another"):
        sample = read_sample(Received(key, subject.encoding, with_new_word(message, path, word)))
        assert sample is not None
        assert isinstance(sample.message, subject.type)
        source.receive(sample, START_NS)
    assert source.newer.count(NEW_WORD) == source.newer.count("another") == 1
    assert "upgrade this program" in source.newer
    older = read_sample(Received(key, newer(subject.encoding, -1), b""))
    assert older is not None
    assert isinstance(older.message, PayloadFault)
    assert older.message.detail.endswith(
        "upgrade the recorder" if subject in RECORDER_SUBJECTS else "upgrade the robot's gateway"
    )


def test_new_words_are_stored_up_to_a_bound() -> None:
    sample = read_sample(received(STATE))
    assert sample is not None
    source = Source()
    for number in range(1000):
        source.receive(SampleRead(sample.parts, STATE, (f"reason {number}",)), START_NS)
    assert source.newer.count("reason") == NEWER_WORDS_MAX


def test_a_reply_of_another_schema_is_a_fault() -> None:
    payload = msgspec.msgpack.encode(Reply(ok=True, reason=Reason.NONE, detail="", cure=""))
    received = Received("key", BY_VERB["stop"].reply_encoding, payload)
    assert isinstance(read_reply(BY_VERB["acquire"], received), PayloadFault)


AUTO = msgspec.structs.replace(STATE, mode=Mode.AUTO, bus_up=True, speed_mps=0.5, silent=[])
DRIVING = RobotStatus(
    robot="cruiser-1",
    connected=True,
    state=AUTO,
    state_age_s=0.05,
    health=HEALTH,
    health_age_s=0.5,
    unreadable="",
    linked=True,
    safety=msgspec.structs.replace(STANDBY, state=ArbiterState.ENGAGED, engaged=True, latched=[]),
)
LATCHED = msgspec.structs.replace(
    DRIVING, safety=msgspec.structs.replace(STANDBY, latched=[Reason.REMOTE_STOP], engaged=False)
)
BUS_DOWN = msgspec.structs.replace(DRIVING, state=msgspec.structs.replace(AUTO, bus_up=False))
SILENT = msgspec.structs.replace(DRIVING, state=None, state_age_s=9.0)
NEW = msgspec.structs.replace(DRIVING, state=None, state_age_s=None)
MUTE = msgspec.structs.replace(NEW, health=None)


def test_a_thousand_robots_are_read_in_one_line() -> None:
    robots = [DRIVING] * 1000 + [NEW, MUTE, SILENT, BUS_DOWN, LATCHED]
    assert summary(robots) == "1000 driving, 1 bus down, 1 needs reset, 3 offline"


ENGAGED = msgspec.structs.replace(STANDBY, tick=102, state=ArbiterState.ENGAGED, engaged=True)
FRESH = RobotStatus(
    robot="cruiser-1",
    connected=True,
    state=STATE,
    state_age_s=0.04,
    health=HEALTH,
    health_age_s=0.5,
    unreadable="",
    linked=True,
)
STALE = msgspec.structs.replace(FRESH, state=None, state_age_s=3.21)

REPORTS = st.builds(
    RobotStatus,
    robot=st.just("cruiser-1"),
    connected=st.booleans(),
    state=st.none() | message_of(RobotState),
    state_age_s=st.none() | st.floats(0, 1e6),
    health=st.none() | message_of(GatewayHealth),
    health_age_s=st.none() | st.floats(0, 1e6),
    unreadable=TEXTS,
    linked=st.booleans(),
    safety=st.none() | message_of(SafetyState),
)


def drawn(renderable: RenderableType, width: int = 200) -> str:
    console = Console(file=io.StringIO(), width=width, color_system=None, force_terminal=False)
    with console.capture() as capture:
        console.print(renderable)
    return capture.get()


def closely(report: RobotStatus) -> str:
    return "\n".join(line.plain for line in fleet.detail_view(report))


def listed(report: RobotStatus) -> str:
    return "\n".join(line.plain for line in fleet.list_view([report]))


def of(safety: SafetyState = ENGAGED, **changes: object) -> RobotStatus:
    return msgspec.structs.replace(FRESH, safety=msgspec.structs.replace(safety, **changes))


def reading(**changes: object) -> RobotStatus:
    return msgspec.structs.replace(FRESH, state=msgspec.structs.replace(STATE, **changes))


IDLE = msgspec.structs.replace(
    ENGAGED, state=ArbiterState.STANDBY, lease_holder="", blocked_by=[Reason.NO_LEASE, Reason.NOT_ENGAGED]
)
BUS_LOST = of(
    IDLE,
    latched=[Reason.REMOTE_STOP],
    blocked_by=[Reason.NO_LEASE, Reason.REMOTE_STOP, Reason.BUS_DOWN, Reason.NOT_ENGAGED],
    stop_reason=Reason.REMOTE_STOP,
    stop_detail="by bob",
)
FAR = msgspec.structs.replace(
    ENGAGED, link_age_s=0.43, link_age_p50_s=0.42, link_age_p99_s=0.81, deadman_s=1.0, travel_delay_m=0.71,
    travel_speed_limit_mps=0.7,
)  # fmt: skip
CLOSE, ALL = ("close",), ("close", "list")
Row = tuple[RobotStatus, tuple[str, ...], tuple[str, ...], tuple[str, ...]]
SHOWN: dict[str, Row] = {
    "what a robot does": (
        FRESH,
        CLOSE,
        ("auto", "drive", "+1.25 m/s", "-3.5 deg", "released", "clear", "headlamp", "coarse", "up", "0.04 s"),
        ("OFFLINE",),
    ),
    "row 'travel delay': age, metres and limit of commands that it obeys": (
        of(FAR),
        CLOSE,
        (
            "command latency 430 ms (p99 810 ms), timeout 1000 ms, reaction distance 0.71 m",
            "reaction distance 0.71 m, speed limit 0.70 m/s",
        ),
        (),
    ),
    "no age of commands where nothing is known of them": (FRESH, ALL, (), ("reaction distance",)),
    "nor where there are none": (of(), ALL, (), ("reaction distance",)),
    "nor of a robot that is silent": (
        msgspec.structs.replace(STALE, safety=FAR),
        ALL,
        ("OFFLINE", "3.2"),
        ("reaction distance", "auto", "1.25", "-3.5"),
    ),
    "what is latched": (
        of(state=ArbiterState.STANDBY, latched=[Reason.REMOTE_STOP, Reason.ROLLING]),
        CLOSE,
        ("latched remote_stop, rolling",),
        ("limit",),
    ),
    "the limit in force": (of(speed_limit_mps=0.5), CLOSE, ("limit 0.50 m/s",), ("latched",)),
    "who drives": (of(lease_holder="ann"), CLOSE, ("driver ann",), ("blocked",)),
    "why it does not move": (of(IDLE), CLOSE, ("driver none", "blocked by no_lease, not_engaged"), ("last stop",)),
    "a remote stop is no idling": (
        BUS_LOST,
        CLOSE,
        ("blocked by no_lease, bus_down, not_engaged", "last stop a remote stop was received (by bob)"),
        (),
    ),
    "a timeout is none": (
        of(IDLE, stop_reason=Reason.DEADMAN),
        CLOSE,
        ("last stop no valid drive command arrived in time",),
        (),
    ),
    "what is wrong with the gateway": (
        msgspec.structs.replace(
            FRESH,
            health=msgspec.structs.replace(
                HEALTH,
                bus_up=False,
                bus_detail="no such device",
                faults={"checksum": 3, "length": 0},
                realtime=False,
            ),
        ),
        ALL,
        ("checksum 3", "no such device", "real-time"),
        ("length",),
    ),
    "health without a token": (
        msgspec.structs.replace(FRESH, connected=False),
        ("list",),
        ("no liveliness token",),
        (),
    ),
    "a gateway without health": (msgspec.structs.replace(FRESH, health=None), ALL, ("no health",), ()),
    "a bumper hit": (reading(front_bumper=True), ALL, ("bumpers front HIT",), ()),
    "both": (reading(front_bumper=True, rear_bumper=True), ALL, ("bumpers front and rear HIT",), ()),
    "a bus that is down": (reading(bus_up=False), ALL, ("bus DOWN",), ()),
    "silent frames": (reading(silent=["Auto_DriveFeedBack"]), ALL, ("silent Auto_DriveFeedBack",), ()),
    "an unknown variant": (reading(variant=Variant.UNKNOWN), ALL, ("variant unknown",), ()),
    "no zero for what is not known": (
        reading(speed_mps=None, angle_deg=None, mode=Mode.UNDEFINED),
        CLOSE,
        ("--", "undefined"),
        ("m/s", "deg"),
    ),
    "no zero below zero": (
        reading(angle_deg=-0.0006, speed_mps=-0.001),
        CLOSE,
        ("+0.00 m/s", "+0.0 deg"),
        (),
    ),
    "among many, what is wrong alone": (
        BUS_LOST,
        ("list",),
        ("bus_down", "attention: remote stop, reset"),
        ("latched",),
    ),
    "and nothing of what is not": (of(IDLE), ("list",), (), ("blocked",)),
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_view_shows(name: str) -> None:
    report, views, words, others = SHOWN[name]
    drawn_as = {"close": closely(report), "list": listed(report)}
    for view_name in views:
        text = drawn_as[view_name]
        assert [word for word in words if word not in text] == [], text
        assert [word for word in others if word in text] == [], text


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"linked": False, "connected": False}, "this end is not connected"),
        ({"connected": False}, "its gateway is not connected"),
        ({"health": None}, "sends no health"),
        ({}, "sends health"),
        ({"unreadable": "state is of version 2"}, "state is of version 2"),
        ({"state_age_s": None}, "no state yet"),
    ],
)
def test_an_alarm_says_what_is_known_of_the_cause(change: dict[str, object], reason: str) -> None:
    assert reason in alarm(msgspec.structs.replace(STALE, **change))


@given(report=REPORTS)
def test_any_report_can_be_shown(report: RobotStatus) -> None:
    for text in (listed(report), drawn(Group(*fleet.detail_view(report)), 80)):
        assert text.replace("\n", "").isprintable()
