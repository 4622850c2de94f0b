"""``cruiser review recover``: finish logs that their recorder could not finish."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final

from recorder.cli.show import show
from recorder.disk.keeper import Recovery, RecoveryOutcome, recover
from recorder.disk.log_names import PART_SUFFIX
from schemas.command_line import ExitCode, plain
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review recover logs\n  cruiser review recover logs/*.mcap.part"
DESCRIPTION: Final = (
    "Finishes logs in place that their recorder could not finish, and renames each .mcap.part to .mcap. The next "
    "'cruiser record' does the same in its directory. Bytes behind the last whole record are cut off, and saved "
    "beside the log as .mcap.rest unless they are only the beginning of a write. A log with damage before its end "
    "becomes .mcap.damaged, and its good data is copied. Exit code 3 if a file was damaged, 1 if nothing can be "
    "recovered."
)

_FINE: Final = {RecoveryOutcome.WHOLE, RecoveryOutcome.RECOVERED}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="LOG",
        help="a file, or a directory: its .mcap.part files",
    )
    parser.add_argument("--json", action="store_true", help="print a JSON object a line, one for each file")


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    library = f"cruiser-gateway {version('cruiser-gateway')}"
    outcomes: set[RecoveryOutcome] = set()
    for path in _leftovers(arguments.files):
        if stopped():
            break
        recovery = recover(path, library)
        outcomes.add(recovery.outcome)
        show(recovery, describe(recovery), as_json=arguments.json)
    if outcomes <= _FINE:
        return int(ExitCode.OK)
    return int(ExitCode.PARTIAL if outcomes & {*_FINE, RecoveryOutcome.DAMAGED} else ExitCode.FAILURE)


def _leftovers(paths: Sequence[Path]) -> Iterator[Path]:
    for path in paths:
        found = sorted(path.glob(f"[!.]*{PART_SUFFIX}")) if path.is_dir() else [path]
        if not found:
            sys.stderr.write(f"cruiser review: {plain(str(path))} holds no unfinished log\n")
        yield from found


def describe(recovery: Recovery) -> Iterator[str]:
    if recovery.outcome in {RecoveryOutcome.NOTHING, RecoveryOutcome.BUSY, RecoveryOutcome.FAILED}:
        yield f"{recovery.path}: not recovered: {recovery.detail or 'nothing in it can be read'}"
    else:
        yield f"{recovery.result}: {recovery.outcome.value}, {recovery.messages} messages"
    yield from (f"  fault: {fault}" for fault in recovery.faults)
    if recovery.fault_count > len(recovery.faults):
        yield f"  and {recovery.fault_count - len(recovery.faults)} more faults"
    if recovery.kept is not None:
        yield f"  the rest is in {recovery.kept}"
