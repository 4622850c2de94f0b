"""A robot's row: the first thing that a person should know of it."""

import msgspec
import pytest

from gateway.client.fleet import ALARM, FINE, LOOK, WORDS, RobotStatus
from gateway.desk.fleet_view import row_of, why_not
from schemas.decisions import ArbiterState, SafetyState, StopPhase
from schemas.messages import Mode, RobotState
from schemas.reasons import Reason
from tests.support.messages import HEALTH, STANDBY, STATE

READY = msgspec.structs.replace(
    STANDBY,
    state=ArbiterState.STANDBY,
    engaged=False,
    latched=[],
    lease_holder="",
    stop_phase=StopPhase.IDLE,
    blocked_by=[Reason.NO_LEASE, Reason.NOT_ENGAGED],
)
AUTO = msgspec.structs.replace(STATE, mode=Mode.AUTO, bus_up=True, speed_mps=0.0, silent=[])


def report(state: RobotState | None, safety: SafetyState | None) -> RobotStatus:
    return RobotStatus("cruiser-1", True, state, 0.05, HEALTH, 0.5, "", True, safety)  # noqa: FBT003 - as declared


def safety(**change: object) -> SafetyState:
    """One that only waits, but for this."""
    return msgspec.structs.replace(READY, **change)


@pytest.mark.parametrize(
    ("state", "arbiter", "word", "level"),
    [
        (AUTO, READY, "ready", FINE),
        (AUTO, safety(lease_holder="ann"), "in_control", FINE),
        (AUTO, safety(state=ArbiterState.ENGAGED, lease_holder="ann", blocked_by=[]), "in_control", FINE),
        (
            msgspec.structs.replace(AUTO, speed_mps=-0.4),
            safety(state=ArbiterState.ENGAGED, lease_holder="ann", blocked_by=[]),
            "driving",
            FINE,
        ),
        (AUTO, safety(state=ArbiterState.STOPPING, stop_phase=StopPhase.RAMP), "stopping", LOOK),
        (AUTO, safety(blocked_by=[Reason.NO_LEASE, Reason.FEEDBACK_MISSING]), "blocked", LOOK),
        (msgspec.structs.replace(AUTO, mode=Mode.REMOTE), READY, "remote_control", LOOK),
        (AUTO, safety(latched=[Reason.FRONT_BUMPER]), "needs_reset", ALARM),
        (
            msgspec.structs.replace(AUTO, mode=Mode.REMOTE),
            safety(state=ArbiterState.STOPPING, latched=[Reason.FRONT_BUMPER]),
            "needs_reset",
            ALARM,
        ),
        (msgspec.structs.replace(AUTO, bus_up=False), safety(latched=[Reason.GUARD]), "bus_down", ALARM),
        (None, READY, "offline", ALARM),
        (AUTO, None, "telemetry", FINE),
    ],
)
def test_the_worst_of_a_robot_is_its_word(
    state: RobotState | None, arbiter: SafetyState | None, word: str, level: int
) -> None:
    """Silence before a bus that is down, that before a latch, a latch before all that moves."""
    row = row_of(report(state, arbiter), None)
    assert (row.word, row.level) == (word, level)
    assert row.text


def test_a_row_has_its_reasons_for_pages_in_other_languages() -> None:
    """Those of its word alone; none where nothing is wrong."""
    latched = safety(latched=[Reason.FRONT_BUMPER], blocked_by=[Reason.FRONT_BUMPER, Reason.NO_LEASE])
    assert row_of(report(AUTO, latched), None).reasons == ["front_bumper"]
    blocked = safety(blocked_by=[Reason.NO_LEASE, Reason.FEEDBACK_MISSING])
    assert row_of(report(AUTO, blocked), None).reasons == ["feedback_missing"]
    assert row_of(report(AUTO, READY), None).reasons == []


def test_a_robot_without_health_is_looked_at() -> None:
    """However well it says that it is."""
    healthy = report(AUTO, READY)
    assert row_of(healthy, None).level == FINE
    assert row_of(msgspec.structs.replace(healthy, health=None), None).level == LOOK


def test_nothing_old_is_shown_as_current() -> None:
    """Of a robot whose state is too old there is no speed."""
    row = row_of(report(None, None), None)
    assert (row.speed_mps, row.limit_mps, row.link_age_s) == (None, None, None)
    assert row.text.startswith("no contact for 0.1 s; ")


@pytest.mark.parametrize(("travel_mps", "limit_mps"), [(None, 1.0), (0.4, 0.4), (2.7, 1.0)])
def test_the_limit_is_the_one_in_force(travel_mps: float | None, limit_mps: float) -> None:
    """That of the commands' age too, where it is the lower one."""
    row = row_of(report(AUTO, safety(speed_limit_mps=1.0, travel_speed_limit_mps=travel_mps)), None)
    assert row.limit_mps == limit_mps


def test_every_word_has_a_level() -> None:
    """There are three."""
    assert set(WORDS.values()) == {FINE, LOOK, ALARM}


def test_why_it_does_not_move_is_said_with_the_buttons_that_cure_it() -> None:
    """Each reason with its meaning, as on the command line; cures name no command that a button does."""
    reasons, _ = why_not(safety(blocked_by=[Reason.REMOTE_STOP, Reason.NOT_ENGAGED]), HEALTH, "cruiser-7")
    assert [reason for reason, _, _ in reasons] == ["remote_stop", "not_engaged"]
    assert [cure for _, _, cure in reasons] == ["press Reset, then Take control", "Take control"]
    every = [reason for reason in Reason if reason is not Reason.NONE]
    cures = [cure for _, _, cure in why_not(safety(blocked_by=every), HEALTH, "cruiser-7")[0]]
    assert [cure for cure in cures if "(driving: key" in cure or "cruiser reset" in cure] == []


def test_what_a_robot_says_cannot_command_a_terminal_or_a_page() -> None:
    """Control characters in names and texts are shown, not obeyed."""
    row = row_of(report(AUTO, safety(lease_holder="\x1b[2Jann")), None)
    assert "\x1b" not in row.driver + row.text
