import pytest

from gateway.cli.held_keys import (
    ANSWER_NS,
    BEGIN_MIN_NS,
    BEGIN_NS,
    BINDINGS,
    BURST_STROKES,
    NOTHING,
    REPEAT_NS,
    HeldKeys,
    Wish,
)
from gateway.cli.keyboard import Action, Flags, Focus, Heard, Stroke

START_NS = 10**12
MS = 1_000_000
FORWARD = Wish(1, 0)


def reporting_terminal() -> HeldKeys:
    """A terminal that tells releases."""
    keys = HeldKeys()
    keys.receive([Flags(reports_releases=True)], START_NS)
    return keys


def repeating_w() -> HeldKeys:
    """A terminal that tells no releases, in which w is held and has begun to repeat."""
    keys = HeldKeys()
    keys.receive([Stroke("w")], START_NS - 500 * MS)
    keys.receive([Stroke("w")], START_NS)
    return keys


@pytest.mark.parametrize(
    "reads",
    [
        pytest.param([(0, 1)], id="a tap may be a mistake, and nobody would tell its end"),
        pytest.param([(0, 50)], id="pasted text is read at one time"),
        pytest.param([(0, 1), (BEGIN_MIN_NS - 1, 1)], id="no keyboard repeats as soon as two taps"),
        pytest.param([(0, 1), (BEGIN_NS + 1, 1)], id="what comes long after is a new stroke"),
    ],
)
def test_without_releases_strokes_that_are_no_repetition_move_nothing(reads: list[tuple[int, int]]) -> None:
    """Each read has a time and a number of strokes."""
    keys = HeldKeys()
    for after_ns, strokes in reads:
        keys.receive([Stroke("w")] * strokes, START_NS + after_ns)
        assert keys.wish(START_NS + after_ns) == NOTHING


def test_a_key_that_repeats_moves_until_shortly_after_its_last_repetition() -> None:
    """Motion ends when no repetition comes in time."""
    keys = repeating_w()
    for step in range(5):
        keys.receive([Stroke("w")], START_NS + step * 90 * MS)
    last_ns = START_NS + 4 * 90 * MS
    assert keys.wish(last_ns + REPEAT_NS - 1) == FORWARD
    assert keys.wish(last_ns + REPEAT_NS) == NOTHING


@pytest.mark.parametrize(("key", "wish"), [*BINDINGS.items()])
def test_without_releases_every_key_drives_by_itself_and_ends_as_soon(key: str, wish: Wish) -> None:
    """Also one that asks for speed and angle: such a terminal repeats one key alone."""
    keys = HeldKeys()
    keys.receive([Stroke(key)], START_NS)
    assert keys.wish(START_NS) == NOTHING
    last_ns = START_NS + 500 * MS
    keys.receive([Stroke(key)], last_ns)
    assert keys.wish(last_ns + REPEAT_NS - 1) == wish
    assert keys.wish(last_ns + REPEAT_NS) == NOTHING


def test_every_curve_can_be_driven_with_one_key() -> None:
    """Forward and backward, to the left and to the right, and straight on."""
    one_key = set(BINDINGS.values())
    assert one_key >= {Wish(forward, left) for forward in (1, -1) for left in (1, 0, -1)}


def test_another_key_stops_until_it_repeats_itself() -> None:
    """From straight on to a curve: what was held before says nothing of the new key, which may be a tap."""
    keys = repeating_w()
    keys.receive([Stroke("u")], START_NS + 10 * MS)
    assert keys.wish(START_NS + 10 * MS) == NOTHING
    keys.receive([Stroke("u")], START_NS + 300 * MS)
    assert keys.wish(START_NS + 300 * MS) == Wish(1, 1)


@pytest.mark.parametrize("event", [Stroke(""), Stroke("space"), Stroke("h"), Stroke("a"), Focus(has=False)])
def test_any_other_key_and_the_loss_of_focus_stop(event: Heard) -> None:
    """In either kind of terminal; what was held must be pressed again."""
    keys = repeating_w()
    keys.receive([event], START_NS + MS)
    assert keys.wish(START_NS + MS).forward == 0
    reporting = reporting_terminal()
    reporting.receive([Stroke("w")], START_NS)
    reporting.receive([event], START_NS)
    reporting.receive([Stroke("w", Action.REPEAT)], START_NS)
    held_together = isinstance(event, Stroke) and event.key in BINDINGS
    assert reporting.wish(START_NS).forward == (1 if held_together else 0)


@pytest.mark.parametrize("pieces", [[BURST_STROKES], [3, 3, 3], [1] * 20, [BURST_STROKES - 1, 1, 1]])
def test_strokes_of_before_a_stall_move_nothing(pieces: list[int]) -> None:
    """A link that stalls delivers at once what was typed long ago; then a key must be let go and pressed again."""
    keys = repeating_w()
    now_ns = START_NS + 700 * MS
    for strokes in pieces:
        keys.receive([Stroke("w")] * strokes, now_ns)
        assert keys.wish(now_ns) == NOTHING
        now_ns += 20 * MS
    # Still held, or so it seems: nobody knows whether these are of now.
    for _ in range(50):
        keys.receive([Stroke("w")], now_ns)
        assert keys.wish(now_ns) == NOTHING
        now_ns += 30 * MS
    keys.receive([Stroke("w")], now_ns + 500 * MS)
    keys.receive([Stroke("w")], now_ns + 1000 * MS)
    assert keys.wish(now_ns + 1000 * MS) == FORWARD


def test_a_burst_ends_motion() -> None:
    """Also where the pause before it was short: some of its strokes are old."""
    keys = repeating_w()
    keys.receive([Stroke("w")] * BURST_STROKES, START_NS + REPEAT_NS - 1)
    assert keys.wish(START_NS + REPEAT_NS - 1) == NOTHING


def test_with_releases_a_key_moves_at_once_and_stops_on_its_release() -> None:
    """Press and release are told."""
    keys = reporting_terminal()
    keys.receive([Stroke("w")], START_NS)
    assert keys.wish(START_NS) == FORWARD
    keys.receive([Stroke("w", Action.RELEASE)], START_NS)
    assert keys.wish(START_NS) == NOTHING


def test_with_releases_keys_are_held_together() -> None:
    """Forward and left is both; forward and backward is neither."""
    keys = reporting_terminal()
    keys.receive([Stroke("up"), Stroke("a")], START_NS)
    assert keys.wish(START_NS) == Wish(1, 1)
    keys.receive([Stroke("s")], START_NS)
    assert keys.wish(START_NS) == Wish(0, 1)


def test_a_terminal_that_does_not_answer_is_not_believed() -> None:
    """Held keys count only while it answers: its link may be dead. They do not come back with it."""
    keys = reporting_terminal()
    keys.receive([Stroke("w")], START_NS)
    assert keys.wish(START_NS + ANSWER_NS) == FORWARD
    assert keys.wish(START_NS + ANSWER_NS + 1) == NOTHING
    keys.receive([Flags(reports_releases=True), Stroke("w", Action.REPEAT)], START_NS + ANSWER_NS + 2)
    assert keys.wish(START_NS + ANSWER_NS + 2) == NOTHING


def test_a_terminal_that_ceases_to_tell_releases_releases_all() -> None:
    """As when another terminal takes over the session."""
    keys = reporting_terminal()
    keys.receive([Stroke("w")], START_NS)
    keys.receive([Flags(reports_releases=False)], START_NS)
    assert keys.wish(START_NS) == NOTHING


def test_other_keys_are_told_once() -> None:
    """Their presses are, their repetitions and releases are not."""
    keys = reporting_terminal()
    events = [Stroke("g"), Stroke("g", Action.REPEAT), Stroke("g", Action.RELEASE), Stroke("w"), Stroke("x")]
    assert keys.receive(events, START_NS) == ["g", "x"]
