"""The guard of a gateway that died, by its note."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from gateway.host import guard_process
from gateway.host.guard_process import STOP_MAX_S, FormerGuard
from gateway.host.notes import StopNote
from tests.support.waiting import wait_until

BEGUN = "guard: the gateway is gone, last heartbeat 51 ms ago: stopping the robot"


@pytest.fixture
def note(tmp_path: Path) -> StopNote:
    return StopNote(tmp_path / "fleet.cruiser-1.guard-stop")


def test_a_stop_that_is_under_way_is_followed_to_its_end(note: StopNote) -> None:
    """Its final words come after the start of the next gateway."""
    note.add(BEGUN)
    former = FormerGuard(note)
    assert (former.is_stopping, former.says) == (True, "")
    note.add("guard: done: the robot stands; 180 frames sent")
    wait_until(lambda: not former.is_stopping)
    assert former.says == "the robot stands; 180 frames sent"
    former.close()


@pytest.mark.parametrize("last", ["guard: done: the robot stands; 180 frames sent", "halt: 96 frames sent"])
def test_a_stop_that_is_over_is_not(note: StopNote, last: str) -> None:
    """Nor what somebody else has done since."""
    note.add(BEGUN)
    note.add(last)
    former = FormerGuard(note)
    assert (former.is_stopping, former.says) == (False, "")
    former.close()


@pytest.mark.parametrize("age_s", [STOP_MAX_S + 1, -60])
def test_nor_is_one_whose_guard_must_have_died(note: StopNote, age_s: float) -> None:
    """No stop takes so long; and of a time to come nothing is known."""
    assert note.path is not None
    begun = datetime.now(UTC) - timedelta(seconds=age_s)
    note.path.write_text(f"{begun.isoformat(timespec='milliseconds')} {BEGUN}\n")
    former = FormerGuard(note)
    assert not former.is_stopping
    former.close()


@pytest.mark.parametrize("content", ["", "no time\n", "cut o"])
def test_a_damaged_note_tells_of_no_stop_under_way(note: StopNote, content: str) -> None:
    """It latches all the same; see the note itself."""
    assert note.path is not None
    note.path.write_text(content)
    assert not FormerGuard(note).is_stopping


def test_a_guard_that_never_says_how_it_ended_is_given_up(note: StopNote, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was killed too."""
    monkeypatch.setattr(guard_process, "STOP_MAX_S", 0.2)
    note.add(BEGUN)
    former = FormerGuard(note)
    wait_until(lambda: not former.is_stopping)
    assert former.says == ""
    former.close()
