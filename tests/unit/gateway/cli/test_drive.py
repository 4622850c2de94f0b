"""Hold to move: the motion that a terminal asks for, and what a person sees."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.cli.drive import (
    BEGIN_MIN_NS,
    BEGIN_NS,
    BINDINGS,
    BURST_STROKES,
    LONGEST,
    NOTHING,
    REPEAT_NS,
    Cockpit,
    HeldKeys,
    KeyDecoder,
    Wish,
    panel,
)
from gateway.client.link import Sighting
from tests.unit.gateway.client.test_fleet import ENGAGED, drawn

START_NS = 10**12
MS = 1_000_000
FORWARD = Wish(1, 0)


SPOKEN = {
    b"w": "w",
    b"W": "w",
    b" ": "space",
    b"\x03": "ctrl-c",
    b"\x1a": "",
    b"\x1b[A": "up",
    b"\x1bOD": "left",
    b"\x1b[3~": "",
    b"\x1b[1;5A": "",
    b"\x1b[O": "",
    b"\x1b[119;1:1u": "",
}
"""What terminals send; with the last ones nothing was asked for, and they are no keys that drive."""


@given(spoken=st.lists(st.sampled_from(sorted(SPOKEN)), max_size=6), data=st.data())
def test_what_a_terminal_sends_is_understood_however_it_is_cut(spoken: list[bytes], data: st.DataObject) -> None:
    """Each sequence is one key, in order, in whatever pieces it is read."""
    stream = b"".join(spoken)
    decoder = KeyDecoder()
    keys: list[str] = []
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        keys += decoder.feed(stream[:cut])
        stream = stream[cut:]
    assert keys == [SPOKEN[one] for one in spoken]


@given(pieces=st.lists(st.binary(max_size=200)))
@example(pieces=[b"\x1b[" + b"1" * 100])
def test_no_bytes_make_the_decoder_raise(pieces: list[bytes]) -> None:
    """Whatever comes is keys, and little of it is kept."""
    decoder = KeyDecoder()
    for piece in pieces:
        decoder.feed(piece)
        assert len(decoder._rest) < LONGEST


def test_what_begins_a_sequence_and_does_not_go_on_is_a_key() -> None:
    """Escape alone stops."""
    decoder = KeyDecoder()
    assert decoder.feed(b"\x1b") == []
    assert decoder.feed(b"") == [""]
    assert decoder.feed(b"") == []


def repeating_w() -> HeldKeys:
    keys = HeldKeys()
    keys.receive(["w"], START_NS - 500 * MS)
    keys.receive(["w"], START_NS)
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
def test_strokes_that_are_no_repetition_move_nothing(reads: list[tuple[int, int]]) -> None:
    """Each read has a time and a number of strokes."""
    keys = HeldKeys()
    for after_ns, strokes in reads:
        keys.receive(["w"] * strokes, START_NS + after_ns)
        assert keys.wish(START_NS + after_ns) == NOTHING


def test_a_key_that_repeats_moves_until_shortly_after_its_last_repetition() -> None:
    """Motion ends when no repetition comes in time."""
    keys = repeating_w()
    for step in range(5):
        keys.receive(["w"], START_NS + step * 90 * MS)
    last_ns = START_NS + 4 * 90 * MS
    assert keys.wish(last_ns + REPEAT_NS - 1) == FORWARD
    assert keys.wish(last_ns + REPEAT_NS) == NOTHING


@pytest.mark.parametrize(("key", "wish"), [*BINDINGS.items()])
def test_every_key_drives_by_itself_and_ends_as_soon(key: str, wish: Wish) -> None:
    """Also one that asks for speed and angle: such a terminal repeats one key alone."""
    keys = HeldKeys()
    keys.receive([key], START_NS)
    assert keys.wish(START_NS) == NOTHING
    last_ns = START_NS + 500 * MS
    keys.receive([key], last_ns)
    assert keys.wish(last_ns + REPEAT_NS - 1) == wish
    assert keys.wish(last_ns + REPEAT_NS) == NOTHING


def test_another_key_stops_until_it_repeats_itself() -> None:
    """From straight on to a curve: what was held before says nothing of the new key, which may be a tap."""
    keys = repeating_w()
    keys.receive(["u"], START_NS + 10 * MS)
    assert keys.wish(START_NS + 10 * MS) == NOTHING
    keys.receive(["u"], START_NS + 300 * MS)
    assert keys.wish(START_NS + 300 * MS) == Wish(1, 1)


@pytest.mark.parametrize("key", ["", "space", "h", "a"])
def test_any_other_key_stops(key: str) -> None:
    """What was held must be pressed again."""
    keys = repeating_w()
    keys.receive([key], START_NS + MS)
    assert keys.wish(START_NS + MS) == NOTHING


@pytest.mark.parametrize("pieces", [[BURST_STROKES], [3, 3, 3], [1] * 20, [BURST_STROKES - 1, 1, 1]])
def test_strokes_of_before_a_stall_move_nothing(pieces: list[int]) -> None:
    """A link that stalls delivers at once what was typed long ago; then a key must be let go and pressed again."""
    keys = repeating_w()
    now_ns = START_NS + 700 * MS
    for strokes in pieces:
        keys.receive(["w"] * strokes, now_ns)
        assert keys.wish(now_ns) == NOTHING
        now_ns += 20 * MS
    # Still held, or so it seems: nobody knows whether these are of now.
    for _ in range(50):
        keys.receive(["w"], now_ns)
        assert keys.wish(now_ns) == NOTHING
        now_ns += 30 * MS
    keys.receive(["w"], now_ns + 500 * MS)
    keys.receive(["w"], now_ns + 1000 * MS)
    assert keys.wish(now_ns + 1000 * MS) == FORWARD


def test_a_burst_ends_motion() -> None:
    """Also where the pause before it was short: some of its strokes are old."""
    keys = repeating_w()
    keys.receive(["w"] * BURST_STROKES, START_NS + REPEAT_NS - 1)
    assert keys.wish(START_NS + REPEAT_NS - 1) == NOTHING


def test_keys_that_do_not_drive_are_told() -> None:
    """In their order."""
    assert HeldKeys().receive(["g", "w", "x"], START_NS) == ["g", "x"]


COCKPIT = Cockpit(
    robot="cruiser-1",
    lease=7,
    sighting=Sighting(state=ENGAGED, age_s=0.0, chassis=None),
    speed_mps=0.4,
    angle_deg=15.0,
    wish=NOTHING,
    message="",
)
OTHER_KEYS = {"+", "-", "g", "r", "x", "q"}  # what these do: tests/system/gateway/client/test_drive_by_keys.py


def test_the_keys_that_are_shown_exist_and_all_of_them_are_shown() -> None:
    """Whoever drives by what is shown is not surprised."""
    shown = drawn(panel(COCKPIT)).split("hold to move", 1)[1]
    letters = {word.strip(",;:") for word in shown.split() if len(word.strip(",;:")) == 1} - {"│", "╰", "a"}
    named = {key for key in BINDINGS if len(key) == 1} | OTHER_KEYS
    assert letters == named - {"a"}
    assert "a d steer" in shown
    assert "arrows" in shown
