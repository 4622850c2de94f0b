"""The consequences of standing: a warning before the robot moves, and the end of an idle engagement."""

import pytest

from schemas.decisions import ArbiterState, Bound, EventKind, Severity
from schemas.messages import Mode
from schemas.reasons import Reason
from schemas.settings import CommandSettings
from tests.support.rigs.arbiter import ArbiterRig, engaged

DARK, LIT = (False, False), (True, True)


def indicators(bench: ArbiterRig) -> tuple[object, ...] | None:
    """Those of this tick's frames, left and right; None without a frame."""
    assert bench.outcome is not None
    for frame in bench.outcome.auxiliary:
        if frame.name == "Auto_LightCmd":
            return frame.values["LeftIndicator"], frame.values["RightIndicator"]
    return None


def told_mps(bench: ArbiterRig) -> float:
    """The speed that the robot is told."""
    assert bench.arbiter.output.actuation is not None
    return bench.arbiter.output.actuation.speed_mps


def drive(bench: ArbiterRig, ticks: int, speed_mps: float) -> list[tuple[object, ...] | None]:
    """Ask for a speed for so long. Returns the indicators of each tick."""
    shown = []
    for _ in range(ticks):
        bench.drive(speed_mps)
        shown.append(indicators(bench))
    return shown


@pytest.mark.parametrize(("idle_s", "is_ended"), [(5.0, True), (5.5, False), (0.0, False)])
def test_an_idle_robot_is_disengaged_and_the_lease_stays(idle_s: float, *, is_ended: bool) -> None:
    """Row 'an engaged robot at zero command': a normal end; any speed begins it anew; 0 is never."""
    bench = engaged(idle_s=idle_s)
    bench.drive_for(300, 0.0)
    bench.drive_for(10, 0.5)
    bench.drive_for(520, 0.0)
    assert (bench.arbiter.state is not ArbiterState.ENGAGED) is is_ended
    assert bench.arbiter.leases.held is not None
    if is_ended:
        assert bench.arbiter.engagement.stop_reason is Reason.IDLE
        (stop,) = bench.told(EventKind.STOP)
        assert stop.severity is Severity.INFO
        assert not bench.arbiter.latches.details


def test_it_takes_five_minutes_where_no_setting_says_otherwise() -> None:
    """And people are not warned."""
    assert (CommandSettings().idle_s, CommandSettings().warning_s) == (300.0, 0.0)


def test_people_are_warned_from_engage_on_and_no_speed_is_told_meanwhile() -> None:
    """Row 'warning people': both blink; the speed that is asked for is bound by 'warning'; then they go out."""
    bench = engaged(warning_s=2.0)
    shown = drive(bench, 190, 0.5)
    assert set(shown) == {DARK, LIT}
    assert told_mps(bench) == 0
    assert Bound.WARNING in bench.arbiter.output.motion.bounds
    shown = drive(bench, 100, 0.5)
    assert shown[-60:] == [None] * 60
    assert told_mps(bench) > 0
    assert Bound.WARNING not in bench.arbiter.output.motion.bounds


@pytest.mark.parametrize(("stands", "is_warned"), [(450, False), (560, True)])
def test_people_are_warned_again_after_five_seconds_of_standing(stands: int, *, is_warned: bool) -> None:
    """As it is about to move, and not before."""
    bench = engaged(warning_s=1.0)
    drive(bench, 300, 0.5)
    assert told_mps(bench) == 0.5
    assert set(drive(bench, stands + 50, 0.0)) == {None}
    assert (LIT in drive(bench, 90, 0.5)) is is_warned
    assert (Bound.WARNING in bench.arbiter.output.motion.bounds) is is_warned
    drive(bench, 200, 0.5)
    assert told_mps(bench) == 0.5


def test_where_it_is_off_nobody_is_warned() -> None:
    """The start value of ``command.warning_s`` is 0."""
    bench = engaged()
    assert set(drive(bench, 200, 0.5)) == {None}
    assert told_mps(bench) > 0


def test_a_stop_ends_the_warning_and_puts_the_lamps_out() -> None:
    """No chassis is left with an indicator on by chance."""
    bench = engaged(warning_s=2.0)
    drive(bench, 50, 0.0)
    bench.ask("disengage")
    assert indicators(bench) == DARK


@pytest.mark.parametrize("then", ["engage", "stop"])
def test_a_warning_that_the_remote_control_cut_off_is_put_out_afterwards(then: str) -> None:
    """The chassis keeps its indicators while somebody else commands it: what we send next clears them."""
    bench = engaged(warning_s=2.0)
    drive(bench, 50, 0.5)
    bench.changes = {"mode": Mode.REMOTE}
    bench.tick(count=500)
    bench.changes = {}
    bench.tick(count=50)
    if then == "engage":
        bench.ask("acquire")
        bench.ask("engage")
    else:
        bench.changes = {"speed_mps": 0.3, "wheel_speed_mps": 0.3, "fastest_wheel_mps": 0.3, "turns": True}
    shown = []
    for _ in range(50):
        bench.tick()
        shown.append(indicators(bench))
    assert next(filter(None, shown), None) == DARK
