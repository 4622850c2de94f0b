"""The gateway's side of the guard: start it, watch it, and follow the guard of a gateway that died."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from datetime import UTC, datetime
from typing import Final

import msgspec

from gateway.chassis.port import AT_REST, Actuation
from gateway.command.flow import CommandFlow
from gateway.guard.stopper import Beat, GuardStatus, GuardView
from gateway.host.guard_main import Heartbeat
from gateway.host.notes import StopNote
from gateway.host.process import request_realtime
from schemas.command_line import module_command
from schemas.decisions import StopPhase
from schemas.messages import Variant
from schemas.settings import GUARD_HANGS_TICKS, GUARD_RESTART_NS, GUARD_SILENT_NS, Settings

log = logging.getLogger(__name__)

SHARED_INTERFACES: Final = frozenset({"socketcan", "socketcand"})
"""Interfaces whose bus several processes can open at once. On any other there is no guard."""

END_TIMEOUT_S: Final = 1.0  # wait for an idle guard to exit


class NoGuard:
    """Stands for a guard where none can run."""

    def __init__(self, why_not: str) -> None:
        self.why_not = why_not

    def look(self) -> GuardView:
        """Report that no guard watches."""
        return GuardView()

    def beat(self, now_ns: int, command: CommandFlow) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class _Child(msgspec.Struct, frozen=True):
    """A guard's process, and what is shared with it."""

    process: subprocess.Popen[bytes]
    memory: Heartbeat


class GuardProcess:
    """A running guard. If it exits or hangs, it is replaced while no commands are sent to the robot."""

    why_not = ""

    def __init__(self, start: Callable[[], _Child]) -> None:
        self._start = start
        child = start()
        self._process, self._memory = child.process, child.memory
        self._started_ns = time.monotonic_ns()
        self._starting: threading.Thread | None = None
        self._started: _Child | None = None
        self._stops_before = 0
        self._silent_ticks = 0
        self._was_told = self._is_released = False
        self._returns = 0
        self._newest = Beat(0)

    @property
    def pid(self) -> int:
        return self._process.pid

    def look(self) -> GuardView:
        """Return the guard's state, once per tick: reading it takes microseconds."""
        status = self._memory.read_status()
        if status is None:
            return GuardView(stops=self._stops_before)
        lives = _is_alive(status)
        return GuardView(
            is_watching=lives and status.is_ready,
            is_sending=lives and status.is_sending,
            stops=self._stops_before + status.stops,
            says=status.says,
        )

    def beat(self, now_ns: int, command: CommandFlow) -> None:
        arbiter = command.arbiter
        sequence = arbiter.output.sequence
        self._is_released = sequence is not None and sequence.phase is StopPhase.MOTOR
        self._returns = 0 if sequence is None else sequence.returns
        self.tell(
            now_ns,
            arbiter.output.variant,
            arbiter.output.actuation,
            command.maker.counters,
            told_ns=arbiter.output.told_ns,
            left=arbiter.handover.left,
            is_mute=command.is_mute,
        )

    def tell(
        self,
        now_ns: int,
        variant: Variant,
        actuation: Actuation | None,
        counters: Mapping[str, int],
        *,
        told_ns: int,
        left: Actuation | None = None,
        is_mute: bool = False,
    ) -> None:
        """Write a heartbeat with these values; see ``Beat``.

        Args:
            actuation: the command of this tick; None for silence.
            left: the chassis's last command when another controller took it over, while it may execute it again.
        """
        is_told = actuation is not None or is_mute
        is_active = is_told or (self._was_told and left is None)
        if actuation is not None:
            last = actuation
        elif left is not None:
            last = left
        else:
            last = self._newest.last if is_active else AT_REST
        self._newest = Beat(
            now_ns=now_ns,
            told_ns=told_ns,
            is_active=is_active,
            is_left=left is not None and left.enabled,
            is_mute=is_mute,
            variant=variant,
            last=last,
            counters=bytes(counters.values()),
            is_released=self._is_released,
            returns=self._returns,
        )
        self._was_told = is_told
        self._memory.write_beat(self._newest)
        if not self._newest.is_active:
            self._replace_if_gone(now_ns)

    def close(self) -> None:
        """Announce the gateway's end. An idle guard exits with it; one that stops the robot carries on."""
        if self._starting is not None:
            self._starting.join()
            self._take_started()
        self._memory.write_beat(msgspec.structs.replace(self._newest, is_closing=True))
        try:
            self._process.wait(0 if self._newest.is_active else END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            # A guard without any heartbeat is idle; on a busy computer it is still starting.
            if self._newest.now_ns:
                log.warning(
                    "the guard (process %d) is still stopping the robot, and exits afterwards", self._process.pid
                )
        self._memory.close()

    def _replace_if_gone(self, now_ns: int) -> None:
        """Replace a guard that exited or hangs, on a thread: starting a process takes milliseconds."""
        if self._starting is not None:
            if not self._starting.is_alive():
                self._take_started()
            return
        status = self._memory.read_status()
        if status is not None and _is_alive(status):
            self._silent_ticks = 0
            return
        # A guard that is still starting has no status yet, and does not hang.
        self._silent_ticks += status is not None
        is_gone = self._silent_ticks >= GUARD_HANGS_TICKS or self._process.poll() is not None
        if is_gone and now_ns - self._started_ns > GUARD_RESTART_NS:
            self._started_ns = now_ns
            self._starting = threading.Thread(target=self._start_again, name="guard-starter", daemon=True)
            self._starting.start()

    def _start_again(self) -> None:
        log.warning("the guard (process %d) is gone or hangs; starting another", self._process.pid)
        # A hanging guard must not wake up beside its successor.
        self._process.kill()
        self._process.wait()
        try:
            self._started = self._start()
        except OSError as error:
            log.warning("the guard cannot be started: %s", error)

    def _take_started(self) -> None:
        self._starting = None
        started, self._started = self._started, None
        if started is None:
            return
        self._stops_before = self.look().stops
        self._memory.close()
        self._process, self._memory = started.process, started.memory
        self._memory.write_beat(self._newest)


GuardLink = GuardProcess | NoGuard
"""The gateway's side of the guard. Only ``close`` may block."""


def _is_alive(status: GuardStatus) -> bool:
    return time.monotonic_ns() - status.now_ns <= GUARD_SILENT_NS


def start_guard(settings: Settings) -> GuardLink:
    """Start the guard. Where none can run, ``why_not`` of the link has the reason."""
    if settings.gateway.listen_only:
        return NoGuard("the gateway only listens")
    if settings.can.interface not in SHARED_INTERFACES:
        return NoGuard(f"interface {settings.can.interface!r} is not known to let two processes open one bus")
    try:
        return GuardProcess(lambda: _start_child(settings))
    except OSError as error:
        return NoGuard(f"its process cannot be started: {error}")


def _start_child(settings: Settings) -> _Child:
    """Start a guard process. Raises OSError if it cannot be started or exits at once."""
    memory = Heartbeat.create()
    # No fork: this process has threads, and descriptors of its bus and of Zenoh. The module path is ours.
    try:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            module_command("gateway.host.guard_main", str(memory.descriptor)),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=[memory.descriptor],
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
    except OSError:
        memory.close()
        raise
    order = msgspec.json.encode({"parent": os.getpid(), "settings": settings})
    try:
        with process.stdin or nullcontext() as stdin:
            if stdin is not None:
                stdin.write(order)
    except OSError as error:
        process.kill()
        process.wait()
        memory.close()
        raise OSError(f"it ended at once, with exit code {process.returncode}") from error
    return _Child(process, memory)


STOP_MAX_S: Final = 10.0
"""Longest wait for a former guard after its last line; a stop from the highest speed takes half of it."""

_POLL_S: Final = 0.05

_OURS: Final = "guard: "
_DONE: Final = (f"{_OURS}done: ", f"{_OURS}given up: ")


class FormerGuard:
    """Follows the guard of a gateway that died, by the lines in its note. A thread reads the disk."""

    def __init__(self, note: StopNote, realtime_priority: int = 0) -> None:
        """Read the note once; while a stop is under way a thread with this priority reads it again."""
        self.says = ""  # the outcome; empty until it is known, and where the stop was over before this start
        self._realtime_priority = realtime_priority
        left_s = _left_s(note)
        self.is_stopping = left_s > 0  # it began a stop recently, and no outcome is noted yet
        self._until_s = time.monotonic() + left_s
        self._note = note
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="former-guard", daemon=True)
        if self.is_stopping:
            self._thread.start()

    def close(self) -> None:
        self._closing.set()
        if self._thread.ident is not None:
            self._thread.join(_POLL_S * 2)

    def _follow(self) -> None:
        request_realtime(self._realtime_priority)
        while time.monotonic() < self._until_s and not self._closing.wait(_POLL_S):
            last = self._note.last()
            if last is not None and last[1].startswith(_DONE):
                self.says = last[1].removeprefix(_OURS).removeprefix("done: ")
                break
        self.is_stopping = False


def _left_s(note: StopNote) -> float:
    """Return the longest wait for a stop under way; 0 if there is none."""
    last = note.last()
    if last is None or not last[1].startswith(_OURS) or last[1].startswith(_DONE):
        return 0.0
    age_s = (datetime.now(UTC) - last[0]).total_seconds()
    return max(0.0, STOP_MAX_S - age_s) if age_s >= 0 else 0.0
