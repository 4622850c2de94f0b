"""Faults in force: what each does to the frames, and how it ends."""

from itertools import pairwise

import pytest

from gateway.chassis.frame import ERROR, EXTENDED, FaultKind, Frame, FrameFault
from gateway.chassis.layout import Decoded, checksum
from gateway.sim.disturbances import ScheduledFault, parse_scheduled
from tests.support.rigs.chassis import ChassisRig, S

GEAR = "Auto_GearFeedBack"
DRIVE = "Auto_DriveFeedBack"


def test_a_bad_checksum_strikes_one_message() -> None:
    """All its frames are wrong, the others are right."""
    rig = ChassisRig()
    rig.fault(f"checksum {DRIVE}")
    frames = rig.run(1)
    kinds = {type(rig.decoder.decode(frame)) for frame in rig.named(DRIVE, frames)}
    assert kinds == {FrameFault}
    assert sum(isinstance(rig.decoder.decode(frame), Decoded) for frame in frames) == 530
    fault = rig.decoder.decode(rig.named(DRIVE, frames)[0])
    assert isinstance(fault, FrameFault)
    assert fault.kind is FaultKind.CHECKSUM


COUNTED = {
    "stuck, it goes on from where it stood": (0.05, "stuck G for 5 frames | 0.1", "5 5 5 5 5 5 6 7 8 9"),
    "skipping, it rises by 2 unless told": (0.0, "skip G by 3 | 0.05, skip G | 0.03", "0 3 6 9 12 15 1 3"),
    "silent, nothing is counted": (0.05, "silence G for 2s | 2, foreign 123 off | 0.03", "5 6 7 8"),
    "dropped, it was sent": (0.0, "drop G every 4 | 0.1, drop G next 3 | 0.06", "0 1 2 4 5 6 8 9 13 14 15"),
}
"""After a time these faults, each for a time, and the counters meanwhile."""


@pytest.mark.parametrize("name", COUNTED)
def test_a_counter_tells_what_became_of_its_message(name: str) -> None:
    """The checksums stay right meanwhile, and all other messages come: 530 a second."""
    before_s, faults, counters = COUNTED[name]
    rig = ChassisRig()
    rig.run(before_s)
    frames, took_s = list[Frame](), 0.0
    for fault in faults.split(", "):
        text, seconds = fault.split(" | ")
        rig.fault(f"{text} ".replace(" G ", f" {GEAR} "))
        frames += rig.run(float(seconds))
        took_s += float(seconds)
    assert rig.counters(GEAR, frames) == [int(one) for one in counters.split()]
    assert len(frames) - len(rig.named(GEAR, frames)) == pytest.approx(530 * took_s, abs=10)
    assert all(checksum(frame.data) == frame.data[7] for frame in frames)


def test_a_frozen_message_counts_on() -> None:
    """Values as they were, counters and checksums as they should be; the other messages tell the truth."""
    rig = ChassisRig()
    rig.command("drive", 1.0)
    rig.run(2)
    rig.fault(f"freeze {DRIVE}")
    rig.run(0.01)
    rig.command("drive", 0.0)
    frames = rig.run(2)
    assert rig.seen[DRIVE]["Speed"] == 1.0
    assert rig.seen["Auto_WheelSpdFeedback"]["RearLeftSpeed"] == 0
    assert rig.counters(DRIVE, frames) == [(201 + number) % 16 for number in range(200)]
    assert all(checksum(frame.data) == frame.data[7] for frame in frames)
    rig.fault(f"freeze {DRIVE} off")
    rig.run(0.1)
    assert rig.seen[DRIVE]["Speed"] == 0


def test_a_message_freezes_anew_each_time() -> None:
    """Frozen again, it keeps what it was then."""
    rig = ChassisRig()
    rig.command("drive", 1.0)
    rig.fault(f"freeze {DRIVE} for 10 frames")
    rig.run(0.1)
    assert rig.seen[DRIVE]["Speed"] == 0
    rig.run(2)
    rig.fault(f"freeze {DRIVE}")
    rig.run(0.01)
    rig.command("drive", 0.0)
    rig.run(2)
    assert rig.seen[DRIVE]["Speed"] == 1.0


@pytest.mark.parametrize("hit", [True, False])
def test_a_bouncing_bumper_chatters_and_rests(hit: bool) -> None:  # noqa: FBT001
    """Contact comes and goes, each time alike, and ends as it was asked to."""
    seen = []
    for _ in range(2):
        rig = ChassisRig()
        if not hit:
            rig.fault("bumper both on")
            rig.run(0.1)
        rig.fault(f"bumper both {'on' if hit else 'off'} bounce")
        contacts = []
        for _ in range(40):
            rig.run(0.01)
            body = rig.seen["Auto_MileageAndBodyFeedback"] if rig.now_ns >= 2 * S // 100 else {}
            contacts.append(body.get("FrontBumper", False))
            assert body.get("RearBumper", False) is contacts[-1]
        seen.append(contacts)
    assert seen[0] == seen[1]
    assert sum(before is not after for before, after in pairwise(seen[0])) >= 4
    assert set(seen[0][-15:]) == {hit}


def test_all_means_every_message() -> None:
    """With all silent there is nothing on the bus."""
    rig = ChassisRig()
    rig.fault("silence all")
    assert rig.run(1) == []
    rig.fault("silence all off")
    assert len(rig.run(1)) == 630


def test_foreign_frames_are_on_the_bus() -> None:
    """Standard, extended and error frames, as they were asked for, beside all the chassis's own."""
    rig = ChassisRig()
    rig.fault("foreign 123 every 20ms")
    rig.fault("foreign 18C4D6EF 0102 every 100ms")
    rig.fault("foreign 004 error every 500ms")
    frames = rig.run(1)
    foreign = {frame.can_id: frame for frame in frames if rig.decoder.decode(frame).__class__ is FrameFault}
    assert set(foreign) == {0x123, 0x18C4D6EF | EXTENDED, 0x004 | ERROR}
    assert foreign[0x18C4D6EF | EXTENDED].data == b"\x01\x02"
    assert sum(frame.can_id == 0x123 for frame in frames) == 51, "from 0 s to 1 s, both included"
    assert len(frames) == 630 + 51 + 11 + 3
    rig.fault("foreign 004 off")
    assert 0x004 | ERROR not in {frame.can_id for frame in rig.run(1)}


def test_clear_ends_everything() -> None:
    """After it the chassis is as at the start."""
    rig = ChassisRig()
    faults = "silence all, checksum all, foreign 123, bumper both on, transmitter remote, sticks 1 1, scale wrong"
    for text in f"{faults}, variant fine, slope 20, payload 100, pedal 1, motor 0, reboot".split(", "):
        rig.fault(text)
    rig.run(1)
    rig.fault("clear")
    assert len(rig.run(1)) == 630
    assert rig.seen["Auto_MileageAndBodyFeedback"]["FrontBumper"] is False
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "stop"
    rig.fault("transmitter remote")
    rig.run(1)
    assert rig.speed_mps == 0


@pytest.mark.parametrize(
    ("text", "ends_s"),
    [
        *((f"{one} for 1s", 1.0) for one in ("bumper rear on", "slope 8", "reboot", "transmitter remote")),
        (f"checksum {GEAR} for 1s", 1.0),
        ("reboot", 2.0),
    ],
)
def test_a_fault_with_a_duration_ends_by_itself(text: str, ends_s: float) -> None:
    """Nobody has to come back to end it."""
    rig = ChassisRig()
    rig.fault(text)
    rig.run(ends_s - 0.1)
    assert not rig.chassis._disturbances.quiet
    rig.run(0.2)
    assert rig.chassis._disturbances.quiet


def test_the_later_fault_takes_the_place_of_the_earlier() -> None:
    """A new duration counts from its own beginning."""
    rig = ChassisRig()
    rig.fault("bumper front on for 1s")
    rig.run(0.5)
    rig.fault("bumper front on for 1s")
    rig.run(0.9)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["FrontBumper"] is True
    rig.run(0.2)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["FrontBumper"] is False


def test_a_fault_waits_for_its_time() -> None:
    """Scheduled faults begin when they are due, in order, whatever the order of asking."""
    rig = ChassisRig()
    for text in ("2s bumper front off", "1s bumper front on"):
        scheduled = parse_scheduled(text)
        assert isinstance(scheduled, ScheduledFault)
        rig.chassis.inject(scheduled.line, scheduled.after_ns)
    seen = []
    for _ in range(3):
        rig.run(0.9)
        seen.append(rig.seen["Auto_MileageAndBodyFeedback"]["FrontBumper"])
    assert seen == [False, True, False]
    assert rig.now_ns == round(2.7 * S)
