"""Faults: grammar, effects and ends."""

import re
from ast import literal_eval
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.frame import ERROR, EXTENDED, FaultKind, Frame, FrameFault
from gateway.chassis.layout import Decoded, checksum
from gateway.sim.disturbances import (
    GRAMMAR,
    FaultLine,
    FaultTextError,
    parse,
    parse_address,
    parse_scheduled,
    show_address,
)
from schemas.command_line import CommandError
from tests.support import SUPPORT
from tests.support.rigs.chassis import ChassisRig, S

GEAR = "Auto_GearFeedBack"
DRIVE = "Auto_DriveFeedBack"


def test_a_bad_checksum_strikes_one_message() -> None:
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
    "skipping, it rises by 2 by default": (0.0, "skip G by 3 | 0.05, skip G | 0.03", "0 3 6 9 12 15 1 3"),
    "silent, nothing is counted": (0.05, "silence G for 2s | 2, foreign 123 off | 0.03", "5 6 7 8"),
    "dropped, it was sent": (0.0, "drop G every 4 | 0.1, drop G next 3 | 0.06", "0 1 2 4 5 6 8 9 13 14 15"),
}
"""After a time these faults, each for a time, and the counters meanwhile."""


@pytest.mark.parametrize("name", COUNTED)
def test_a_counter_tells_what_became_of_its_message(name: str) -> None:
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


@pytest.mark.parametrize("hit", [True, False])
def test_a_bouncing_bumper_chatters_and_rests(hit: bool) -> None:  # noqa: FBT001
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


def test_foreign_frames_are_on_the_bus() -> None:
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
    rig = ChassisRig()
    rig.fault(text)
    rig.run(ends_s - 0.1)
    assert not rig.chassis._disturbances.quiet
    rig.run(0.2)
    assert rig.chassis._disturbances.quiet


LINES = SUPPORT.parent / "data" / "faults.txt"
"""Lines, scheduled or not, and their meaning or error; ``python -m tests.unit.gateway.sim.test_disturbances``."""


def lines() -> dict[str, str]:
    rows = (row.partition(": ") for row in LINES.read_text("utf-8").splitlines())
    return {literal_eval(text): meaning for text, _, meaning in rows}


@pytest.mark.parametrize(("text", "meaning"), lines().items())
def test_a_line_means_this_or_its_error_shows_the_right_form(text: str, meaning: str) -> None:
    assert str(parse_scheduled(text)) == meaning


@given(st.text() | st.lists(st.sampled_from([*" ".join(lines()).split(), "é", "\ud800"])).map(" ".join))
def test_no_text_raises(text: str) -> None:
    """Faults may come from the network."""
    outcome = parse(text)
    if isinstance(outcome, FaultTextError):
        assert outcome.reason
        assert len(outcome.reason) < 500
        assert "\n" not in outcome.reason
    parse_scheduled(text)


def test_the_help_names_every_fault() -> None:
    shown = set(re.findall(r"^ {2}(\w+)", GRAMMAR, re.MULTILINE))
    assert shown == {text.split()[0].lower() for text in lines() if isinstance(parse(text), FaultLine)}


@pytest.mark.parametrize(
    ("text", "address"),
    [("127.0.0.1:29536", ("127.0.0.1", 29536)), ("localhost:0", ("localhost", 0)), ("[::1]:7", ("::1", 7))],
)
def test_an_address_reads_and_shows_the_same(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text) == address
    assert show_address(*address) == text


@pytest.mark.parametrize("text", ["", "localhost", ":1", "host:", "host:x", "host:65536", "::1:7", "a b:1"])
def test_what_is_no_address_is_a_usage_error(text: str) -> None:
    with pytest.raises(CommandError, match="HOST:PORT"):
        parse_address(text)


if __name__ == "__main__":
    LINES.write_text("".join(f"{text!r}: {parse_scheduled(text)}\n" for text in lines()), "utf-8")
