"""The gateway's side of the guard, and following the guard of a gateway that died."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from gateway.choice.chassis import CHASSIS
from gateway.command.flow import CommandFlow
from gateway.guard.stopper import GuardView
from gateway.host import guard_process
from gateway.host.guard_process import STOP_MAX_S, FormerGuard, start_guard
from gateway.host.notes import StopNote
from schemas.settings import CanSettings, GatewaySettings, Settings
from tests.support.waiting import wait_until

BEGUN = "guard: the gateway is gone, last heartbeat 51 ms ago: stopping the robot"


@pytest.fixture
def note(tmp_path: Path) -> StopNote:
    return StopNote(tmp_path / "fleet.cruiser-1.guard-stop")


def test_a_stop_that_is_under_way_is_followed_to_its_end(note: StopNote) -> None:
    note.add(BEGUN)
    former = FormerGuard(note)
    assert (former.is_stopping, former.says) == (True, "")
    note.add("guard: done: the robot stands; 180 frames sent")
    wait_until(lambda: not former.is_stopping)
    assert former.says == "the robot stands; 180 frames sent"
    former.close()


def test_a_guard_that_never_says_how_it_ended_is_given_up(note: StopNote, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard_process, "STOP_MAX_S", 0.2)
    note.add(BEGUN)
    former = FormerGuard(note)
    wait_until(lambda: not former.is_stopping)
    assert former.says == ""
    former.close()


@pytest.mark.parametrize(
    ("age_s", "begun", "then"),
    [
        (0, BEGUN, "guard: done: the robot stands; 180 frames sent"),
        (0, BEGUN, "halt: 96 frames sent"),
        pytest.param(STOP_MAX_S + 1, BEGUN, "", id="no stop takes so long"),
        pytest.param(-60, BEGUN, "", id="of a time to come nothing is known"),
        pytest.param(0, "\x07", "", id="damaged"),
    ],
)
def test_a_stop_that_is_over_is_not(note: StopNote, age_s: float, begun: str, then: str) -> None:
    assert note.path is not None
    time = datetime.now(UTC) - timedelta(seconds=age_s)
    note.path.write_text(f"{time.isoformat(timespec='milliseconds')} {begun}\n")
    if then:
        note.add(then)
    former = FormerGuard(note)
    assert (former.is_stopping, former.says) == (False, "")
    former.close()


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (Settings(can=CanSettings(interface="virtual")), "virtual"),
        (Settings(can=CanSettings(interface="pcan")), "pcan"),
        (Settings(gateway=GatewaySettings(listen_only=True)), "only listens"),
    ],
)
def test_where_no_guard_can_be_the_link_says_why(settings: Settings, says: str) -> None:
    link = start_guard(settings)
    assert says in link.why_not
    link.beat(1, CommandFlow(CHASSIS, settings, 1))
    link.close()
    assert link.look() == GuardView()
