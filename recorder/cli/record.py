"""``cruiser record``: record Zenoh samples in MCAP logs."""

from __future__ import annotations

import argparse
import gc
import os
import re
import resource
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Final

import msgspec

from recorder.cli import remote
from recorder.cli.remote import check_recording
from recorder.disk.files import LogDirectory
from recorder.disk.keeper import DiskKeeper, LeftoverThread
from recorder.disk.log_writer import QUEUE_BYTES, LogWriter
from recorder.loop import Recorded, RecorderLoop
from recorder.record.recorder import HealthReport, Recorder, RecorderPlan, SampleInbox
from recorder.record.retention import DiskLimits
from recorder.record.robot_log import LogPlan
from recorder.zenoh.remote_control import RemoteControl, host_name
from recorder.zenoh.source import RING_SAMPLE_BYTES, ShardedSource, ZenohSource, shard_of
from schemas import keys
from schemas.arguments import add_zenoh_arguments, ending_after, seconds
from schemas.command_line import CommandError, ExitCode, installed_version
from schemas.decisions import EventKind
from schemas.settings import ROBOT_LIMIT, AuthoritySettings, Settings

if TYPE_CHECKING:
    from recorder.record.signed_mode import LogSigner, StatementProofs


def own_name(settings: Settings) -> str:
    """The configured name; else that of the recorder's grant, in signed mode; else the host's."""
    name = settings.recorder.name
    if not name and settings.authority.mode == "signed":
        from schemas.authority.key_files import directory_of, granted_name  # noqa: PLC0415 - open mode does without

        name = granted_name(directory_of(settings.authority), "recorder")
    return name or host_name()


EXAMPLE: Final = "  cruiser record -k 'fleet/cruiser-1/**' -o logs"

LEFTOVERS_S: Final = 5.0  # at the end, longest wait for the recovery of leftovers; the next start resumes it
FLEET_NAME: Final = "fleet"  # begins the name of a log of several robots, or of other keys
IDLE_NS: Final = 600_000_000_000  # a log without samples for ten minutes is ended

SHARD_LEASE_MS: Final = 5000
"""Default lease of a shard's links: a router that accepts a thousand robots does not respond for seconds, and
broken links would add to its load."""

COLLECT_AFTER: Final = (100_000, 50, 100)  # garbage collector's thresholds: samples make no reference cycles
FILES_APART: Final = 100  # files and links that may be open besides the logs
CHUNK_MIN_BYTES: Final = 16_384  # smallest chunk size for small files
BUDGET_FILES: Final = 20  # a file is ended at 1/20 of the budget
BUDGET_RINGS: Final = 4  # the rings for incidents take at most 1/4 of the budget: an incident begins with all


def add_arguments(parser: argparse.ArgumentParser) -> None:
    # It runs for hours, and its log should show links come and go.
    parser.set_defaults(log_level="info")
    parser.add_argument(
        "-k",
        "--key",
        dest="recorder.keys",
        metavar="KEY",
        nargs="+",
        action="extend",
        help="key expressions to record (default: all keys under the root)",
    )
    parser.add_argument(
        "-o", "--out", dest="recorder.directory", metavar="DIR", help="directory of the logs (default .)"
    )
    parser.add_argument(
        "--name",
        dest="recorder.name",
        metavar="NAME",
        help="the recorder's name (default: its grant's, else the host's)",
    )
    parser.add_argument(
        "--shard",
        dest="recorder.shard",
        metavar="I/N",
        help="record the I-th part of the robots, by their names; N recorders record all (default: all)",
    )
    add_zenoh_arguments(parser)
    parser.add_argument("--seconds", type=seconds, metavar="N", help="duration (default: until Ctrl-C or SIGTERM)")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    _add_actions(parser)
    # After the actions, whose usage would begin with it. The default would not show that an action is optional.
    parser.usage = f"{parser.prog} [options]\n       {parser.prog} [options] ACTION ..."


def _add_actions(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(
        dest="action", metavar="ACTION", title="requests to a running recorder, here or on another computer"
    )
    for action, about in remote.ABOUT.items():
        one = actions.add_parser(
            action,
            help=about,
            description=f"{about[0].upper()}{about[1:]}.",
            # Keep the flags before the action.
            argument_default=argparse.SUPPRESS,
        )
        remote.add_arguments(one, action)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Record until stopped, and print the log's path; or send a request to a running recorder."""
    if arguments.action is None:
        return _record(arguments, settings, stopped)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        # These commands end at a hangup, except under nohup.
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    return remote.run(arguments, settings, stopped)


def _record(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    # First of all: a service may send it as soon as the process exists.
    rolls = hangups()
    named = msgspec.structs.replace(settings.recorder, name=own_name(settings))
    settings = with_shard_lease(msgspec.structs.replace(settings, recorder=named))
    recorder, root = settings.recorder, settings.robot.root
    expressions = recorder.keys or [f"{root}/**"]
    check_recording(settings.zenoh, expressions)
    release = installed_version("cruiser-gateway")
    library = f"cruiser-gateway {release}"
    path = Path(recorder.directory)
    log_limit = allow_many_files()
    collect_seldom()
    signer = signer_of(settings.authority)
    directory = LogDirectory(path, signer)
    with ExitStack() as stack:
        source = stack.enter_context(closing(_source(settings, expressions)))
        control = stack.enter_context(closing(RemoteControl(settings)))
        writer = LogWriter(directory, library, QUEUE_BYTES + recorder.incident_ring_bytes)
        known = known_robots(settings, expressions)
        limits = DiskLimits(
            recorder.budget_bytes, recorder.floor_bytes, known, recorder.keep_s, recorder.keep_incidents_s
        )
        keeper = stack.enter_context(closing(DiskKeeper(path, limits, lambda: writer.parts)))
        sys.stderr.write(
            f"record: waiting for samples of {', '.join(expressions)} into {recorder.directory}; "
            f"listens on {', '.join([*source.listen, *control.listen]) or 'nothing'}\n"
        )
        leftovers = LeftoverThread(path, library, signer)
        plan = recorder_plan(settings, control.name, expressions, release)
        loop = RecorderLoop(
            Recorder(msgspec.structs.replace(plan, log_limit=log_limit)),
            source,
            writer,
            SampleInbox(recorder.queue_bytes),
            HealthReport(control.name, release, time.monotonic_ns()),
            keeper,
            leftovers,
        )
        loop.attach(control)
        recorded = loop.run(ending_after(stopped, arguments.seconds, time.monotonic), rolls)
    leftovers.wait(LEFTOVERS_S)
    if not recorded.is_hung:
        # Only now: files left by a fault may have been recovered since.
        recorded = msgspec.structs.replace(recorded, unfinished=writer.unfinished)
    code = _report(recorded, as_json=arguments.json)
    if recorded.is_hung:
        # Threads that wait for the disk would keep the process alive.
        sys.stdout.flush()
        os._exit(code)
    return code


def signer_of(settings: AuthoritySettings) -> LogSigner | None:
    """The signer of logs in signed mode; None if this machine is not provisioned as a recorder."""
    if settings.mode != "signed":
        return None
    # Cryptography takes a quarter of the process's memory: open mode does without.
    from recorder.record.signed_mode import LogSigner  # noqa: PLC0415
    from schemas.authority.key_files import KEY_FILE, directory_of, made, read_identity  # noqa: PLC0415

    directory = directory_of(settings)
    if not (directory / KEY_FILE.format(who="recorder")).exists():
        sys.stderr.write(f"record: the logs are not signed: {made('recorder')}\n")
        return None
    return LogSigner(read_identity(directory, "recorder"))


def _proofs_of(settings: AuthoritySettings) -> Callable[[], StatementProofs] | None:
    """The factory of a log's verifier of statements, in signed mode."""
    if settings.mode != "signed":
        return None
    from recorder.record.signed_mode import StatementProofs  # noqa: PLC0415 - open mode does without
    from schemas.authority.key_files import directory_of, read_trust  # noqa: PLC0415 - the same

    return partial(StatementProofs, read_trust(directory_of(settings), "recorder"))


def with_shard_lease(settings: Settings) -> Settings:
    """The settings with a shard's lease, if it is a shard and no lease is configured."""
    if not settings.recorder.shard or "lease_ms" in settings.zenoh.given:
        return settings
    return msgspec.structs.replace(
        settings, zenoh=msgspec.structs.replace(settings.zenoh, lease_ms=SHARD_LEASE_MS)
    )


def _source(settings: Settings, expressions: Sequence[str]) -> ZenohSource:
    recorder = settings.recorder
    if not recorder.shard:
        return ZenohSource(settings.zenoh, expressions, recorder.queue_bytes // RING_SAMPLE_BYTES)
    own = shard_of(recorder.shard)
    if not recorder.per_robot:
        raise CommandError("a shard needs a log for each robot: set recorder.per_robot", ExitCode.USAGE)
    return ShardedSource(settings.zenoh, expressions, settings.robot.root, own)


def recorder_plan(settings: Settings, name: str, expressions: Sequence[str], release: str) -> RecorderPlan:
    recorder = settings.recorder
    # Open files cannot be deleted: within a budget no file may be large.
    budget_part = recorder.budget_bytes // BUDGET_FILES
    rotate_bytes = min(filter(None, (recorder.rotate_bytes, budget_part)), default=0)
    return RecorderPlan(
        root=settings.robot.root,
        recorder=name,
        per_robot=recorder.per_robot,
        log=LogPlan(
            name=log_name(settings.robot.root, expressions),
            # A file is at least one chunk.
            chunk_bytes=min(recorder.chunk_bytes, max(CHUNK_MIN_BYTES, rotate_bytes or recorder.chunk_bytes)),
            flush_ns=round(recorder.flush_s * 1e9),
            version=release,
            rotate_bytes=rotate_bytes,
            rotate_ns=round(recorder.rotate_s * 1e9),
            idle_ns=IDLE_NS,
            alarms=frozenset(map(EventKind, recorder.incident_events)),
            before_ns=round(recorder.incident_before_s * 1e9),
            after_ns=round(recorder.incident_after_s * 1e9),
            proofs=_proofs_of(settings.authority),
        ),
        ring_bytes=min(recorder.incident_ring_bytes, recorder.budget_bytes // BUDGET_RINGS or sys.maxsize),
        sample_max_bytes=recorder.sample_max_bytes,
        standby=recorder.standby,
        known=known_robots(settings, expressions),
    )


def collect_seldom() -> None:
    """Run the garbage collector rarely: scanning the waiting samples took a third of the processor."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECT_AFTER)


def allow_many_files() -> int:
    """Raise the limit of open files. Returns the number of robots whose log and incident fit into it."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    return ROBOT_LIMIT if most == resource.RLIM_INFINITY else min(ROBOT_LIMIT, max(0, most - FILES_APART) // 2)


def hangups() -> Callable[[], bool]:
    """Return a function that reports whether SIGHUP came since its last call."""
    came = False

    def handle(_number: int, _frame: FrameType | None) -> None:
        nonlocal came
        came = True

    def has_come() -> bool:
        nonlocal came
        before, came = came, False
        return before

    signal.signal(signal.SIGHUP, handle)
    return has_come


def log_name(root: str, expressions: Sequence[str]) -> str:
    """The beginning of the log's name: the robot, if the expressions can match only one."""
    robot, *others = _robots_in(root, expressions)
    return FLEET_NAME if others else robot or FLEET_NAME


def known_robots(settings: Settings, expressions: Sequence[str]) -> frozenset[str]:
    """The robots named in the settings or in the key expressions."""
    named = _robots_in(settings.robot.root, expressions) - {""}
    return frozenset(named.union(settings.recorder.known_robots))


def _robots_in(root: str, expressions: Sequence[str]) -> set[str]:
    """The robots named in key expressions; empty stands for all others."""
    pattern = re.compile(rf"{re.escape(root)}/({keys.ROBOT_PATTERN})(/.*)?")
    return {match[1] if (match := pattern.fullmatch(expression)) else "" for expression in expressions}


def _report(recorded: Recorded, *, as_json: bool) -> int:
    if as_json:
        sys.stdout.write(msgspec.json.encode(recorded).decode() + "\n")
    elif recorded.path is not None:
        sys.stdout.write(f"{recorded.path}\n")
    if recorded.is_hung:
        sys.stderr.write(
            "cruiser record: the disk does not respond: the logs are not finished, "
            f"and at least {recorded.lost_disk} messages are lost\n"
        )
        return int(ExitCode.PARTIAL)
    counts = recorded.keys.values()
    full = recorded.lost_full
    if recorded.path is None and recorded.lost_disk + full:
        raise CommandError(f"no log could be written; {recorded.lost_disk + full} messages are lost")
    if not any(count.received for count in counts):
        raise CommandError("no sample received, so there is no log", ExitCode.UNREACHABLE)
    dropped = recorded.lost_queue + recorded.lost_size
    notes = [
        f", in {recorded.files} files" if recorded.files > 1 else "",
        f", {recorded.incidents} incident{'s' if recorded.incidents > 1 else ''}" if recorded.incidents else "",
        f"; {dropped} samples dropped" if dropped else "",
        f"; {full} messages not recorded on the full disk" if full else "",
        f"; {recorded.lost_disk} messages lost by the disk" if recorded.lost_disk else "",
        f"; {recorded.unfinished} files not finished" if recorded.unfinished else "",
    ]
    sys.stderr.write(
        f"record: {recorded.messages} messages on {recorded.channels} channels, {recorded.bytes} bytes, "
        f"{recorded.lost_link} samples missed{''.join(notes)}\n"
    )
    return int(ExitCode.PARTIAL if recorded.lost_disk or dropped or full or recorded.unfinished else ExitCode.OK)
