"""A log with holes and another recorder, without Zenoh: what is missing comes, once, and nothing else."""

import io
from collections.abc import Sequence
from functools import partial

from hypothesis import given
from hypothesis import strategies as st

from recorder.backfill import answers
from recorder.backfill.answers import Conversation, read_piece
from recorder.backfill.backfilling import fill_holes
from recorder.backfill.excerpt import PIECE_NAME, LoggedBytes
from recorder.backfill.filling import Filled, Filling
from recorder.backfill.questions import BackfillQuestion
from recorder.mcap.writer import McapFile
from schemas.recording import Backfill, BackfillPiece
from tests.support.backfill_logs import (
    CAMERA,
    GEAR,
    HEALTH,
    MS,
    RX,
    SECOND,
    START_NS,
    Recorder,
    Row,
    excerpt,
    found_in,
    gap_row,
    gear_rows,
    log_of,
    map_of,
    row,
)
from tests.support.logs import sealed


class Depot:
    """Logs with holes, which are filled by asking recorders."""

    def __init__(self, *own: Sequence[Row]) -> None:
        logs = [log_of(rows) for rows in own]
        finder = found_in(*logs)
        self.filling = Filling(finder.holes())
        for data in logs:
            self._hold(data)
        self._topics = finder.topics
        self.written: list[Row] = []
        self.senders: list[str] = []
        self.answered: list[str] = []
        self.details: list[str] = []

    def ask(self, **recorders: Recorder) -> list[Filled]:
        """Ask these, by name."""

        def ask(name: str, request: Backfill) -> list[BackfillPiece]:
            return list(recorders[name].ask(request))

        self.answered, self.details = fill_holes(
            self.filling,
            self._topics,
            list(recorders),
            ask,
            self._write,
            lambda: self._hold(log_of(self.written)),
            bool,
        )
        return self.filling.results()

    def _hold(self, data: bytes) -> None:
        chart = map_of(data)
        self.filling.hold(chart.channels, chart.messages(io.BytesIO(data)))

    def _write(self, message: LoggedBytes, recorder: str) -> None:
        self.senders.append(recorder)
        self.written.append(
            Row(message.publish_ns, message.channel.topic, message.sequence, message.log_ns, message.data)
        )


def robot_rows() -> list[Row]:
    """Some seconds of a robot: two topics, raw frames in batches of three, and a key that is none of ours."""
    rows = [row(number, number * 100, GEAR, b"g%d" % number) for number in range(120)]
    rows += [row(number // 3, number * 33 + 1, RX, b"f%d" % number) for number in range(360)]
    rows += [row(number, number * 1000 + 2, HEALTH) for number in range(12)]
    rows += [row(0, number * 1700 + 3, CAMERA, b"c%d" % number) for number in range(7)]
    return sorted(rows)


ROBOT_ROWS = robot_rows()


def late(rows: list[Row]) -> list[Row]:
    """The same messages, as a depot receives them: later, and by another clock."""
    return [Row(one.publish_ns, one.topic, one.sequence, one.log_ns + 7 * SECOND, one.data) for one in rows]


def sample(one: Row) -> tuple[str, int]:
    """Which sample a message is of: the frames of a batch come or go together."""
    return one.topic, one.sequence


SAMPLES = sorted({sample(one) for one in ROBOT_ROWS if one.topic != CAMERA})


@given(
    st.sets(st.sampled_from(SAMPLES), max_size=60), st.lists(st.integers(1, 40), max_size=3), st.integers(1, 50)
)
def test_exactly_what_is_missing_comes_back(
    lost: set[tuple[str, int]], pieces_lost: list[int], chunk_messages: int
) -> None:
    """With its times and sequences, no message twice, and whatever pieces get lost on the way."""
    own = [one for one in ROBOT_ROWS if sample(one) not in lost]
    # What is lost at either end of a topic shows in no sequence.
    inner = {
        topic: (min(seen), max(seen))
        for topic in (GEAR, RX, HEALTH)
        if (seen := [one.sequence for one in own if one.topic == topic])
    }
    expected = [
        one
        for one in ROBOT_ROWS
        if sample(one) in lost and one.topic in inner and inner[one.topic][0] < one.sequence < inner[one.topic][1]
    ]
    depot = Depot(late(own))
    results = depot.ask(robot=Recorder(log_of(ROBOT_ROWS, chunk_messages), lost=pieces_lost))
    assert sorted(depot.written) == expected
    assert sum(one.missing or 0 for one in results) == len({sample(one) for one in expected})
    assert all(one.is_whole for one in results)
    # And the log together with what came has no hole any more.
    assert found_in(log_of(late(own)), log_of(depot.written)).holes() == []


@given(st.integers(1000, 4_000), st.integers(2500, 6000))
def test_a_cut_is_filled_with_all_that_was_said(from_ms: int, length_ms: int) -> None:
    """Also with what has no sequence."""
    cut = START_NS + from_ms * MS, START_NS + (from_ms + length_ms) * MS
    own = [one for one in ROBOT_ROWS if not cut[0] <= one.publish_ns < cut[1]]
    # Batches that were cut in two came in part.
    depot = Depot(late(own))
    depot.ask(robot=Recorder(log_of(ROBOT_ROWS)))
    missing = [one for one in ROBOT_ROWS if one not in own]
    last = max(one.publish_ns for one in own if one.publish_ns < cut[0])
    first = min(one.publish_ns for one in own if one.publish_ns >= cut[1])
    assert all(last <= one.publish_ns <= first for one in missing)
    assert sorted(depot.written) == missing


def test_two_files_of_a_recording_are_filled_across_their_ends() -> None:
    """And a file that filled a hole before is not filled again."""
    middle = [one for one in ROBOT_ROWS if 4 <= (one.publish_ns - START_NS) / SECOND < 8]
    before = [one for one in ROBOT_ROWS if one < middle[0]]
    after = [one for one in ROBOT_ROWS if one > middle[-1]]
    depot = Depot(late(before), late(after))
    depot.ask(robot=Recorder(log_of(ROBOT_ROWS)))
    assert sorted(depot.written) == middle
    again = Depot(late(before), late(after), depot.written)
    assert again.ask(robot=Recorder(log_of(ROBOT_ROWS))) == []


def test_a_gateway_that_began_anew_in_the_cut_is_filled() -> None:
    """The end of the old one, and the beginning of the new one."""
    old, new = gear_rows(50), gear_rows(50, at_ms=6000)
    depot = Depot(old[:30] + new[20:])
    (result, silence) = depot.ask(robot=Recorder(log_of(old + new)))
    assert sorted(depot.written) == old[30:] + new[:20]
    assert (result.missing, result.filled, result.still_missing) == (None, 40, None)
    assert result.is_whole
    assert silence.is_whole


def test_what_nobody_has_is_missing_still() -> None:
    """The hole is answered, but not filled."""
    rows = gear_rows(50)
    depot = Depot(rows[:10] + rows[20:])
    (result,) = depot.ask(robot=Recorder(log_of(rows[:15] + rows[17:])))
    assert (result.missing, result.filled, result.still_missing, result.is_answered) == (10, 8, 2, True)
    assert not result.is_whole


def test_the_next_recorder_is_asked_for_what_the_first_one_lacks() -> None:
    """Neither brings twice what the other brought, and nobody is asked when nothing is missing any more."""
    rows = gear_rows(50)
    depot = Depot(rows[:10] + rows[20:])
    third = Recorder(log_of(rows))
    (result,) = depot.ask(one=Recorder(log_of(rows[:15])), two=Recorder(log_of(rows[12:])), three=third)
    assert sorted(depot.written) == rows[10:20]
    assert result.is_whole
    assert depot.answered == ["one", "two"]
    assert sorted(zip(depot.written, depot.senders, strict=True)) == [
        *((one, "one") for one in rows[10:15]),
        *((one, "two") for one in rows[15:20]),
    ]
    assert third.requests == []


def test_who_does_not_answer_is_not_asked_for_everything() -> None:
    """The holes are not answered; the next recorder may."""
    rows = [one for one in gear_rows(500, 5000) if one.sequence % 10]

    class Silent(Recorder):
        def ask(self, request: Backfill) -> list[BackfillPiece]:  # type: ignore[override] # nothing, as a list
            self.requests.append(request)
            return []

    silent = Silent()
    depot = Depot(rows)
    results = depot.ask(silent=silent)
    assert depot.answered == []
    assert not any(one.is_answered for one in results)
    assert len(silent.requests) == answers.TRIES
    assert all(one.is_whole for one in depot.ask(robot=Recorder(log_of(gear_rows(500, 5000)))))


def test_dropped_messages_of_keys_without_a_sequence_come_back() -> None:
    """By the times that the recorder told."""
    there = [row(0, number * 500, CAMERA, b"%d" % number) for number in range(60)]
    own = [one for number, one in enumerate(there) if not 20 <= number < 24]
    gap = gap_row(CAMERA, there[20].log_ns, there[23].log_ns, 4)
    depot = Depot([*own, gap])
    (result,) = depot.ask(robot=Recorder(log_of(there)))
    assert sorted(depot.written) == there[20:24]
    assert (result.missing, result.filled, result.still_missing) == (4, 4, 0)


def test_what_the_own_recorder_does_not_record_is_not_brought_by_a_cut() -> None:
    """A silence asks for everything; only what is recorded here is wanted."""
    own = [one for one in gear_rows(100) if not 30 <= one.sequence < 70]
    finder = found_in(log_of(own))
    filling = Filling(finder.holes(), lambda topic: topic == GEAR)
    taken = [
        one.topic
        for one in (row(40, 4000, GEAR), row(0, 4000, CAMERA))
        if filling.add(
            LoggedBytes(map_of(log_of([one])).channels[1], one.sequence, one.log_ns, one.publish_ns, b"")
        )
    ]
    assert taken == [GEAR]


def test_what_the_recorder_says_besides_is_told() -> None:
    """Once, and by whom."""
    data = bytearray(log_of(rows := gear_rows(50, 2000)))
    data[data.index(b"zstd") + 30] ^= 1
    depot = Depot([one for one in rows if one.sequence % 5])
    depot.ask(robot=Recorder(bytes(data)))
    assert depot.details == ["robot: 1 damaged places were skipped"]


def pieces_of(rows: list[Row]) -> list[BackfillPiece]:
    """An answer of one piece."""
    return excerpt([log_of(rows)])


@given(st.data())
def test_a_piece_that_was_changed_on_the_way_is_not_believed(data: st.DataObject) -> None:
    """Its bytes are untrusted: it is what was sent, or nothing."""
    (piece,) = pieces_of(gear_rows(20))
    mcap = bytearray(piece.mcap)
    place = data.draw(st.integers(0, len(mcap) - 1))
    mcap[place] ^= 1 << data.draw(st.integers(0, 7))
    changed = BackfillPiece(True, "", bytes(mcap), piece.messages, piece.next_ns, True)  # noqa: FBT003 - as it comes
    good = read_piece(piece, 0, START_NS)
    assert good is not None
    assert len(good) == 20
    assert read_piece(changed, 0, START_NS) in (None, good)


@given(st.binary(max_size=300))
def test_garbage_is_no_piece(garbage: bytes) -> None:
    """Never an exception."""
    for mcap in (garbage, b"\x89MCAP0\r\n" + garbage):
        piece = BackfillPiece(True, "", mcap, 1, START_NS, True)  # noqa: FBT003 - as it comes
        assert read_piece(piece, 0, START_NS) is None


def test_a_piece_of_another_place_is_none() -> None:
    """Of another number, or beginning elsewhere: one before it was lost."""
    (piece,) = pieces_of(gear_rows(20))
    assert read_piece(piece, 1, START_NS) is None
    assert read_piece(piece, 0, START_NS + 1) is None


def test_requests_grow_while_all_goes_well_and_shrink_when_pieces_are_lost() -> None:
    """A thin link is not asked for more than it carries."""
    rows = [row(number, number * 100, data=bytes(2000)) for number in range(5000)]
    question = BackfillQuestion(GEAR, START_NS, START_NS + 500 * SECOND)

    def sizes(recorder: Recorder) -> list[int]:
        messages = [one for answer in Conversation(recorder.ask, question).answers() for one in answer.messages]
        assert [one.sequence for one in messages] == list(range(5000))
        return [one.max_bytes for one in recorder.requests]

    assert sizes(Recorder(log_of(rows))) == [1_000_000, 2_000_000, 4_000_000, 8_000_000]
    lossy = sizes(Recorder(log_of(rows), lost=[2]))
    assert lossy[:3] == [1_000_000, 500_000, 1_000_000]


def test_an_answer_that_gets_no_further_ends() -> None:
    """After some tries; what came is kept."""
    rows = gear_rows(20)

    class Stuck(Recorder):
        def ask(self, request: Backfill) -> list[BackfillPiece]:  # type: ignore[override] # a list
            self.requests.append(request)
            return [BackfillPiece(True, "no time", b"", 0, request.from_ns, True)]  # noqa: FBT003 - as it comes

    stuck = Stuck(log_of(rows))
    conversation = Conversation(stuck.ask, BackfillQuestion(GEAR, START_NS, START_NS + SECOND))
    assert [answer.messages for answer in conversation.answers()] == [[]] * answers.TRIES
    assert not conversation.is_over
    assert conversation.details == ["no time"]


def _only(piece: BackfillPiece, _request: object) -> list[BackfillPiece]:
    return [piece]


def test_next_ns_that_goes_back_or_beyond_is_not_believed() -> None:
    """Nothing is taken for answered that was not asked for."""
    for next_ns in (START_NS - 1, START_NS + 2 * SECOND):
        piece = BackfillPiece(True, "", b"", 0, next_ns, True)  # noqa: FBT003 - as it comes
        question = BackfillQuestion(GEAR, START_NS, START_NS + SECOND)
        conversation = Conversation(partial(_only, piece), question)
        assert list(conversation.answers()) == []
        assert conversation.answered_ns == START_NS


def test_a_refusal_answers_nothing() -> None:
    """Whatever else it says."""
    piece = BackfillPiece(False, "busy", b"", 0, START_NS + SECOND, True)  # noqa: FBT003 - as it comes
    conversation = Conversation(lambda _: [piece], BackfillQuestion(GEAR, START_NS, START_NS + SECOND))
    assert list(conversation.answers()) == []
    assert (conversation.is_over, conversation.details) == (False, ["busy"])


def test_a_message_of_an_unknown_channel_makes_a_piece_none() -> None:
    """Nobody could tell what it is."""
    (piece,) = pieces_of([])  # an empty one, to begin with
    stream = io.BytesIO()
    file = McapFile(stream, "test")
    file.add_metadata(PIECE_NAME, {"number": "0", "from_ns": str(START_NS)})
    file.write_chunk(sealed([(9, 0, START_NS, START_NS, b"")]))
    file.finish()
    changed = BackfillPiece(True, "", stream.getvalue(), 1, piece.next_ns, True)  # noqa: FBT003 - as it comes
    assert read_piece(changed, 0, START_NS) is None


def test_a_stop_ends_the_questions() -> None:
    """At the next piece."""
    conversation = Conversation(
        Recorder(log_of(gear_rows(20))).ask, BackfillQuestion(GEAR, START_NS, START_NS + SECOND)
    )
    assert list(conversation.answers(lambda: True)) == []
