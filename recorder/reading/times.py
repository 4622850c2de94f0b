"""Times as people write and read them; in a log they are nanoseconds since 1970."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from typing import Final

from schemas.command_line import CommandError, ExitCode

FORMS: Final = (
    "seconds since the log's beginning (12.5) or before its end (-12.5), a time of day in UTC (03:04:05.678), "
    "or both date and time (2026-01-02T03:04:05.678Z)"
)
"""The forms of a time that ``time_of`` accepts."""

_NS_PER_S: Final = 1_000_000_000
_SECONDS: Final = re.compile(r"([+-]?)(\d+)(?:\.(\d{1,9}))?(?: ?s)?")
_DAY_TIME: Final = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)(?::([0-5]\d)(?:\.(\d{1,9}))?)?Z?")
_DATE: Final = re.compile(r"(\d{4}-[^.]*)(?:\.(\d{1,9}))?([+-]\d\d:?\d\d|Z)?")


def time_of(text: str, start_ns: int, end_ns: int) -> int:
    """A time in a log, written in one of FORMS.

    A time of day is the first one after the log's start, if the log reaches that far; else that of its first day.
    """
    text = text.removesuffix(" UTC")  # as the commands print it
    if match := _SECONDS.fullmatch(text):
        sign, whole, part = match.groups()
        offset_ns = int(whole) * _NS_PER_S + _fraction_ns(part)
        return end_ns - offset_ns if sign == "-" else start_ns + offset_ns
    if match := _DAY_TIME.fullmatch(text):
        hours, minutes, seconds, part = match.groups()
        since_midnight_ns = (int(hours) * 3600 + int(minutes) * 60 + int(seconds or 0)) * _NS_PER_S
        day_ns = 24 * 3600 * _NS_PER_S
        time_ns = start_ns - start_ns % day_ns + since_midnight_ns + _fraction_ns(part)
        is_tomorrow = time_ns < start_ns and time_ns + day_ns <= end_ns
        return time_ns + day_ns if is_tomorrow else time_ns
    moment_ns = date_of(text)
    if moment_ns is None:
        raise CommandError(f"{text!r} is no time: give {FORMS}", ExitCode.USAGE)
    return moment_ns


def date_of(text: str) -> int | None:
    """A date, or date and time, by default in UTC; None if it is neither."""
    match = _DATE.fullmatch(text)
    if match is None:
        return None
    # datetime has no nanoseconds.
    date, fraction, zone = match.groups()
    try:
        moment = datetime.fromisoformat(date + (zone or ""))
    except ValueError:
        return None
    moment = moment.replace(tzinfo=moment.tzinfo or UTC)
    whole_s = (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1)
    return whole_s * _NS_PER_S + _fraction_ns(fraction)


def _fraction_ns(digits: str | None) -> int:
    return int((digits or "0").ljust(9, "0")[:9])


def in_words(time_ns: int) -> str:
    """A time in words; in nanoseconds if it is beyond the calendar."""
    try:
        whole = datetime.fromtimestamp(time_ns // _NS_PER_S, UTC)
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"
    return f"{whole:%Y-%m-%d %H:%M:%S}.{time_ns % _NS_PER_S // 1_000_000:03d} UTC"
