"""``cruiser review check``: faults of log files, and losses of data."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from recorder.cli.asking import add_logs, end_with, find, progress_bar, table, worst
from recorder.cli.show import show
from recorder.reading.times import in_words
from recorder.review.flaws import About, Finding
from schemas.command_line import CommandError, ExitCode, needing_extra
from schemas.settings import Settings

if TYPE_CHECKING:
    from recorder.review.check import LogCheck
    from recorder.review.checking import Between, ChannelEnds

EXAMPLE: Final = "  cruiser review check logs\n  cruiser review check --json logs/cruiser-1-20260102T030405Z.mcap"
DESCRIPTION: Final = (
    "Reads every byte of logs and verifies checksums, the heads of chunks, indexes, statistics, the order of "
    "log times, schemas, and every message against its schema. Then looks for losses: samples by the gaps in "
    "their sequences, raw frames by their checksums and alive counters, and losses reported by the recorder. "
    "Each finding is about the file or about the data in it. For several logs, the last lines list samples "
    "missing in all of them. Exit code 1 if there is any finding, 3 if a file takes too long to read."
)
JSON_HELP: Final = "print a JSON object a line, one for each file, and one for samples missing in all of several"

TOPICS_SHOWN: Final = 3  # topics or frames named for one kind of finding; ``--json`` names all


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help=JSON_HELP)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    with needing_extra():
        from recorder.review.check import check_log  # noqa: PLC0415 - a robot has no numpy
        from recorder.review.checking import between  # noqa: PLC0415 - the same
    asked = find(arguments, settings, stopped, with_covered=True)
    is_sound = True
    ends: list[tuple[str, dict[str, ChannelEnds]]] = []
    with progress_bar("checking", asked.bytes, stopped, prints=True) as progress:
        for log in asked.logs:
            if stopped():
                break
            try:
                found = msgspec.structs.replace(check_log(log.path, progress), path=log.name)
            except CommandError as error:
                asked.faults.add(str(error))
                continue
            is_sound = is_sound and found.is_sound
            ends.append((found.path, {one.topic: one.ends for one in found.channels if one.ends}))
            show(found, describe(found), as_json=arguments.json)
    if len(ends) > 1:
        missing = between(ends)
        show({"between": missing}, _missing(missing), as_json=arguments.json)
    return worst([end_with(asked.faults), ExitCode.OK if is_sound else ExitCode.FAILURE])


def _missing(found: Sequence[Between]) -> Iterator[str]:
    """The samples missing in all logs, as lines for people."""
    yield f"between the logs:{'' if found else ' no loss detected'}"
    for one in found:
        place = f"between {in_words(one.from_ns)} and {in_words(one.to_ns)}"
        logs = f"{Path(one.before).name}, then {Path(one.after).name}"
        yield f"  {one.robot}: {one.samples} samples of {one.topics} keys {place} ({logs})"


def describe(found: LogCheck) -> Iterator[str]:
    """The findings about a log, as lines for people."""
    about_file = [one for one in found.findings if one.about is About.FILE]
    about_data = [one for one in found.findings if one.about is About.DATA]
    yield f"{found.path}: {found.messages} messages, {found.bytes} bytes"
    so_far = " so far, it is being written" if found.is_being_written else ""
    yield "  file:" if about_file else f"  file: no fault found{so_far}"
    yield from (f"    {_finding(one)}" for one in about_file)
    if found.untold:
        yield f"    and {found.untold} more"
    is_unknown = about_file and not found.messages
    state = "" if about_data else " unknown, no message could be read" if is_unknown else " no loss detected"
    yield f"  data:{state}"
    yield from (f"    {line}" for line in _alike(about_data))
    allowed = [one for one in found.findings if one.about is About.ALLOWED]
    if allowed:
        yield "  allowed, but worth knowing:"
    yield from (f"    {line}" for line in _alike(allowed))
    unread = [one.encoding or "no encoding" for one in found.channels if one.messages and not one.is_read]
    if unread:
        encodings = ", ".join(sorted(set(unread)))
        yield f"  not read: messages of {len(unread)} channels, without a known encoding or schema ({encodings})"
    yield from table(
        ("raw frames", "identifier", "frames", "lost", "repeated", "corrupt", "outages", "unseen"),
        [
            (
                f"{one.topic} {one.name}",
                one.identifier,
                *map(str, (one.frames, one.lost, one.repeated, one.corrupt, one.outages, one.unseen)),
            )
            for one in found.frames
        ],
    )


def _alike(findings: Sequence[Finding]) -> Iterator[str]:
    """Each kind of finding once: a stall affects every topic."""
    by_what: dict[str, list[Finding]] = {}
    for one in findings:
        # The names of raw frames come first.
        by_what.setdefault(one.what.rpartition(": ")[2], []).append(one)
    for what, found in by_what.items():
        if len(found) <= TOPICS_SHOWN:
            yield from map(_finding, found)
            continue
        first_ns = min((one.time_ns for one in found if one.time_ns is not None), default=None)
        where = "" if first_ns is None else f", first at {in_words(first_ns)}"
        names = (one.what.rpartition(": ")[0] or one.topic for one in found[:TOPICS_SHOWN])
        total = sum(one.count for one in found)
        yield f"{what} ({total}{where}): {', '.join(names)} and {len(found) - TOPICS_SHOWN} more"


def _finding(one: Finding) -> str:
    place = [f"byte {one.offset}"] if one.offset is not None else []
    place += [in_words(one.time_ns)] if one.time_ns is not None else []
    where = f", first at {' and '.join(place)}" if place else ""
    topic = f"{one.topic}: " if one.topic else ""
    return f"{topic}{one.what} ({one.count}{where})"
