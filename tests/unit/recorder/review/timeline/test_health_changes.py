"""What the gateway's health tells of what went wrong."""

import msgspec
import pytest

from recorder.review.timeline.entries import EntryKind
from recorder.review.timeline.health_changes import FAILURES_IN_WORDS, risen
from schemas.decisions import Severity
from schemas.messages import ControllerState, FrameHealth, GatewayHealth, Variant
from tests.support.messages import HEALTH

FRAME = msgspec.structs.replace(HEALTH.feedback[0], valid=50)
WELL = msgspec.structs.replace(HEALTH, faults={}, feedback=[FRAME])


def health(**changes: object) -> GatewayHealth:
    """A health that is well, but for this."""
    return msgspec.structs.replace(WELL, **changes)


def frame(**changes: object) -> list[FrameHealth]:
    """The feedback, with this changed."""
    return [msgspec.structs.replace(FRAME, **changes)]


def test_nothing_new_tells_nothing() -> None:
    """However long it lasts."""
    ill = health(faults={"checksum": 7}, feedback=frame(failures=["checksum"], checksum_faults=7), bus_losses=3)
    assert list(risen(ill, ill)) == []
    assert list(risen(None, WELL)) == []


@pytest.mark.parametrize(
    ("changes", "text", "count"),
    [
        ({"faults": {"silence": 2}}, "faults of frames: silence", 2),
        ({"feedback": frame(checksum_faults=3)}, "frames with a wrong checksum", 3),
        ({"feedback": frame(failures=["silence"])}, "silent", 1),
        ({"bus_losses": 1}, "the CAN bus was lost", 1),
        ({"bus_drops": 9}, "frames were dropped: not read in time, or garbled", 9),
        ({"publish_failures": 4}, "Zenoh did not take samples", 4),
        ({"inbox_drops": 5}, "requests were dropped unread: too many came", 5),
        ({"bus_up": False, "bus_detail": "no such device"}, "the CAN bus can0 is not there: no such device", 1),
        ({"controller": ControllerState.PASSIVE}, "the CAN controller: unknown before, passive now", 1),
        ({"variant": Variant.FINE}, "the firmware variant: coarse before, fine now", 1),
    ],
)
def test_what_is_new_is_told_with_its_count(changes: dict[str, object], text: str, count: int) -> None:
    """Once, and nothing else."""
    assert [(one.text, one.count) for one in risen(WELL, health(**changes))] == [(text, count)]


def test_the_end_of_a_fault_is_told() -> None:
    """It is good news."""
    (bus,) = risen(health(bus_up=False), WELL)
    (over,) = risen(health(feedback=frame(failures=["period"])), WELL)
    assert (bus.severity, over.severity) == (Severity.INFO, Severity.INFO)


def test_a_log_that_begins_amid_faults_tells_those_that_last() -> None:
    """Counts of before its beginning are none of its."""
    ill = health(faults={"checksum": 7}, feedback=frame(failures=["checksum"], checksum_faults=7), bus_up=False)
    assert [one.kind for one in risen(None, ill)] == [EntryKind.FAULT, EntryKind.FAULT]


def test_a_frame_that_says_a_thing_is_not_said_twice() -> None:
    """The sum over all frames is left out where a frame tells."""
    new = health(faults={"checksum": 3, "length": 1}, feedback=frame(checksum_faults=3))
    assert [one.text for one in risen(WELL, new)] == [
        "frames with a wrong checksum",
        "faults of frames: length",
    ]


LOST = "frames that should have come, and did not; they are counted when that is known"

NAMES = ("Auto_GearFeedBack", "Auto_DriveFeedBack")


def frames(**changes: object) -> list[FrameHealth]:
    """Two frames, both with this changed."""
    return [msgspec.structs.replace(FRAME, name=name, **changes) for name in NAMES]


def test_what_befalls_several_frames_is_one() -> None:
    """It names them all; neither the sum over all frames nor their silence is said besides."""
    well, ill = health(feedback=frames()), health(feedback=frames(failures=["silence"]), faults={"silence": 2})
    back = health(feedback=frames(lost=50), faults={"silence": 2})
    begun, ended = list(risen(well, ill)), list(risen(ill, back))
    assert [(one.text, one.count, one.about, one.is_end) for one in begun] == [("silent", 2, NAMES, False)]
    assert [(one.text, one.count, one.about, one.is_end) for one in ended] == [
        ("no longer at fault (silence)", 2, NAMES, True),
        (LOST, 100, NAMES, True),
    ]


def test_when_frames_were_lost_is_not_known() -> None:
    """They are counted when what was only late has come, and so may have been lost long before."""
    (lost,) = risen(health(feedback=frames()), health(feedback=frames(lost=3)))
    assert (lost.text, lost.count, lost.is_end) == (LOST, 6, True)


def test_every_failure_has_words() -> None:
    """Those of the supervision."""
    assert set(FAILURES_IN_WORDS) == {"checksum", "implausible", "alive_counter", "period", "silence"}
