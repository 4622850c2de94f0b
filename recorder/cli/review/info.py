"""``cruiser review info``: what a log holds, and what it lacks."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from recorder.cli.review.asking import table
from recorder.review.info import LogInfo, read_info
from recorder.review.times import in_words
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review info logs/cruiser-1-20260102T030405Z.mcap"
DESCRIPTION: Final = (
    "What a log holds: channels, rates, robots, versions, attachments; what it lacks: samples "
    "missed by their sequence, raw frames lost by their alive counters, and whether the file is whole. "
    "Exit code 3 if a file is not."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--json", action="store_true", help="print a JSON object a line, one for each file")


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
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


def describe(info: LogInfo) -> str:
    """A log for people."""
    lines = [
        f"{info.path}: {'whole' if info.whole else 'NOT WHOLE'}, {info.bytes} bytes, {info.messages} messages",
        *(f"  fault: {fault}" for fault in info.faults),
    ]
    if info.fault_count > len(info.faults):
        lines.append(f"  and {info.fault_count - len(info.faults)} more faults")
    if info.start_ns is not None and info.end_ns is not None:
        lines.append(f"  {in_words(info.start_ns)} to {in_words(info.end_ns)}, {info.duration_s:.3f} s")
    lines += [f"  robot {robot}, variant {info.variants.get(robot, 'not told')}" for robot in info.robots]
    lines += [f"  {key.replace('_', ' ')} {value}" for key, value in sorted(info.versions.items())]
    lines += table(
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
    lines += table(
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
    lines += table(
        ("attachment", "type", "bytes"), [(one.name, one.media_type, str(one.bytes)) for one in info.attachments]
    )
    lines += table(
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
    lines += table(
        ("not in the log", "why", "count", "from", "to"),
        [
            (one.topic, one.reason, str(one.count), in_words(one.first_ns), in_words(one.last_ns))
            for one in info.gaps
        ],
    )
    if info.incident:
        lines.append(f"  incident {info.incident.get('file', '')}: {info.incident.get('because', '')}")
    unseen = sum(one.unseen for one in info.frames)
    lines.append(
        f"  {info.missed} samples missed, {info.frames_lost} raw frames lost ({unseen} of them in outages)"
    )
    # A log's names come from anywhere, and may try to rule the terminal.
    return "\n".join(map(plain, lines))
