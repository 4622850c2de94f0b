"""The statements that a recorder wrote beside the messages: what the robots had shown before a file began."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mcap import records

from recorder.mcap.reader import read_pieces
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.record.statements import STATEMENTS_NAME
from recorder.review.verifying.authority import ShownStatement


def file_statements(logs: Sequence[LogFile], faults: Faults) -> Iterator[ShownStatement]:
    """Yield the statements in the metadata of logs; entries of another form are passed over.

    Args:
        logs: the files.
        faults: takes what cannot be read.
    """
    for log in logs:
        try:
            with log.open() as stream:
                pieces = read_pieces(stream, log.bytes, is_verifying=False)
                found = [
                    one.metadata
                    for one in pieces
                    if isinstance(one, records.Metadata) and one.name == STATEMENTS_NAME
                ]
        except OSError as error:
            faults.add(f"{log.path}: {error.strerror or error}")
            continue
        for entries in found:
            for name, text in entries.items():
                yield from _shown(name, text, log)


def _shown(name: str, text: str, log: LogFile) -> Iterator[ShownStatement]:
    robot, _, place = name.partition(" ")
    time_ns = place.partition(" ")[0]
    short = robot.rpartition("/")[2]
    if time_ns.isascii() and time_ns.isdecimal() and len(time_ns) < _DIGITS:
        yield ShownStatement(robot if short in log.namesakes else short, int(time_ns), text)


_DIGITS = 20
