"""Times as people write and read them."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.reading.times import in_words, time_of
from schemas.command_line import CommandError, ExitCode
from tests.support.messages import MS, SECOND

DAY = 24 * 3600 * SECOND
START = 20_000 * DAY + 23 * 3600 * SECOND
"""Eleven at night, on 2024-10-04."""
END = START + 2 * 3600 * SECOND


@pytest.mark.parametrize(
    ("text", "time_ns"),
    [
        ("0", START),
        ("12.5", START + 12_500 * MS),
        ("+12.5", START + 12_500 * MS),
        ("90s", START + 90 * SECOND),
        ("96.107 s", START + 96_107 * MS),
        ("-96.107 s", END - 96_107 * MS),
        ("0.000000001", START + 1),
        ("-12.5", END - 12_500 * MS),
        ("-12.5s", END - 12_500 * MS),
        ("23:04:05.678", START + 245_678 * MS),
        ("23:04", START + 240 * SECOND),
        ("23:00:00", START),
        ("00:30:00Z", START + 5400 * SECOND),
        ("1:00", START + 7200 * SECOND),
        ("22:59:59", START - SECOND),
        ("2024-10-04T23:00:01Z", START + SECOND),
        ("2024-10-04T23:00:01.000000002Z", START + SECOND + 2),
        ("2024-10-04 23:00:01", START + SECOND),
        ("2024-10-05T01:00:01+02:00", START + SECOND),
        ("2024-10-05T01:00:01.25+02:00", START + 1250 * MS),
        ("2024-10-05", START + 3600 * SECOND),
        ("1969-12-31T23:59:59Z", -SECOND),
    ],
)
def test_every_form_of_a_time_is_understood(text: str, time_ns: int) -> None:
    """Seconds from either end, a time of day (the first after the beginning that is in the log), date and time."""
    assert time_of(text, START, END) == time_ns


@pytest.mark.parametrize(
    "text", ["", "soon", "25:00:00", "12:61", "1.0000000001", "1  s", "2024-13-01", "--5", "9" * 5000 + "-01"]
)
def test_what_is_no_time_is_a_wrong_usage(text: str) -> None:
    with pytest.raises(CommandError, match="is no time: give seconds since") as caught:
        time_of(text, START, END)
    assert caught.value.code == ExitCode.USAGE


@given(st.text(max_size=30))
def test_no_text_raises_anything_else(text: str) -> None:
    with suppress(CommandError):
        time_of(text, START, END)


@given(st.integers(0, 2**62))
def test_what_is_told_can_be_asked_for(time_ns: int) -> None:
    words = in_words(time_ns).removesuffix(" UTC")
    assert time_of(words, START, END) == time_ns - time_ns % MS


@pytest.mark.parametrize("time_ns", [2**64 - 1, 2**63, -(2**62) * 4])
def test_times_beyond_the_calendar_are_numbers(time_ns: int) -> None:
    assert in_words(time_ns) == f"{time_ns} ns" or in_words(time_ns).endswith("UTC")
    assert in_words(2**70) == f"{2**70} ns"
