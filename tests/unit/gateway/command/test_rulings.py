"""The tables of states and of causes, and events that stop nothing."""

import pytest

from gateway.chassis.port import ChassisState
from gateway.command.rulings import STOPS, TRANSITIONS, Notices, Trigger
from schemas.decisions import ArbiterState, EventKind, Severity
from schemas.messages import ControllerState
from schemas.reasons import TEXTS, Reason
from schemas.settings import COMMANDER_QUIET_NS, LATE_TOLD_NS
from tests.support.rigs.arbiter import MS


def test_only_engage_leads_to_motion_and_stop_is_possible_everywhere() -> None:
    """From standby only ENGAGE leads to engaging, and only CONFIRMED to engaged."""
    to = {after: set[tuple[ArbiterState, Trigger]]() for after in ArbiterState}
    for how, after in TRANSITIONS.items():
        to[after].add(how)
    assert to[ArbiterState.ENGAGING] == {(ArbiterState.STANDBY, Trigger.ENGAGE)}
    assert to[ArbiterState.ENGAGED] == {(ArbiterState.ENGAGING, Trigger.CONFIRMED)}
    assert to[ArbiterState.STOPPING] == {(state, Trigger.STOP) for state in ArbiterState}


RULES = {
    # Each row that says 'latched'; a fault of our own, and a frame that is frozen, too. All at once.
    "latched": "remote_stop front_bumper rear_bumper rolling implausible_speed overspeed steering not_moving "
    "brake_slips feedback_frozen gate guard",
    # Rows 'deadman: controlled stop' and 'disengage: controlled stop, no latch'; all of the operator's side.
    "slow": "idle unguarded deadman disengaged lease_expired lease_released lease_taken grant_expired "
    "grant_revoked not_confirmed found_moving shutdown",
    # A ramp in the wrong scale would ask for 40 times the speed.
    "no ramp": "implausible_speed variant_unknown",
    # Row 'rolling: parking brake at once'; and without a ramp after a refusal or in mode stop.
    "parks": "rolling gate mode_not_auto",
}


@pytest.mark.parametrize("rule", RULES)
def test_a_cause_stops_as_the_table_says(rule: str) -> None:
    """Latches, controlled stops, stops without a ramp, and stops that park at once."""
    found = {
        "latched": [one for one, how in STOPS.items() if how.latched and how.at_once],
        "slow": [one for one, how in STOPS.items() if not how.at_once],
        "no ramp": [one for one, how in STOPS.items() if not how.ramps],
        "parks": [one for one, how in STOPS.items() if how.parks],
    }[rule]
    assert {one.value for one in found} == set(RULES[rule].split())
    assert all(how.at_once for how in STOPS.values() if how.latched)


CAUSE, CAN = "the loop gave no sign of life", "the CAN controller: "
ENDED = f"the guard's stop has ended: {CAUSE}; it stands"
BUS, OFF, LATE = Reason.BUS_ERRORS, Reason.BUS_OFF, Reason.LOOP_LATE
INFO, WARNING, ERROR = Severity.INFO, Severity.WARNING, Severity.ERROR
Look = tuple[int, dict[str, object], tuple[Severity, Reason, str] | None]
NOTICES: dict[str, list[Look]] = {
    # Bus off is an error; the recovery is an event too.
    "each change of the controller": [
        (0, {"controller": ControllerState(state)}, told)
        for state, told in [
            ("unknown", None),
            ("warning", (WARNING, BUS, f"{CAN}unknown before, warning now")),
            ("warning", None),
            ("passive", (WARNING, BUS, f"{CAN}warning before, passive now")),
            ("bus_off", (ERROR, OFF, f"{CAN}passive before, bus_off now")),
            ("bus_off", None),
            ("active", (INFO, BUS, f"{CAN}bus_off before, active now")),
        ]
    ],
    # Also to a robot that stands by; once until they have ceased for a second.
    "another computer's commands": [
        (at_ms, {"commander_ns": heard_ns}, OTHER if is_told else None)
        for OTHER in [(WARNING, Reason.OTHER_COMMANDER, TEXTS[Reason.OTHER_COMMANDER].means)]
        for at_ms, heard_ns, is_told in [
            (0, None, False),
            (10, 5, True),
            (20, 15, False),
            (30, None, False),
            (40, 35, False),
            (50, 35 + COMMANDER_QUIET_NS, False),
            (60, 36 + 2 * COMMANDER_QUIET_NS, True),
        ]
    ],
    # Row 'the guard has stopped the robot': once, when it has ended; another guard has nothing to report yet.
    "the end of the guard's stop": [
        (0, {"guard_sends": True, "guard_stops": 1, "guard_says": CAUSE}, None),
        (1, {"guard_stops": 1, "guard_says": f"{CAUSE}; it stands"}, (WARNING, Reason.GUARD, ENDED)),
        (2, {"guard_stops": 1, "guard_says": f"{CAUSE}; it stands"}, None),
        (3, {}, None),
    ],
    # From the start on it is in health, and is no event.
    "lost real-time priority": [
        (0, {}, None),
        (1, {"realtime": True}, None),
        (2, {}, (WARNING, Reason.NO_REALTIME, TEXTS[Reason.NO_REALTIME].means)),
    ],
}


@pytest.mark.parametrize("looks", NOTICES.values(), ids=NOTICES)
def test_what_is_told_although_it_stops_nothing(looks: list[Look]) -> None:
    """With each look what is new; events of the guard's stop are of their own kind."""
    notices = Notices()
    for at_ms, seen, told in looks:
        found = list(notices.look(ChassisState(**seen), at_ms * MS, 0))  # type: ignore[arg-type]
        assert [(one.severity, one.reason, one.text) for one in found] == ([] if told is None else [told])
        for one in found:
            assert one.kind is (EventKind.GUARD if one.reason is Reason.GUARD else EventKind.FAULT)


def test_a_late_loop_is_told_once_a_second() -> None:
    """From the first time on, above 50 ms; of a robot that is idle it is no warning, which makes an incident."""
    notices = Notices()
    for at_ns, late_ms, is_idle, told in [
        (0, 50, False, None),
        (1, 51, False, (WARNING, "the loop was 51 ms late")),
        (LATE_TOLD_NS, 80, False, None),
        (LATE_TOLD_NS + 1, 80, False, (WARNING, "the loop was 80 ms late")),
        (2 * LATE_TOLD_NS + 1, 80, True, (INFO, "the loop was 80 ms late")),
    ]:
        found = list(notices.look(ChassisState(), at_ns, late_ms * MS, is_idle=is_idle))
        assert [(one.severity, one.text) for one in found] == ([] if told is None else [told])
        assert all(one.reason is LATE for one in found)
