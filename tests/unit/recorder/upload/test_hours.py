"""Hours of the day."""

import pytest

from recorder.upload.hours import is_within


@pytest.mark.parametrize(
    ("hours", "inside", "outside"),
    [
        ("", ["00:00", "12:00", "23:59"], []),
        ("08:00-17:30", ["08:00", "17:29"], ["07:59", "17:30", "00:00"]),
        ("22:00-05:30", ["22:00", "23:59", "00:00", "05:29"], ["05:30", "21:59", "12:00"]),
        ("07:00-07:00", ["07:00", "06:59"], []),
    ],
)
def test_hours_may_go_over_midnight(hours: str, inside: list[str], outside: list[str]) -> None:
    """The first minute is within, the last one is not; from a time to the same is the whole day."""

    def minute(text: str) -> int:
        return int(text[:2]) * 60 + int(text[3:])

    assert [one for one in [*inside, *outside] if is_within(hours, minute(one))] == inside
