"""What is told although it stops nothing."""

from gateway.chassis.port import ChassisState
from gateway.command.rulings import Event, Notices
from schemas.decisions import EventKind, Severity
from schemas.messages import ControllerState
from schemas.reasons import Reason
from schemas.settings import COMMANDER_QUIET_NS, LATE_TOLD_NS

MS = 1_000_000


def test_a_late_loop_is_told_once_a_second() -> None:
    """From the first time on, above 50 ms; how late is in the words."""
    notices = Notices()
    assert list(notices.look(ChassisState(), 0, 50 * MS)) == []
    assert list(notices.look(ChassisState(), 1, 51 * MS)) == [
        Event(Severity.WARNING, EventKind.FAULT, Reason.LOOP_LATE, "the loop was 51 ms late")
    ]
    assert list(notices.look(ChassisState(), LATE_TOLD_NS, 80 * MS)) == []
    assert len(list(notices.look(ChassisState(), LATE_TOLD_NS + 1, 80 * MS))) == 1
    (idle,) = notices.look(ChassisState(), 2 * LATE_TOLD_NS + 1, 80 * MS, is_idle=True)
    assert idle.severity is Severity.INFO, "a recorder makes an incident of warnings"


def test_each_change_of_the_controller_is_told() -> None:
    """Off the bus it is an error; that it is well again is told too."""
    notices = Notices()
    told = [
        (notice.severity, notice.reason, notice.text)
        for state in ("unknown", "warning", "warning", "passive", "bus_off", "bus_off", "active")
        for notice in notices.look(ChassisState(controller=ControllerState(state)), 0, 0)
    ]
    begin = "the CAN controller: "
    assert told == [
        (Severity.WARNING, Reason.BUS_ERRORS, f"{begin}unknown before, warning now"),
        (Severity.WARNING, Reason.BUS_ERRORS, f"{begin}warning before, passive now"),
        (Severity.ERROR, Reason.BUS_OFF, f"{begin}passive before, bus_off now"),
        (Severity.INFO, Reason.BUS_ERRORS, f"{begin}bus_off before, active now"),
    ]


def test_another_computers_commands_are_told_once_until_they_have_ceased_for_a_second() -> None:
    """Also to a robot that stands by: two computers on one bus are found before they meet."""
    notices = Notices()
    told = [
        (at_ns, notice)
        for at_ns, heard_ns in [
            (0, None), (10, 5), (20, 15), (30, None), (40, 35), (50, 35), (50, 35 + COMMANDER_QUIET_NS),
            (60, 36 + 2 * COMMANDER_QUIET_NS),
        ]
        for notice in notices.look(ChassisState(commander_ns=heard_ns), at_ns, 0)
    ]  # fmt: skip
    text = "another computer commands the chassis on the bus"
    assert told == [
        (at_ns, Event(Severity.WARNING, EventKind.FAULT, Reason.OTHER_COMMANDER, text)) for at_ns in (10, 60)
    ]


def test_the_end_of_the_guards_stop_is_told_with_its_words() -> None:
    """Row 'the guard has stopped the robot': once, when it sends no more."""
    notices = Notices()
    cause = "the gateway's loop gave no sign of life"
    assert list(notices.look(ChassisState(guard_sends=True, guard_stops=1, guard_says=cause), 0, 0)) == []
    ended = ChassisState(guard_stops=1, guard_says=f"{cause}; the robot stands")
    text = f"the guard's stop has ended: {cause}; the robot stands"
    assert list(notices.look(ended, 1, 0)) == [Event(Severity.WARNING, EventKind.GUARD, Reason.GUARD, text)]
    assert list(notices.look(ended, 2, 0)) == []
    assert list(notices.look(ChassisState(), 3, 0)) == [], "another guard has begun, and says nothing yet"


def test_lost_real_time_priority_is_told_and_its_absence_is_not() -> None:
    """Row 'a gateway without real-time priority': from the start on it is in health, and is no event."""
    notices = Notices()
    assert list(notices.look(ChassisState(), 0, 0)) == []
    assert list(notices.look(ChassisState(realtime=True), 1, 0)) == []
    (notice,) = notices.look(ChassisState(), 2, 0)
    assert (notice.severity, notice.reason) == (Severity.WARNING, Reason.NO_REALTIME)
