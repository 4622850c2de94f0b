"""``cruiser review``: questions to logs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from recorder.ports.leftovers import Outcome, Recovery, recover
from recorder.review.info import LogInfo, read_info
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review info logs/cruiser-1-20260102T030405Z.mcap"
RECOVER_EXAMPLE: Final = "  cruiser review recover logs/*.mcap.part"

_FINE: Final = {Outcome.WHOLE, Outcome.RECOVERED}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the questions and their flags."""
    questions = parser.add_subparsers(dest="question", required=True, metavar="QUESTION")
    info = questions.add_parser(
        "info",
        help="what a log holds, and what it lacks",
        description="What a log holds: channels, rates, robots, versions, attachments; what it lacks: samples "
        "missed by their sequence, raw frames lost by their alive counters, and whether the file is whole. "
        "Exit code 3 if a file is not.",
        epilog=f"example:\n{EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    recovery = questions.add_parser(
        "recover",
        help="make logs whole that their recorder could not finish",
        description="Makes logs whole, in place, that their recorder could not finish, and renames each "
        ".mcap.part .mcap. The next 'cruiser record' does the same in its directory. What is behind the last "
        "whole record is cut off; unless it is only the beginning of a write, it is kept beside as .mcap.rest. A "
        "log with damage before its end becomes .mcap.damaged, and what is good in it is copied. Exit code 3 if a "
        "file was damaged, 1 if nothing can be recovered.",
        epilog=f"example:\n{RECOVER_EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for question in (info, recovery):
        question.add_argument("files", nargs="+", type=Path, metavar="FILE")
        question.add_argument("--json", action="store_true", help="print a JSON object a line, one for each file")


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    """Answer."""
    if arguments.question == "recover":
        return _recover(arguments, stopped)
    return _inform(arguments, stopped)


def _inform(arguments: argparse.Namespace, stopped: Callable[[], bool]) -> int:
    """What can be read of a broken file is shown all the same."""
    shown, whole = 0, True
    failure: CommandError | None = None
    for path in arguments.files:
        if stopped():
            break
        try:
            info = read_info(path)
        except CommandError as error:
            if len(arguments.files) == 1:
                raise
            failure = error
            sys.stderr.write(f"cruiser review: {error}\n")
            continue
        shown += 1
        whole = whole and info.whole
        text = msgspec.json.encode(info).decode() if arguments.json else describe(info)
        sys.stdout.write(f"{text}\n")
    if failure is not None and not shown:
        return int(failure.code)
    return int(ExitCode.OK if whole and failure is None else ExitCode.PARTIAL)


def _recover(arguments: argparse.Namespace, stopped: Callable[[], bool]) -> int:
    library = f"cruiser-gateway {version('cruiser-gateway')}"
    outcomes: set[Outcome] = set()
    for path in arguments.files:
        if stopped():
            break
        recovery = recover(path, library)
        outcomes.add(recovery.outcome)
        text = msgspec.json.encode(recovery).decode() if arguments.json else describe_recovery(recovery)
        sys.stdout.write(f"{text}\n")
    if outcomes <= _FINE:
        return int(ExitCode.OK)
    return int(ExitCode.PARTIAL if outcomes & {*_FINE, Outcome.DAMAGED} else ExitCode.FAILURE)


def describe_recovery(recovery: Recovery) -> str:
    """What became of a log, for people."""
    if recovery.outcome in {Outcome.NOTHING, Outcome.BUSY, Outcome.FAILED}:
        lines = [f"{recovery.path}: not recovered: {recovery.detail or 'nothing in it can be read'}"]
    else:
        lines = [f"{recovery.result}: {recovery.outcome.value}, {recovery.messages} messages"]
    lines += [f"  fault: {fault}" for fault in recovery.faults]
    if recovery.fault_count > len(recovery.faults):
        lines.append(f"  and {recovery.fault_count - len(recovery.faults)} more faults")
    if recovery.kept is not None:
        lines.append(f"  the rest is kept in {recovery.kept}")
    return "\n".join(map(plain, lines))


def describe(info: LogInfo) -> str:
    """A log for people."""
    lines = [
        f"{info.path}: {'whole' if info.whole else 'NOT WHOLE'}, {info.bytes} bytes, {info.messages} messages",
        *(f"  fault: {fault}" for fault in info.faults),
    ]
    if info.fault_count > len(info.faults):
        lines.append(f"  and {info.fault_count - len(info.faults)} more faults")
    if info.start_ns is not None and info.end_ns is not None:
        lines.append(f"  {_time(info.start_ns)} to {_time(info.end_ns)}, {info.duration_s:.3f} s")
    lines += [f"  robot {robot}, variant {info.variants.get(robot, 'not told')}" for robot in info.robots]
    lines += [f"  {key.replace('_', ' ')} {value}" for key, value in sorted(info.versions.items())]
    lines += _table(
        ("channel", "schema", "messages", "rate/Hz", "missed"),
        [
            (
                channel.topic,
                channel.schema,
                str(channel.messages),
                "-" if channel.rate_hz is None else f"{channel.rate_hz:.2f}",
                "-" if channel.missed is None else str(channel.missed),
            )
            for channel in info.channels
        ],
    )
    lines += _table(
        ("raw frames", "identifier", "frames", "lost", "repeated", "corrupt", "outages", "unseen"),
        [
            (
                f"{one.topic} {one.name}",
                one.identifier,
                *map(str, (one.frames, one.lost, one.repeated, one.corrupt, one.outages, one.unseen)),
            )
            for one in info.frames
        ],
    )
    lines += _table(
        ("attachment", "type", "bytes"), [(one.name, one.media_type, str(one.bytes)) for one in info.attachments]
    )
    lines += _table(
        (
            "lost on the way",
            "sent",
            "received",
            "written",
            "bus",
            "source",
            "link",
            "queue",
            "size",
            "full",
            "disk",
        ),
        [
            (
                topic,
                "-" if one.sent is None else str(one.sent),
                str(one.received),
                str(one.written),
                "-" if one.lost_bus is None else str(one.lost_bus),
                *map(str, (one.lost_source, one.lost_link, one.lost_queue)),
                *map(str, (one.lost_size, one.lost_full, one.lost_disk)),
            )
            for topic, one in info.completeness.items()
            if one.lost or one.lost_bus or one.lost_source
        ],
        words=1,
    )
    lines += _table(
        ("not in the log", "why", "count", "from", "to"),
        [(one.topic, one.reason, str(one.count), _time(one.first_ns), _time(one.last_ns)) for one in info.gaps],
    )
    if info.incident:
        lines.append(f"  incident {info.incident.get('file', '')}: {info.incident.get('because', '')}")
    unseen = sum(one.unseen for one in info.frames)
    lines.append(
        f"  {info.missed} samples missed, {info.frames_lost} raw frames lost ({unseen} of them in outages)"
    )
    # A log's names come from anywhere, and may try to rule the terminal.
    return "\n".join(map(plain, lines))


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]], words: int = 2) -> list[str]:
    """Columns; the first ones are words and begin left, the others are numbers."""
    if not rows:
        return []
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    return [
        "  "
        + "  ".join(
            cell.ljust(width) if index < words else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (head, *rows)
    ]


def _time(time_ns: int) -> str:
    """A time for people; MCAP's times reach further than the calendar's."""
    try:
        whole = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC)
    except (ValueError, OverflowError, OSError):
        return f"{time_ns} ns"
    return f"{whole:%Y-%m-%d %H:%M:%S}.{time_ns % 1_000_000_000 // 1_000_000:03d} UTC"
