"""Hold to move: the motion that a terminal asks for, and the screen."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.cli.drive import (
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
"""Bytes of terminals; the last ones come unasked, and are no keys that drive."""


@given(spoken=st.lists(st.sampled_from(sorted(SPOKEN)), max_size=6), data=st.data())
def test_what_a_terminal_sends_is_understood_however_it_is_cut(spoken: list[bytes], data: st.DataObject) -> None:
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
    decoder = KeyDecoder()
    for piece in pieces:
        decoder.feed(piece)
        assert len(decoder._rest) < LONGEST


def test_what_begins_a_sequence_and_does_not_go_on_is_a_key() -> None:
    decoder = KeyDecoder()
    assert decoder.feed(b"\x1b") == []
    assert decoder.feed(b"") == [""]
    assert decoder.feed(b"") == []


HELD = [(0, ["w"]), (500, ["w"])]
BURST = ["w"] * BURST_STROKES
STALLED = [*HELD, *((at_ms, ["w"]) for at_ms in range(1200, 2600, 20))]
Reads = list[tuple[int, list[str]]]
TYPED: dict[str, tuple[Reads, int, Wish]] = {
    "a tap may be a mistake, and nobody would tell its end": ([(0, ["w"])], 0, NOTHING),
    "pasted text is read at one time": ([(0, ["w"] * 50)], 0, NOTHING),
    "no keyboard repeats as soon as two taps": ([(0, ["w"]), (149, ["w"])], 149, NOTHING),
    "what comes long after is a new stroke": ([(0, ["w"]), (801, ["w"])], 801, NOTHING),
    "a key that repeats": (HELD, 699, FORWARD),
    "and whose next repetition does not come in time": (HELD, 700, NOTHING),
    "or comes": ([*HELD, (590, ["w"]), (680, ["w"])], 879, FORWARD),
    "from straight on to a curve: the new key may be a tap": ([*HELD, (510, ["u"])], 510, NOTHING),
    "until it repeats itself": ([*HELD, (510, ["u"]), (800, ["u"])], 800, Wish(1, 1)),
    **{f"any other key stops, {key!r}": ([*HELD, (501, [key])], 501, NOTHING) for key in ("", "space", "h", "a")},
    "a burst after a stall was typed long ago": ([*HELD, (1200, BURST)], 1200, NOTHING),
    "so were pieces of one": ([*HELD, *((at_ms, ["w"] * 3) for at_ms in (1200, 1220, 1240))], 1240, NOTHING),
    "and strokes that go on as if it were held: nobody knows": (STALLED, 2580, NOTHING),
    "until it is let go, and pressed again": ([*STALLED, (3100, ["w"]), (3600, ["w"])], 3600, FORWARD),
    "some strokes of a burst are old, however short the pause": ([*HELD, (699, BURST)], 699, NOTHING),
}


@pytest.mark.parametrize("name", TYPED)
def test_the_motion_asked_for_is_that_of_the_held_key(name: str) -> None:
    """Reads have a time in ms and keys."""
    reads, at_ms, wish = TYPED[name]
    keys = HeldKeys()
    for read_ms, read in reads:
        keys.receive(read, START_NS + read_ms * MS)
    assert keys.wish(START_NS + at_ms * MS) == wish


@pytest.mark.parametrize(("key", "wish"), [*BINDINGS.items()])
def test_every_key_drives_by_itself_and_ends_as_soon(key: str, wish: Wish) -> None:
    keys = HeldKeys()
    keys.receive([key], START_NS)
    assert keys.wish(START_NS) == NOTHING
    last_ns = START_NS + 500 * MS
    keys.receive([key], last_ns)
    assert keys.wish(last_ns + REPEAT_NS - 1) == wish
    assert keys.wish(last_ns + REPEAT_NS) == NOTHING


def test_keys_that_do_not_drive_are_told() -> None:
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
    shown = drawn(panel(COCKPIT)).split("hold to move", 1)[1]
    letters = {word.strip(",;:") for word in shown.split() if len(word.strip(",;:")) == 1} - {"│", "╰", "a"}
    named = {key for key in BINDINGS if len(key) == 1} | OTHER_KEYS
    assert letters == named - {"a"}
    assert "a d steer" in shown
    assert "arrows" in shown
