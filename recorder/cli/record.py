"""``cruiser record``: write what is said on Zenoh into MCAP logs."""

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
    """Return the name that is set; else that of the recorder's grant, in signed mode; else the host's."""
    name = settings.recorder.name
    if not name and settings.authority.mode == "signed":
        from schemas.authority.key_files import directory_of, granted_name  # noqa: PLC0415 - open mode does without

        name = granted_name(directory_of(settings.authority), "recorder")
    return name or host_name()


EXAMPLE: Final = "  cruiser record -k 'fleet/cruiser-1/**' -o logs"

LEFTOVERS_S: Final = 5.0
"""The end waits so long for the recovery of logs that an earlier recorder left; the next start resumes it."""

FLEET_NAME: Final = "fleet"  # begins the name of a log that may hold several robots, or what is no robot's

IDLE_NS: Final = 600_000_000_000
"""A log whose robot has said nothing for ten minutes is ended; if it says more, another is begun."""

SHARD_LEASE_MS: Final = 5000
"""A shard's links are lost after so long without a sign of life, unless a setting or a file says another: while a
router takes in a thousand robots it hears nobody for seconds, and each link that breaks gives it more to do."""

COLLECT_AFTER: Final = (100_000, 50, 100)
"""Thresholds of the garbage collector: nothing that is made for each sample is in a circle."""

FILES_APART: Final = 100  # files and links that may be open besides the logs
CHUNK_MIN_BYTES: Final = 16_384  # however small the files are to be, chunks are not made smaller for it than this
BUDGET_FILES: Final = 20  # a file is ended at this part of the budget

BUDGET_RINGS: Final = 4
"""The ring for incidents is at most this part of the budget: an incident begins with all of it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    # It runs for hours, and who looks into its log wants to see links come and go.
    parser.set_defaults(log_level="info")
    parser.add_argument(
        "-k",
        "--key",
        dest="recorder.keys",
        metavar="KEY",
        nargs="+",
        action="extend",
        help="key expressions to record (all keys under the root)",
    )
    parser.add_argument("-o", "--out", dest="recorder.directory", metavar="DIR", help="where the logs go (.)")
    parser.add_argument(
        "--name", dest="recorder.name", metavar="NAME", help="the recorder's name (its grant's, else the host's)"
    )
    parser.add_argument(
        "--shard",
        dest="recorder.shard",
        metavar="I/N",
        help="record the I-th part of the robots, by their names; N recorders record all (all of them)",
    )
    add_zenoh_arguments(parser)
    parser.add_argument("--seconds", type=seconds, metavar="N", help="stop after this long (at SIGINT or SIGTERM)")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    _add_actions(parser)
    # Behind them, whose usage would begin with it. Of itself it would show no recording without an action.
    parser.usage = f"{parser.prog} [options]\n       {parser.prog} [options] ACTION ..."


def _add_actions(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(
        dest="action", metavar="ACTION", title="of a recorder that is running, here or elsewhere"
    )
    for action, about in remote.ABOUT.items():
        one = actions.add_parser(
            action,
            help=about,
            description=f"{about[0].upper()}{about[1:]}.",
            # What stands before the action is not to be forgotten.
            argument_default=argparse.SUPPRESS,
        )
        remote.add_arguments(one, action)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Record until stopped, and print the log's path; or ask a recorder that is running."""
    if arguments.action is None:
        return _record(arguments, settings, stopped)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        # It says nothing to these, and whoever hangs up wants them ended, but for nohup.
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
    return remote.run(arguments, settings, stopped)


def _record(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    # First of all: a service may say it as soon as the process is there.
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
        loop.obey(control)
        recorded = loop.run(ending_after(stopped, arguments.seconds, time.monotonic), rolls)
    leftovers.wait(LEFTOVERS_S)
    if not recorded.is_hung:
        # Only now: what was left in a fault may have been recovered since.
        recorded = msgspec.structs.replace(recorded, unfinished=writer.unfinished)
    code = _report(recorded, as_json=arguments.json)
    if recorded.is_hung:
        # Threads that wait for the disk would keep the process for ever.
        sys.stdout.flush()
        os._exit(code)
    return code


def signer_of(settings: AuthoritySettings) -> LogSigner | None:
    """Return what signs the logs in signed mode; None where this machine is not provisioned as a recorder."""
    if settings.mode != "signed":
        return None
    # What signs and verifies takes a quarter of the process's memory: open mode does without.
    from recorder.record.signed_mode import LogSigner  # noqa: PLC0415
    from schemas.authority.key_files import KEY_FILE, directory_of, made, read_identity  # noqa: PLC0415  # noqa: PLC0415

    directory = directory_of(settings)
    if not (directory / KEY_FILE.format(who="recorder")).exists():
        sys.stderr.write(f"record: the logs are not signed: {made('recorder')}\n")
        return None
    return LogSigner(read_identity(directory, "recorder"))


def _proofs_of(settings: AuthoritySettings) -> Callable[[], StatementProofs] | None:
    """Return what makes a log's verifier of statements, in signed mode."""
    if settings.mode != "signed":
        return None
    from recorder.record.signed_mode import StatementProofs  # noqa: PLC0415 - open mode does without
    from schemas.authority.key_files import directory_of, read_trust  # noqa: PLC0415 - the same

    return partial(StatementProofs, read_trust(directory_of(settings), "recorder"))


def with_shard_lease(settings: Settings) -> Settings:
    """Return the settings with a shard's lease, where it is a shard and no lease was given."""
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
        raise CommandError("a shard of a fleet has a log for each robot: set recorder.per_robot", ExitCode.USAGE)
    return ShardedSource(settings.zenoh, expressions, settings.robot.root, own)


def recorder_plan(settings: Settings, name: str, expressions: Sequence[str], release: str) -> RecorderPlan:
    recorder = settings.recorder
    # What is being written cannot be deleted: within a budget no file may be large.
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
    """Samples that wait are no garbage: to look through them again and again took a third of the processor."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECT_AFTER)


def allow_many_files() -> int:
    """As many open files as the system lets this user have: each robot has its own, and its incident another."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    return ROBOT_LIMIT if most == resource.RLIM_INFINITY else min(ROBOT_LIMIT, max(0, most - FILES_APART) // 2)


def hangups() -> Callable[[], bool]:
    """Return a function that reports whether SIGHUP came since its last call: it begins a new file."""
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
    """Return the beginning of the log's name: the robot, if the expressions can match but one."""
    robots = _robots_in(root, expressions)
    return (robots.pop() or FLEET_NAME) if len(robots) == 1 else FLEET_NAME


def known_robots(settings: Settings, expressions: Sequence[str]) -> frozenset[str]:
    """The robots that are known by name, from the settings or from what is to be recorded."""
    named = _robots_in(settings.robot.root, expressions) - {""}
    return frozenset(named.union(settings.recorder.known_robots))


def _robots_in(root: str, expressions: Sequence[str]) -> set[str]:
    """The robots that key expressions name; empty stands for all others."""
    pattern = re.compile(rf"{re.escape(root)}/({keys.ROBOT_PATTERN})(/.*)?")
    return {match[1] if (match := pattern.fullmatch(expression)) else "" for expression in expressions}


def _report(recorded: Recorded, *, as_json: bool) -> int:
    if as_json:
        sys.stdout.write(msgspec.json.encode(recorded).decode() + "\n")
    elif recorded.path is not None:
        sys.stdout.write(f"{recorded.path}\n")
    if recorded.is_hung:
        sys.stderr.write(
            "cruiser record: the disk does not answer: the logs are not ended, "
            f"and {recorded.lost_disk} messages or more are lost\n"
        )
        return int(ExitCode.PARTIAL)
    counts = recorded.keys.values()
    full = recorded.lost_full
    if recorded.path is None and recorded.lost_disk + full:
        raise CommandError(f"the disk took no log; {recorded.lost_disk + full} messages are lost")
    if not any(count.received for count in counts):
        raise CommandError("no sample came, so there is no log", ExitCode.UNREACHABLE)
    dropped = recorded.lost_queue + recorded.lost_size
    notes = [
        f", in {recorded.files} files" if recorded.files > 1 else "",
        f", {recorded.incidents} incidents" if recorded.incidents else "",
        f"; {dropped} samples dropped" if dropped else "",
        f"; no room for {full} messages" if full else "",
        f"; the disk did not take or keep {recorded.lost_disk} messages" if recorded.lost_disk else "",
        f"; {recorded.unfinished} files are not whole" if recorded.unfinished else "",
    ]
    sys.stderr.write(
        f"record: {recorded.messages} messages on {recorded.channels} channels, {recorded.bytes} bytes, "
        f"{recorded.lost_link} samples missed{''.join(notes)}\n"
    )
    return int(ExitCode.PARTIAL if recorded.lost_disk or dropped or full or recorded.unfinished else ExitCode.OK)
