"""``cruiser review info``: show what logs hold."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import Final

import msgspec

from recorder.cli.asking import add_logs, add_robots, chosen_robots, end_with, find, in_short, progress_bar, table
from recorder.cli.show import show
from recorder.objects.address import StoreAddress
from recorder.reading.times import in_words
from recorder.record.accounting import KeyReport
from recorder.review.info import (
    LogBrief,
    LogInfo,
    LogSourceInfo,
    SetInfo,
    brief,
    read_info,
    total,
)
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review info logs/cruiser-1-20260102T030405Z.mcap\n  cruiser review info logs"
DESCRIPTION: Final = (
    "Show what logs hold: channels, rates, times, robots, versions, attachments, and the recorder's account of "
    "losses; for the logs of a directory one line each. Of a whole log only the end is read, of any other all "
    "records. 'check' verifies that it is true. Exit code 3 if a file is not whole, unless a recorder is writing "
    "it, or if it takes too long to read."
)

_LOSSES: Final = ("lost_source", "lost_link", "lost_queue", "lost_size", "lost_full", "lost_disk")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help="print a JSON object for each file, and for several files one for all at the end")
    add_robots(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    asked = find(arguments, settings, stopped)
    infos: list[LogInfo | LogBrief] = []
    unfinished: set[str] = set()
    with progress_bar("looking", asked.bytes, stopped, prints=True) as progress:
        for log in asked.logs:
            if stopped():
                break
            is_named = log.path in arguments.logs or StoreAddress(log.url) in arguments.logs
            try:
                info = msgspec.structs.replace(read_info(log.path, progress), path=log.name)
            except CommandError as error:
                asked.faults.add(str(error))
                continue
            infos.append(info if is_named else brief(info))
            if info.is_being_written and not info.faults:
                unfinished.add(info.path)
    if arguments.robot:
        wanted = chosen_robots(arguments.robot, {robot for info in infos for robot in info.robots})
        infos = [info for info in infos if wanted.intersection(info.robots)]
    answers: list[LogInfo | LogBrief | SetInfo] = [*infos]
    if len(infos) > 1:
        answers.append(total(infos))
    for answer in answers:
        show(answer, describe(answer), as_json=arguments.json)
    code = end_with(asked.faults)
    is_fine = all(info.whole or info.path in unfinished for info in infos)
    return code if is_fine else int(ExitCode.PARTIAL)


def describe(info: LogInfo | LogBrief | SetInfo) -> Iterator[str]:
    if isinstance(info, SetInfo):
        return _of_all(info)
    return _in_short(info) if isinstance(info, LogBrief) else _of_one(info)


def _in_short(info: LogBrief) -> Iterator[str]:
    period = "no time"
    if info.start_ns is not None:
        period = f"from {in_words(info.start_ns)}, {info.duration_s:.0f} s"
    lost = "losses unknown" if info.lost is None else f"{info.lost} lost"
    robots = f"robot {in_short(info.robots)}" if info.robots else "no robot"
    yield f"{info.path}: {_state(info)}, {robots}, {period}, {info.bytes} bytes, {info.messages} messages, {lost}"


def _state(info: LogInfo | LogBrief) -> str:
    return "whole" if info.whole else "being written" if info.is_being_written else "NOT WHOLE"


def _of_all(info: SetInfo) -> Iterator[str]:
    yield f"{info.files} files, {info.whole} of them whole, {info.bytes} bytes, {info.messages} messages"
    if info.start_ns is not None and info.end_ns is not None:
        yield f"  {in_words(info.start_ns)} to {in_words(info.end_ns)}, {info.duration_s:.3f} s"
    number = len(info.robots)
    yield f"  {number} robot{'s' * (number > 1)}: {in_short(info.robots)}" if number else "  no robot"


def _of_one(info: LogInfo) -> Iterator[str]:
    yield f"{info.path}: {_state(info)}, {info.bytes} bytes, {info.messages} messages"
    if info.source is LogSourceInfo.RECORDS:
        yield "  it has no summary at its end: read record by record"
    yield from (f"  fault: {fault}" for fault in info.faults)
    if info.fault_count > len(info.faults):
        yield f"  and {info.fault_count - len(info.faults)} more faults"
    if info.start_ns is not None and info.end_ns is not None:
        yield f"  {in_words(info.start_ns)} to {in_words(info.end_ns)}, {info.duration_s:.3f} s"
    yield from (f"  robot {robot}, variant {info.variants.get(robot, 'unknown')}" for robot in info.robots)
    yield from (f"  {key.replace('_', ' ')} {value}" for key, value in sorted(info.versions.items()))
    yield from table(
        ("channel", "schema", "messages", "rate/Hz"),
        [
            (
                channel.topic,
                channel.schema or channel.encoding,
                str(channel.messages),
                "-" if channel.rate_hz is None else f"{channel.rate_hz:.2f}",
            )
            for channel in info.channels
        ],
    )
    yield from table(
        ("attachment", "type", "bytes"), [(one.name, one.media_type, str(one.bytes)) for one in info.attachments]
    )
    yield from (f"  incident {one.get('file', '')}: {one.get('because', '')}" for one in info.incidents)
    yield from _completeness(info)


def _completeness(info: LogInfo) -> Iterator[str]:
    """The recorder's account of losses."""
    if not info.completeness:
        yield "  the recorder's account of losses is not in the log"
        return
    if info.is_cut:
        yield "  of the whole log, which this is a part of:"
    lost = {topic: one for topic, one in info.completeness.items() if one.lost or one.lost_bus or one.lost_source}
    if not lost:
        yield "  nothing lost, by the recorder's account"
    yield from table(
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
        [(topic, *_counts(one)) for topic, one in lost.items()],
        words=1,
    )


def _counts(one: KeyReport) -> list[str]:
    counts = [one.sent, one.received, one.written, one.lost_bus, *(getattr(one, name) for name in _LOSSES)]
    return ["-" if count is None else str(count) for count in counts]
