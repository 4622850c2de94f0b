"""Hours of the day. Pure."""

from __future__ import annotations


def is_within(hours: str, minute: int) -> bool:
    """True if the minute of a day is within these hours, ``22:00-05:30``; each is, where none are given."""
    if not hours:
        return True
    start, end = (int(time[:2]) * 60 + int(time[3:]) for time in hours.split("-"))
    if start <= end:
        return start <= minute < end or start == end
    return minute >= start or minute < end
