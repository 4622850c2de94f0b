"""What is told although it stops nothing."""

from gateway.command.notices import Notice, Notices
from gateway.command.observed import Observed
from schemas.decisions import Severity
from schemas.messages import ControllerState
from schemas.reasons import Reason
from schemas.settings import LATE_TOLD_NS

MS = 1_000_000


def test_a_late_loop_is_told_once_a_second() -> None:
    """From the first time on, above 50 ms; how late is in the words."""
    notices = Notices()
    assert list(notices.look(Observed(), 0, 50 * MS)) == []
    assert list(notices.look(Observed(), 1, 51 * MS)) == [
        Notice(Severity.WARNING, Reason.LOOP_LATE, "the loop was 51 ms late")
    ]
    assert list(notices.look(Observed(), LATE_TOLD_NS, 80 * MS)) == []
    assert len(list(notices.look(Observed(), LATE_TOLD_NS + 1, 80 * MS))) == 1


def test_each_change_of_the_controller_is_told() -> None:
    """Off the bus it is an error; that it is well again is told too."""
    notices = Notices()
    told = [
        (notice.severity, notice.reason, notice.text)
        for state in ("unknown", "warning", "warning", "passive", "bus_off", "bus_off", "active")
        for notice in notices.look(Observed(controller=ControllerState(state)), 0, 0)
    ]
    begin = "the CAN controller: "
    assert told == [
        (Severity.WARNING, Reason.BUS_ERRORS, f"{begin}unknown before, warning now"),
        (Severity.WARNING, Reason.BUS_ERRORS, f"{begin}warning before, passive now"),
        (Severity.ERROR, Reason.BUS_OFF, f"{begin}passive before, bus_off now"),
        (Severity.INFO, Reason.BUS_ERRORS, f"{begin}bus_off before, active now"),
    ]
