"""Which frames may be sent to which bus."""

import pytest

from recorder.reading.faults import Faults
from recorder.reading.rows import Row
from recorder.reading.topics import Topic
from recorder.replay.frames import (
    Frames,
    Rules,
    buses_of,
    holds_frames,
    is_command,
    refusal,
)
from recorder.replay.rows import frames
from schemas.can_word import IDENTIFIER_MASK
from schemas.dbc_files import dbc_text
from schemas.dbc_files import frames as dbc_frames
from schemas.messages import CanFrame, Gear, Variant
from tests.support.messages import WALL_NS, can_frame
from tests.support.reading import row_of, topic

RX = topic("fleet/cruiser-1/can/can0/rx")
TX = topic("fleet/cruiser-1/can/can0/tx")
DRIVE_COMMAND = 0x18C4D3D0
DRIVE_FEEDBACK = 0x18C4D3EF
REAL = Rules(is_virtual=False)
VIRTUAL = Rules(is_virtual=True)


def sent(rules: Rules, *rows: tuple[Topic, CanFrame]) -> tuple[list[CanFrame], dict[str, int]]:
    """The frames that go out, and those that do not, by why."""
    found = Frames(rules, Faults())
    return [one.frame for one in found.of(frames(row_of(*row) for row in rows))], dict(found.withheld)


@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
def test_every_command_of_the_dbc_is_one_and_no_feedback_is(variant: Variant) -> None:
    """By the identifier alone, in both variants."""
    for frame in dbc_frames(dbc_text(variant)):
        identifier = frame.can_id & IDENTIFIER_MASK
        assert is_command(can_frame(identifier)) is (not frame.is_feedback)


def test_a_sibling_chassis_has_commands_of_its_own() -> None:
    """The family shares the form of the identifiers, not the functions."""
    assert is_command(can_frame(0x18C4DED0))
    assert not is_command(can_frame(0x1D0, is_extended=False))


@pytest.mark.parametrize("identifier", [0x18C40000 | function << 8 | 0xD0 for function in range(0, 256, 5)])
def test_no_command_reaches_a_real_bus(identifier: int) -> None:
    """Not even one that was received: another computer may have driven the robot."""
    found, withheld = sent(REAL, (RX, can_frame(identifier)), (TX, can_frame(identifier)))
    assert found == []
    assert withheld == {"command frames, to a bus that is not virtual": 2}


@pytest.mark.parametrize(
    ("takes_commands", "of", "frame", "is_sent"),
    [
        pytest.param(False, RX, can_frame(DRIVE_FEEDBACK), True, id="feedback, to a real bus that is forced"),
        pytest.param(False, TX, can_frame(DRIVE_FEEDBACK), False, id="what a gateway sent"),
        pytest.param(False, TX, can_frame(0x7FF, is_extended=False), False, id="whatever its identifier is"),
        pytest.param(True, TX, can_frame(DRIVE_COMMAND), True, id="the second flag lets commands out"),
    ],
)
def test_what_reaches_a_real_bus(*, takes_commands: bool, of: Topic, frame: CanFrame, is_sent: bool) -> None:
    """By the direction in which it went, and the flags."""
    rules = Rules(is_virtual=False, takes_commands=takes_commands)
    assert sent(rules, (of, frame))[0] == [frame] * is_sent


def test_a_virtual_bus_takes_all_that_can_be_sent() -> None:
    """Error frames are a controller's own; CAN FD frames only where the bus was opened for them."""
    rows = [
        (RX, can_frame(DRIVE_COMMAND)),
        (TX, can_frame(DRIVE_COMMAND)),
        (RX, can_frame(4, is_extended=False, is_error=True)),
        (RX, can_frame(5, is_fd=True)),
        (RX, can_frame(6, data=b"", is_remote=True)),
    ]
    found, withheld = sent(VIRTUAL, *rows)
    assert [one.identifier for one in found] == [DRIVE_COMMAND, DRIVE_COMMAND, 6]
    assert withheld == {"error frames": 1, "CAN FD frames, without --fd": 1}
    assert len(sent(Rules(is_virtual=True, takes_fd=True), *rows)[0]) == 4


def test_what_is_not_known_to_be_virtual_is_refused() -> None:
    """With a text that says what would happen."""
    assert "obeys the last command for ever" in refusal("socketcan", is_virtual=False, is_forced=False)
    assert refusal("socketcan", is_virtual=True, is_forced=False) == ""
    assert refusal("pcan", is_virtual=False, is_forced=True) == ""


@pytest.mark.parametrize("is_virtual", [True, False])
def test_multicast_is_refused_whoever_forces_it(is_virtual: bool) -> None:  # noqa: FBT001 - the parameter of the test
    """It is no bus: it reaches whoever listens."""
    assert refusal("udp_multicast", is_virtual=is_virtual, is_forced=True) != ""


def test_only_raw_frames_are_taken() -> None:
    """Those received, unless those sent are asked for too; of wanted keys."""

    def every(_key: str) -> bool:
        return True

    assert holds_frames(RX, every, with_sent=False)
    assert not holds_frames(TX, every, with_sent=False)
    assert holds_frames(TX, every, with_sent=True)
    assert not holds_frames(RX, lambda _: False, with_sent=True)
    assert not holds_frames(topic("fleet/cruiser-1/chassis/gear", Gear), every, with_sent=True)
    assert not holds_frames(topic("fleet/cruiser-1/state"), every, with_sent=True)
    assert not holds_frames(topic("elsewhere"), every, with_sent=True)


def test_a_bus_is_one_for_both_directions() -> None:
    """And another robot's is another, whatever it is called."""
    other = topic("fleet/cruiser-2/can/can0/rx")
    assert buses_of([RX, TX]) == ["fleet/cruiser-1/can/can0"]
    assert buses_of([RX, TX, other]) == ["fleet/cruiser-1/can/can0", "fleet/cruiser-2/can/can0"]


def test_bytes_that_are_no_frame_are_a_fault() -> None:
    """Told, and passed over."""
    faults = Faults()
    found = Frames(VIRTUAL, faults)
    rows = [Row(RX, 0, WALL_NS, WALL_NS, b"\xff\xff"), row_of(RX, can_frame())]
    assert len(list(found.of(frames(rows)))) == 1
    assert faults.count == 1
