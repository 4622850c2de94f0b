"""Text from elsewhere, in a line."""

from hypothesis import given
from hypothesis import strategies as st

from schemas.command_line import LINE_LENGTH, plain, short


@given(st.text())
def test_whatever_comes_is_printable(text: str) -> None:
    """It breaks neither line nor terminal; what can be printed stays as it is."""
    assert plain(text).isprintable()
    assert (plain(text) == text) == text.isprintable()


@given(st.integers(0, 2 * LINE_LENGTH))
def test_a_text_that_is_too_long_for_a_line_is_cut(length: int) -> None:
    """And that can be seen."""
    text = "x" * length
    assert len(short(text)) <= LINE_LENGTH
    assert short(text) == text if length <= LINE_LENGTH else short(text).endswith("x...")
