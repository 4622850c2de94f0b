"""Row 'the name and the chassis': a mileage that is not this robot's is asked about, once."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.host import notes
from gateway.host.notes import MileageNote
from schemas.settings import GatewaySettings, RobotSettings, Settings
from tests.support.waiting import wait_until


@pytest.fixture
def start(tmp_path: Path) -> Callable[..., MileageNote]:
    """Open the note of a robot, as each start does."""

    def opened(name: str = "cruiser-1") -> MileageNote:
        settings = Settings(gateway=GatewaySettings(state_dir=str(tmp_path)), robot=RobotSettings(name=name))
        return MileageNote.of(settings)

    return opened


def drive(note: MileageNote, *mileages_km: float | None) -> list[str]:
    """Follow these, each until it is written. Returns what was asked."""
    asked = []
    for mileage_km in mileages_km:
        asked.append(note.follow(mileage_km))
        wait_until(lambda: note._path is not None and notes._read(note._path) == note._noted_km)
    return [one for one in asked if one]


@pytest.mark.parametrize(
    ("before_km", "then_km", "is_asked"),
    [(12.0, 12.0, False), (12.0, 13.0, False), (12.0, 13.001, True), (812.4, 3.0, True), (3.0, 0.0, True)],
)
def test_a_mileage_that_is_far_off_at_a_start_is_asked_about_once(
    start: Callable[..., MileageNote], before_km: float, then_km: float, *, is_asked: bool
) -> None:
    """Over 1 km, either way; and the next start knows the new one."""
    assert drive(start(), None, before_km) == []
    asked = drive(start(), None, then_km, then_km)
    assert len(asked) == is_asked
    assert all(f"reads {then_km:.1f} km, and read {before_km:.1f} km when" in one for one in asked)
    assert drive(start(), then_km) == []


def test_a_run_may_drive_as_far_as_it_likes_and_another_name_has_another_note(
    start: Callable[..., MileageNote],
) -> None:
    """Also back to zero, as ``clear_odometer`` does; the next start compares with the last of it."""
    assert drive(start(), 5.0, *(5.0 + 0.1 * number for number in range(40)), 0.0, 0.4, 0.46) == []
    assert drive(start("cruiser-2"), 700.0) == []
    assert drive(start(), 0.5) == []
    assert len(drive(start(), 9.0)) == 1


@pytest.mark.parametrize("content", [b"", b"{}", b'"x"', b"\xff"])
def test_a_damaged_note_asks_nothing(start: Callable[..., MileageNote], tmp_path: Path, content: bytes) -> None:
    """Nothing is known then."""
    (tmp_path / "fleet.cruiser-1.mileage.json").write_bytes(content)
    assert drive(start(), 5.0) == []
    assert len(drive(start(), 9.0)) == 1


def test_a_disk_that_stalls_holds_nobody_up(
    start: Callable[..., MileageNote], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One mileage waits for it, and not one each tick."""
    goes_on, written = threading.Event(), list[float]()

    def write(_: Path, mileage_km: float) -> None:
        goes_on.wait()
        written.append(mileage_km)

    monkeypatch.setattr(notes, "_write_mileage", write)
    note = start()
    for number in range(100):
        assert note.follow(float(number)) == ""
    assert note._waiting.qsize() <= 1
    goes_on.set()
    wait_until(lambda: note.follow(100.0) == "" and written[-1:] == [100.0])
    assert len(written) <= 3
