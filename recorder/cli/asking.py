"""The common part of all questions: their logs, their time, and the progress bar."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Collection, Generator, Iterable, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from recorder.reading.logs import Faults, LogFile, find_logs
from recorder.reading.rows import END_OF_TIME_NS, Progress, Selection
from recorder.reading.times import FORMS, in_words, time_of
from schemas.command_line import CommandError, ExitCode, needing_extra, plain
from schemas.keys import in_order
from schemas.settings import Settings

if TYPE_CHECKING:
    from recorder.objects.address import StoreAddress

JSON_HELP: Final = "print JSON"

NAMES_SHOWN: Final = 12  # limit of robots that are named in a line
BUDGET_S: Final = 30.0  # time after which reading is given up
BUDGET_S_PER_BYTE: Final = 1e-6  # time added for each byte of the logs: a second per megabyte


LAST_NS: Final = 2**63 - 1  # the last time that fits into 64 bits with a sign; MCAP's times have no sign


class Asked(msgspec.Struct):
    """The subject of a question.

    Attributes:
        from_ns, to_ns: the log times from the first wanted one to the first one beyond.
    """

    logs: list[LogFile]
    faults: Faults
    start_ns: int
    end_ns: int
    from_ns: int
    to_ns: int

    @property
    def selection(self) -> Selection:
        return Selection(from_ns=self.from_ns, to_ns=self.to_ns)

    @property
    def bytes(self) -> int:
        return sum(log.bytes for log in self.logs)


def add_logs(parser: argparse.ArgumentParser, *, json_help: str = JSON_HELP) -> None:
    parser.add_argument(
        "logs",
        nargs="+",
        type=log_place,
        metavar="LOG",
        help="a file, or a directory of logs, here or in an object store (s3://BUCKET/PLACE, ...)",
    )
    parser.add_argument("--json", action="store_true", help=json_help)


def log_place(text: str) -> Path | StoreAddress:
    """A path, or an address in an object store."""
    if "://" in text:
        from recorder.objects.address import StoreAddress, is_address  # noqa: PLC0415 - only for an address

        if is_address(text):
            return StoreAddress(text)
    return Path(text)


def add_robots(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--robot",
        action="append",
        default=[],
        metavar="NAME",
        help="only this robot; * matches any letters; may be repeated",
    )


def chosen_robots(patterns: Sequence[str], robots: Collection[str]) -> frozenset[str]:
    """The robots that match one of the patterns. Raises CommandError if a pattern matches none."""
    for pattern in patterns:
        if not any(fnmatchcase(robot, pattern) for robot in robots):
            others = f", but of {in_short(sorted(robots, key=in_order))}" if robots else ""
            raise CommandError(f"the logs hold nothing of {plain(pattern)}{others}", ExitCode.USAGE)
    return frozenset(robot for robot in robots if any(fnmatchcase(robot, pattern) for pattern in patterns))


def in_short(names: Sequence[str]) -> str:
    """The first names, and the number of the others."""
    more = len(names) - NAMES_SHOWN
    return ", ".join(map(plain, names[:NAMES_SHOWN])) + (f" and {more} more" if more > 0 else "")


def add_period(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--from", dest="from_time", metavar="TIME", help=f"start at this time: {FORMS}")
    parser.add_argument("--to", dest="to_time", metavar="TIME", help="end before this time")


def find(
    arguments: argparse.Namespace,
    settings: Settings,
    stopped: Callable[[], bool],
    *,
    with_covered: bool = False,
) -> Asked:
    """Find the logs and the time of a question; with incidents that other logs cover, if wanted."""
    faults = Faults()
    paths = [one for one in arguments.logs if isinstance(one, Path)]
    if getattr(arguments, "ray", None):
        # Other machines have another working directory.
        paths = [path.absolute() for path in paths]
    addresses = [one for one in arguments.logs if not isinstance(one, Path)]
    if addresses and getattr(arguments, "ray", None):
        raise CommandError("--ray cannot read logs of an object store: copy them to a path that all machines see")
    stored: list[LogFile] = []
    if addresses:
        with needing_extra():
            from recorder.cli.stored import find_stored  # noqa: PLC0415 - it needs an extra
        bar = partial(progress_bar, "fetching", stopped=stopped, is_bounded=False)
        stored = find_stored(addresses, settings.upload, faults, bar)
    logs = find_logs(paths, faults, with_covered=with_covered, stored=stored)
    start_ns = min((log.start_ns for log in logs if log.end_ns), default=0)
    end_ns = max(log.end_ns for log in logs)
    late = [log.name for log in logs if log.end_ns > LAST_NS]
    if late:
        more = f" and {len(late) - 1} more" if len(late) > 1 else ""
        text = "holds log times after 2262-04-11, which no table can hold: they become that time"
        sys.stderr.write(f"cruiser review: {plain(late[0])}{more} {text}\n")
    begin, end = getattr(arguments, "from_time", None), getattr(arguments, "to_time", None)
    from_ns = 0 if begin is None else time_of(begin, start_ns, end_ns)
    to_ns = END_OF_TIME_NS if end is None else time_of(end, start_ns, end_ns)
    if from_ns >= to_ns:
        raise CommandError("there is no time between --from and --to", ExitCode.USAGE)
    if end_ns and (from_ns > end_ns or to_ns <= start_ns):
        period = f"{in_words(start_ns)} to {in_words(end_ns)}"
        raise CommandError(f"the logs hold nothing of that time: they cover {period}", ExitCode.USAGE)
    return Asked(logs, faults, start_ns, end_ns, from_ns, to_ns)


@contextmanager
def progress_bar(
    about: str,
    total_bytes: int,
    stopped: Callable[[], bool] = lambda: False,
    *,
    prints: bool = False,
    is_bounded: bool = True,
) -> Generator[Progress, None, None]:
    """Show a bar on stderr, if it is a terminal. Yields the function that takes the number of bytes read.

    ``prints``: no bar if the answer is printed to a terminal meanwhile. ``is_bounded``: raise CommandError if
    reading takes far too long, since a log can be made to cause that; not for SQL. Raises KeyboardInterrupt if
    it was stopped.
    """

    def stop(_count: int) -> None:
        if stopped():
            raise KeyboardInterrupt

    if not sys.stderr.isatty() or (prints and sys.stdout.isatty()):
        yield in_time(total_bytes, stop) if is_bounded else stop
        return
    from rich.console import Console  # noqa: PLC0415 - only where there is a terminal
    from rich.progress import BarColumn, DownloadColumn, TextColumn, TimeRemainingColumn  # noqa: PLC0415
    from rich.progress import Progress as Bar  # noqa: PLC0415

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    # stdout is left alone: it may be a file while stderr is a terminal.
    with Bar(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False) as bar:
        task = bar.add_task(about, total=total_bytes)

        def advance(count: int) -> None:
            stop(count)
            bar.advance(task, count)

        yield in_time(total_bytes, advance) if is_bounded else advance


def in_time(total_bytes: int, progress: Progress) -> Progress:
    """Limit the time of reading by the number of bytes: a log can be made to take forever."""
    budget_s = BUDGET_S + BUDGET_S_PER_BYTE * total_bytes
    end_s = time.monotonic() + budget_s

    def go_on(count: int) -> None:
        if time.monotonic() >= end_s:
            raise CommandError(
                f"given up after {budget_s:.0f} s, too long for {total_bytes} bytes: the answer is incomplete",
                ExitCode.PARTIAL,
            )
        progress(count)

    return go_on


def no_robot(faults: Faults) -> CommandError:
    """The error that logs hold nothing of a robot, after printing their faults."""
    code = end_with(faults)
    return CommandError("the log holds nothing of a robot", ExitCode(code or ExitCode.FAILURE))


def end_with(faults: Faults) -> int:
    """Print the faults on stderr. Returns the exit code."""
    for fault in faults.told:
        sys.stderr.write(f"cruiser review: {plain(fault)}\n")
    if faults.count > len(faults.told):
        sys.stderr.write(f"cruiser review: and {faults.count - len(faults.told)} more faults\n")
    return int(ExitCode.PARTIAL if faults else ExitCode.OK)


def worst(codes: Iterable[int]) -> int:
    """The worst exit code: a failure, then a partial answer."""
    return int(max(codes, key=(ExitCode.OK, ExitCode.PARTIAL, ExitCode.FAILURE).index))


def table(head: Sequence[str], rows: Sequence[Sequence[str]], words: int = 2) -> list[str]:
    """Columns as lines; the first ``words`` columns are left-aligned, the others right-aligned."""
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
