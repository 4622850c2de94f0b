"""Which messages are wanted."""

from recorder.backfill.excerpt import LoggedBytes
from recorder.backfill.filling import Filling
from recorder.backfill.holes import Hole, HoleKind
from recorder.backfill.questions import BackfillQuestion
from recorder.mcap.reader import LoggedMessage
from tests.support.backfill_logs import GEAR, ROBOT, RX, SECOND, channel_of

SHORT = Hole(GEAR, HoleKind.SEQUENCE, 0, 2 * SECOND, 1, (0, 0), (2, 2 * SECOND))
LONG = Hole(GEAR, HoleKind.SEQUENCE, 100 * SECOND, 150 * SECOND, 48, (10, 100 * SECOND), (59, 150 * SECOND))
CUT = Hole(f"{ROBOT}/**", HoleKind.SILENCE, 120 * SECOND, 130 * SECOND, None)


def message(at_s: float, sequence: int = 1, topic: str = GEAR, data: bytes = b"") -> LoggedBytes:
    """A message that was answered."""
    return LoggedBytes(channel_of(topic, 1), sequence, 7, round(at_s * SECOND), data)


def test_only_what_lies_in_a_hole_is_wanted() -> None:
    """Of its topic, from its first time to before its end; in a cut, of any."""
    filling = Filling([SHORT, LONG, CUT])
    taken = [at_s for at_s in (0, 1.9, 2, 50, 99.9, 100, 149.9, 150) if filling.add(message(at_s))]
    assert taken == [0, 1.9, 100, 149.9]
    assert [at_s for at_s in (1, 119, 120, 129, 130) if filling.add(message(at_s, topic=RX))] == [120, 129]
    assert [one.filled for one in filling.results()] == [2, 2, 2]
    assert (filling.asked, filling.written) == (13, 6)


def test_what_is_held_is_not_wanted() -> None:
    """By topic, sequence, time and data."""
    filling = Filling([SHORT])
    held = [LoggedMessage(1, 1, 99, SECOND, b"here"), LoggedMessage(1, 1, 99, 60 * SECOND, b"elsewhere")]
    filling.hold({1: channel_of(GEAR, 1)}, held)
    assert len(filling._held) == 1
    assert not filling.add(message(1, data=b"here"))
    assert filling.add(message(1, data=b"other"))
    assert filling.add(message(1, sequence=2, data=b"here"))
    assert filling.add(message(1.5, data=b"here"))


def test_what_comes_twice_is_wanted_once() -> None:
    """Until all of its time has been answered; no more is remembered."""
    filling = Filling([SHORT])
    assert filling.add(message(1))
    filling.settle(SECOND)
    assert not filling.add(message(1))
    filling.settle(SECOND + 1)
    assert not filling._recent


def test_a_hole_is_open_until_it_is_answered_and_nothing_is_known_to_be_missing() -> None:
    """What nobody could count is asked of every recorder."""
    filling = Filling([SHORT, LONG, CUT])
    assert filling.open_holes == [SHORT, LONG, CUT]
    filling.add(message(1))
    filling.give_up(BackfillQuestion(GEAR, 110 * SECOND, 111 * SECOND))
    filling.end_round()
    assert [one.is_answered for one in filling.results()] == [True, False, True]
    assert [one.is_whole for one in filling.results()] == [True, False, True]
    assert filling.open_holes == [LONG, CUT]
    filling.end_round()
    assert [one.is_answered for one in filling.results()] == [True, True, True]
    assert [one.is_whole for one in filling.results()] == [True, False, True]
