"""``cruiser halt``: the stop sequence by hand, or by systemd's ExecStopPost. Needs no gateway and no Zenoh."""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections.abc import Callable
from typing import Final

import msgspec

from gateway.can.can_bus import Bus, BusFull, BusLost
from gateway.can.open_bus import describe, open_bus
from gateway.chassis.frame import Frame
from gateway.chassis.supervision import VariantDetector
from gateway.choice.chassis import CHASSIS
from gateway.core import CONFIGURED_VARIANT
from gateway.guard.stopper import NOT_OBEYED, OTHER, REMOTE, STANDS, UNSEEN, Stopper
from gateway.host.notes import NoteWriter, StopNote
from gateway.host.process import request_realtime
from schemas.arguments import add_bus_arguments, add_variant_argument, seconds
from schemas.command_line import CommandError, ExitCode
from schemas.messages import Mode
from schemas.settings import (
    GUARD_GIVES_UP_NS,
    GUARD_POLL_NS,
    HALT_LISTEN_NS,
    HALT_YIELD_NS,
    SEND_FAILURES,
    Settings,
)

EXAMPLE: Final = """\
  cruiser halt --interface socketcan --channel can0 --robot cruiser-7"""

log = logging.getLogger(__name__)

_EXIT_CODES: Final = {STANDS: ExitCode.OK, REMOTE: ExitCode.REFUSED, OTHER: ExitCode.REFUSED}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Listens to the bus, reports what it finds, and stops a robot that no gateway commands: zero speed,\n"
        "parking brake, then no more frames. Waits while a guard stops the robot, or the remote control has it:\n"
        "afterwards the chassis would execute its last command again. The next gateway needs a reset.\n"
        "Not an emergency stop: that is the button on the robot."
    )
    add_bus_arguments(parser)
    add_variant_argument(parser)
    parser.add_argument(
        "--force", action="store_true", help="send even if the robot stands, or another computer sends"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object at the end: ok, outcome, frames_sent")
    parser.add_argument(
        "--wait",
        type=seconds,
        default=HALT_YIELD_NS / 1e9,
        metavar="N",
        help="longest wait for another sender or the remote control (default %(default)g s)",
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    try:
        bus = open_bus(settings.can, CHASSIS.common.identifiers)
    except BusLost as error:
        raise CommandError(str(error), ExitCode.UNREACHABLE) from error
    # What has ended the gateway may be a machine that is too busy.
    request_realtime(settings.gateway.realtime_priority)
    try:
        halt = HaltSequence(bus, settings, stopped, round(arguments.wait * 1e9))
        code = halt.run(force=arguments.force)
    except BusLost as error:
        raise CommandError(f"the bus is lost: {error}", ExitCode.UNREACHABLE) from error
    finally:
        bus.close()
    if arguments.json:
        record = {"ok": code is ExitCode.OK, "outcome": halt.outcome, "frames_sent": halt.frames}
        sys.stdout.write(f"{msgspec.json.encode(record).decode()}\n")
    return int(code)


class HaltSequence:
    """One halt: listen, judge, send."""

    def __init__(
        self, bus: Bus, settings: Settings, stopped: Callable[[], bool], wait_ns: int = HALT_YIELD_NS
    ) -> None:
        self._bus = bus
        self._where = describe(settings.can)
        self._settings = settings
        self._stopped = stopped
        self._wait_ns = wait_ns
        self.outcome = ""
        self.frames = 0
        self._view = CHASSIS.view()
        self._detector = VariantDetector(CONFIGURED_VARIANT[settings.chassis.variant], CHASSIS.evidence())
        self._evidence: bytes | None = None

    def run(self, *, force: bool) -> ExitCode:
        self._listen(HALT_LISTEN_NS)
        if self._is_commanded() and not force:
            _say("another sender, perhaps the guard, commands the chassis: waiting for its end")
            if not self._wait_while(self._is_commanded):
                outcome = "the other sender goes on, so nothing is sent; --force sends anyway"
                return self._end(outcome, ExitCode.REFUSED)
        if self._is_remote():
            _say(f"{REMOTE}: waiting for its release")
            if not self._wait_while(self._is_remote):
                return self._end(f"{REMOTE}, so nothing is sent", ExitCode.REFUSED)
        now_ns = time.monotonic_ns()
        mode, stands = self._view.mode(now_ns), self._view.stands(self._detector.in_force, now_ns)
        if not self._view.has_feedback(now_ns):
            _say(f"no feedback on {self._where}: stopping without it")
        else:
            _say(f"mode {mode.value}, {STANDS if stands else UNSEEN}")
        if mode is Mode.STOP and stands and not force:
            return self._end("nothing to stop, so nothing is sent; --force sends anyway", ExitCode.OK)
        return self._send()

    def _end(self, outcome: str, code: ExitCode, say: Callable[[str], None] | None = None) -> ExitCode:
        (say or _say)(outcome)
        self.outcome = outcome
        return code

    def _is_commanded(self) -> bool:
        """Return True if another sender was seen lately. A guard begins only once its gateway is late."""
        heard_ns = self._view.commander_ns
        return heard_ns is not None and time.monotonic_ns() - heard_ns < HALT_LISTEN_NS

    def _is_remote(self) -> bool:
        return self._view.mode(time.monotonic_ns()) is Mode.REMOTE

    def _wait_while(self, condition: Callable[[], bool]) -> bool:
        """Listen while this holds; False if it still does at the end of the wait."""
        end_ns = time.monotonic_ns() + self._wait_ns
        while condition():
            if time.monotonic_ns() >= end_ns or self._stopped():
                return False
            self._listen(GUARD_POLL_NS)
        return True

    def _listen(self, duration_ns: int) -> None:
        end_ns = time.monotonic_ns() + duration_ns
        while (now_ns := time.monotonic_ns()) < end_ns:
            self._receive_until(min(end_ns, now_ns + GUARD_POLL_NS))
            self._view.stands(self._detector.in_force, time.monotonic_ns())

    def _receive_until(self, end_ns: int) -> None:
        while (now_ns := time.monotonic_ns()) < end_ns:
            frame = self._bus.receive((end_ns - now_ns) / 1e9)
            if frame is None:
                continue
            self._view.receive(frame, now_ns)
            evidence = self._view.evidence_data(now_ns)
            if evidence is not None and evidence is not self._evidence:
                self._evidence = evidence
                self._detector.receive(evidence)

    def _send(self) -> ExitCode:
        variant, now_ns = self._detector.in_force, time.monotonic_ns()
        stopper = Stopper(CHASSIS, self._view, self._settings.command)
        stopper.begin(None, variant, None, now_ns)
        note = NoteWriter(StopNote.of(self._settings), _say)
        try:
            return self._bring_to_rest(stopper, now_ns, note)
        finally:
            note.close()

    def _bring_to_rest(self, stopper: Stopper, now_ns: int, note: NoteWriter) -> ExitCode:
        def say(line: str) -> None:
            _say(line)
            note.add(f"halt: {line}")

        say("sending the stop sequence")
        failures = 0
        given_up_ns = now_ns + self._wait_ns
        braked_ns = now_ns + GUARD_GIVES_UP_NS
        while not stopper.is_over:
            now_ns = time.monotonic_ns()
            if now_ns > braked_ns and not stopper.is_paused:
                # Zero speed is commanded until the end: the chassis repeats its last command for ever.
                stopper.give_up(NOT_OBEYED)
                break
            frames = stopper.tick(now_ns)
            if not stopper.is_paused:
                given_up_ns = now_ns + self._wait_ns
            elif now_ns >= given_up_ns or self._stopped():
                stopper.give_up(REMOTE)
                break
            if frames:
                count = self._send_all(stopper, now_ns, frames)
                failures = failures + 1 if count < len(frames) else 0
            if failures >= SEND_FAILURES:
                return self._end("the bus accepts no frames", ExitCode.UNREACHABLE, say)
            self._receive_until(now_ns + GUARD_POLL_NS)
        code = _EXIT_CODES.get(stopper.outcome, ExitCode.FAILURE)
        return self._end(f"{stopper.outcome}; {stopper.frames} frames sent", code, say)

    def _send_all(self, stopper: Stopper, now_ns: int, frames: list[Frame]) -> int:
        count = 0
        try:
            for frame in frames:
                self._bus.send(frame)
                count += 1
        except BusFull as error:
            log.debug("the bus does not take a frame: %s", error)
        stopper.sent(count, now_ns)
        self.frames = stopper.frames
        return count


def _say(line: str) -> None:
    sys.stderr.write(f"halt: {line}\n")
