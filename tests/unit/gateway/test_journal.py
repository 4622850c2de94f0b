"""What the core was given, written down."""

import msgspec
import pytest

from gateway.chassis.frame import EXTENDED, FD, REMOTE, Frame
from gateway.choice import CHASSIS
from gateway.command.restart import Carried
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.journal import BrokenJournalError, Input, JournalGapError, JournalWriter, reach, read
from gateway.telemetry.health import Links
from schemas import codec
from schemas.decisions import Journal
from schemas.journal import Kind
from schemas.settings import Settings
from schemas.subjects import BY_NAME
from tests.support.frames import CHALLENGE, MS, WALL_NS


def journals(batches: list[int], run: int = 7) -> list[Journal]:
    """A run's journals, each with so many inputs; an input tells its place."""
    writer, place, taken = JournalWriter(run), 0, []
    for count in batches:
        for _ in range(count):
            writer.add((Kind.SHUT_DOWN, place))
            place += 1
        journal = writer.take(WALL_NS)
        assert journal is not None
        taken.append(journal)
    return taken


def inputs_of(core: Core, at_ms: int) -> list[Input]:
    """The inputs that the core publishes at a tick that makes a batch due, but for that tick itself."""
    samples = core.tick(at_ms * MS, WALL_NS, 0, CHALLENGE).samples
    (sample,) = (sample for sample in samples if sample.subject == "journal")
    journal = codec.decode(BY_NAME["journal"], sample.payload)
    assert isinstance(journal, Journal)
    return list(read([msgspec.structs.replace(journal, first=0)]))[:-1]


def test_inputs_come_back_in_their_order() -> None:
    """Whatever batches they were published in."""
    inputs = list(read(journals([1, 300, 2, 70])))
    assert inputs == [(Kind.SHUT_DOWN, place) for place in range(373)]


def test_batches_are_numbered_and_nothing_is_published_without_inputs() -> None:
    """Each says its place, so that a gap can be seen."""
    first, second = journals([2, 3])
    assert (first.run, first.sequence, first.first, first.count) == (7, 0, 0, 2)
    assert (second.run, second.sequence, second.first, second.count) == (7, 1, 2, 3)
    assert JournalWriter(7).take(WALL_NS) is None


DAMAGED = {"empty": b"", "no opcode": b"\x91\xc1", "no UTF-8": b"\x91\x91\xa1\xff", "deep": b"\x91" * 10_000}


@pytest.mark.parametrize("inputs", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_journal_is_refused(inputs: bytes) -> None:
    """No MessagePack, a text that is not UTF-8, or one list within the other without end."""
    (journal,) = journals([2])
    with pytest.raises(BrokenJournalError, match="inputs 0 on cannot be read"):
        list(read([msgspec.structs.replace(journal, inputs=inputs)]))


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_journal_with_a_gap_is_refused(missing: int) -> None:
    """Also where the first is missing: run again from the midst, the core would be another one."""
    left = journals([2, 3, 4, 5])
    del left[missing]
    with pytest.raises(JournalGapError, match="are missing"):
        list(read(left))


def test_a_journal_that_ends_early_is_whole_up_to_there() -> None:
    """What a kill cuts off is the end."""
    assert len(list(read(journals([2, 3, 4])[:2]))) == 5


def test_the_journals_of_two_runs_are_refused() -> None:
    """Also where the places would fit: they are of two cores."""
    first, second = journals([2], run=7), journals([2, 2], run=8)
    for left in ([*first, *second], [*first, second[1]]):
        with pytest.raises(JournalGapError, match="run 8 begins"):
            list(read(left))


def test_every_input_of_the_core_is_written_down() -> None:
    """Each kind with its time and all that the core was given; of the links only what the core decides by."""
    core = Core(CHASSIS, Settings(), "1.2.3", 0, run=7)
    frames = [
        Frame(EXTENDED | 0x18C4D1EF, bytes(8), WALL_NS),
        Frame(0x123 | REMOTE, b"", 5, 0, 3),
        Frame(0x7, bytes(64), 6, FD),
    ]
    for at_ns, frame in enumerate(frames):
        core.receive_frame(frame, at_ns)
    core.receive_request(RawRequest(9, "stop", "first", b"\xff\x00", 2), 3)
    core.update_links(Links(bus_up=True, bus_losses=1, guarded=True), 4)
    core.update_links(Links(bus_up=True, bus_losses=1, guarded=True, zenoh_peers=5, cpu_ns=7), 5)
    says = "it has given up"
    core.update_links(
        Links(bus_up=True, bus_losses=1, guarded=True, guard_stops=1, guard_says=says, realtime=True), 6
    )
    core.latch_guard_stop("the robot stands", 7)
    core.warn("somebody is there", 7)
    core.take_over(Carried({"remote_stop": ""}, "remote_stop", "by a desk"), 7)
    core.shut_down(8)
    assert inputs_of(core, 0) == [
        (Kind.FRAME, 0, [EXTENDED | 0x18C4D1EF, bytes(8), WALL_NS, 0, 0]),
        (Kind.FRAME, 1, [0x123 | REMOTE, b"", 5, 0, 3]),
        (Kind.FRAME, 2, [0x7, bytes(64), 6, FD, 0]),
        (Kind.REQUEST, 3, 9, "stop", "first", b"\xff\x00", 2, ""),
        (Kind.LINKS, 4, True, 1, True, False, 0, False, False, ""),
        (Kind.LINKS, 6, True, 1, True, False, 1, False, True, "it has given up"),
        (Kind.GUARD_STOP, 7, "the robot stands"),
        (Kind.WARNING, 7, "somebody is there"),
        (Kind.CARRIED, 7, [{"remote_stop": ""}, "remote_stop", "by a desk", False, {}, False]),
        (Kind.SHUT_DOWN, 8),
    ]
    core.sent(0, 8, WALL_NS + 8)
    core.tick(10 * MS, WALL_NS + 10, 11, CHALLENGE)
    assert inputs_of(core, 50) == [
        (Kind.SENT, 8, 0, WALL_NS + 8),
        (Kind.TICK, 10 * MS, WALL_NS + 10, 11, CHALLENGE),
    ]


def test_journals_may_come_in_any_order_and_twice() -> None:
    """A recorder gets those of before when it has those of now already."""
    batches = journals([2, 3, 4, 5])
    inputs = list(read([*batches[2:], *batches[:3]]))
    assert inputs == [(Kind.SHUT_DOWN, place) for place in range(14)]


def test_a_log_tells_what_of_it_can_be_run_again() -> None:
    """Each run from its first input up to the first gap; a run without its beginning not at all."""
    whole, cut, late = journals([2, 3], run=1), journals([2, 3, 4, 5], run=2), journals([2, 3], run=3)
    assert reach([*whole[::-1], *cut[:2], cut[3], *late[1:]]) == {1: 5, 2: 5, 3: 0}
    with pytest.raises(JournalGapError, match="from its first input alone"):
        list(read(late[1:]))


def test_inputs_are_plain_message_pack() -> None:
    """Any language reads them: arrays of numbers, texts and bytes."""
    (journal,) = journals([1])
    assert msgspec.msgpack.decode(journal.inputs) == [[5, 0]]
