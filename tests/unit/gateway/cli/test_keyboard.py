import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.cli.keyboard import Action, Flags, Focus, Heard, KeyDecoder, Stroke

SPOKEN: dict[bytes, Heard] = {
    b"w": Stroke("w"),
    b"W": Stroke("w"),
    b" ": Stroke("space"),
    b"\x03": Stroke("ctrl-c"),
    b"\x1a": Stroke(""),
    b"\x1b[A": Stroke("up"),
    b"\x1bOD": Stroke("left"),
    b"\x1b[3~": Stroke(""),
    b"\x1b[1;5A": Stroke(""),
    b"\x1b[I": Focus(has=True),
    b"\x1b[O": Focus(has=False),
    b"\x1b[?11u": Flags(reports_releases=True),
    b"\x1b[?15u": Flags(reports_releases=True),
    b"\x1b[?3u": Flags(reports_releases=False),
    b"\x1b[119u": Stroke("w"),
    b"\x1b[119;1:1u": Stroke("w"),
    b"\x1b[119:87;2:1u": Stroke("w"),
    b"\x1b[119;1:2u": Stroke("w", Action.REPEAT),
    b"\x1b[119;65:3u": Stroke("w", Action.RELEASE),
    b"\x1b[119;5:1u": Stroke(""),
    b"\x1b[99;5u": Stroke("ctrl-c"),
    b"\x1b[99;5:3u": Stroke("ctrl-c", Action.RELEASE),
    b"\x1b[32u": Stroke("space"),
    b"\x1b[1;1:3B": Stroke("down", Action.RELEASE),
    b"\x1b[57441;2u": Stroke(""),
    b"\x1b[3u": Stroke(""),
}
"""What terminals send: plain ones, the kitty protocol, focus reports."""


@given(spoken=st.lists(st.sampled_from(sorted(SPOKEN)), max_size=6), data=st.data())
def test_what_a_terminal_sends_is_understood_however_it_is_cut(spoken: list[bytes], data: st.DataObject) -> None:
    """Each sequence is one event, in order, in whatever pieces it is read."""
    stream = b"".join(spoken)
    decoder = KeyDecoder()
    events: list[Heard] = []
    while stream:
        cut = data.draw(st.integers(1, len(stream)))
        events += decoder.feed(stream[:cut])
        stream = stream[cut:]
    assert events == [SPOKEN[one] for one in spoken]


@given(pieces=st.lists(st.binary(max_size=200)))
@example(pieces=[b"\x1b[" + b"1" * 100])
def test_no_bytes_make_the_decoder_raise(pieces: list[bytes]) -> None:
    """Whatever comes is keys, and little of it is kept."""
    decoder = KeyDecoder()
    for piece in pieces:
        for event in decoder.feed(piece):
            assert isinstance(event, Stroke | Focus | Flags)
        assert len(decoder._rest) < 64


@pytest.mark.parametrize("begun", [b"\x1b", b"\x1b[", b"\x1b[1;", b"\x1bO"])
def test_a_sequence_that_does_not_end_is_some_key(begun: bytes) -> None:
    """Escape alone is a key, so it means to stand like every other that is not known."""
    decoder = KeyDecoder()
    assert decoder.feed(begun) == []
    assert decoder.settle() == [Stroke("")]
    assert decoder.settle() == []
    assert decoder.feed(b"w") == [Stroke("w")]


def test_a_letter_beyond_ascii_is_some_key() -> None:
    """Each of its bytes is a key that is not known."""
    assert set(KeyDecoder().feed("ß".encode())) == {Stroke("")}
