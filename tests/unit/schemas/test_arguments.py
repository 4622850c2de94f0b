import argparse

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.arguments import add_zenoh_arguments, ending_after, seconds


@given(value=st.floats(min_value=1e-9, max_value=1e9))
def test_a_number_above_0_is_a_duration(value: float) -> None:
    """Any number of seconds above 0 is taken as it is."""
    assert seconds(repr(value)) == value


@pytest.mark.parametrize("text", ["", "0", "-1", "nan", "inf", "1e999", "soon"])
def test_anything_else_is_not(text: str) -> None:
    """Zero, less than zero, infinity and words are refused."""
    with pytest.raises(argparse.ArgumentTypeError, match="seconds above 0"):
        seconds(text)


def test_flags_set_the_settings_that_they_name() -> None:
    """--connect may be repeated, and each flag's name is the setting's dotted key."""
    parser = argparse.ArgumentParser()
    add_zenoh_arguments(parser)
    assert vars(parser.parse_args(["--connect", "a", "--connect", "b", "--root", "lab"])) == {
        "zenoh.connect": ["a", "b"],
        "zenoh.config": None,
        "robot.root": "lab",
    }


def test_an_end_comes_with_the_signal_or_with_the_time() -> None:
    """Whichever is first; without a duration only the signal counts."""
    now_s, signalled = [100.0], [False]
    ends = ending_after(lambda: signalled[0], 5.0, lambda: now_s[0])
    for_ever = ending_after(lambda: signalled[0], None, lambda: now_s[0])
    assert not ends()
    now_s[0] = 104.9
    assert not ends()
    now_s[0] = 105.0
    assert ends()
    assert not for_ever()
    signalled[0] = True
    assert for_ever()
