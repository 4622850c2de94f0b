"""The story of a first fleet: driven, watched, attacked, and its operator locked out. Each fact is judged."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import Any, Final

import msgspec

from gateway.cli.child import Child
from gateway.cli.demo_drive import HELD_UP, Interrupted
from gateway.cli.fleet_machines import (
    INTRUDER,
    OPERATOR,
    OPERATOR_LIMIT_MPS,
    ROBOTS,
    SITE,
    VIEWER,
    Done,
    FleetMachines,
)
from gateway.client.payloads import encode_request
from gateway.client.reasons_text import is_idle
from gateway.client.robot import Robot
from gateway.zenoh.client import client_endpoints, close_session, open_session, open_towards_robots
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.decisions import EventKind, SafetyEvent, SafetyState
from schemas.exit_codes import CommandError, ExitCode
from schemas.reasons import Reason
from schemas.requests import Acquire, Drive, Take
from schemas.settings import RESET_MIN_NS, Settings
from schemas.zenoh_link import MODE

WAIT_S: Final = 20.0
"""The longest wait for a fact; on a quiet machine each takes less than a second."""

POLL_S: Final = 0.01

WANTED_MPS: Final = 2.0
"""The speed that operator and intruder request: more than is granted."""

FORGED_ANGLE_DEG: Final = 15.0

DRIVE_S: Final = 600
"""The drive's time: longer than the story."""

DEADMAN_S: Final = 1.0
"""A busy machine may hold up the operator for so long, and no longer."""

FORGED_DRIVES: Final = 50

TIGHT_S: Final = "1"
"""The wait for an answer of a command that is to be rejected in silence, seconds."""


class JudgedFact(msgspec.Struct, frozen=True):
    """Something that was seen.

    Attributes:
        what: was tried or looked at.
        seen: the result.
        holds: it is as it should be.
    """

    what: str
    seen: str
    holds: bool


class FleetStory:
    """Plays the story on machines that run.

    Attributes:
        facts: those that were seen until now.
    """

    def __init__(self, machines: FleetMachines, stopped: Callable[[], bool], tell: Callable[[str], None]) -> None:
        self.facts: list[JudgedFact] = []
        self._machines = machines
        self._stopped = stopped
        self._tell = tell
        self._events: list[SafetyEvent] = []
        self._fastest_mps = 0.0
        self._challenge = b""

    @property
    def was_held_up(self) -> bool:
        """A busy machine explains why the robot did not do what it was to do."""
        return any(event.reason in HELD_UP for event in self._events)

    def play(self) -> None:
        """Let all of it happen.

        Raises:
            CommandError: something did not come; the story ends there.
            Interrupted: somebody ended it.
        """
        self._tell("\nwho is let in: keys stay where they were made, only requests and bundles travel")
        self._machines.let_all_in()
        self._machines.make_intruder()
        self._look_at_files()
        with ExitStack() as stack:
            self._tell("\nthe machines run")
            self._machines.start_all(stack)
            with self._watch(ROBOTS[0]) as first, self._watch(ROBOTS[1]) as second:
                try:
                    self._see(first, second)
                    drive = self._drive(stack, first)
                    self._meet_strangers()
                    self._command_without_a_grant()
                    self._forge(first, second, drive)
                    self._stop_one(first, second, drive)
                    self._lock_out(first, drive)
                finally:
                    self._events += first.events()
            self._machines.end()
        self._verify()

    def judge(self, what: str, seen: str, holds: bool) -> None:  # noqa: FBT001 - it reads as a sentence
        """Keep a fact, and say it."""
        fact = JudgedFact(what, seen, holds)
        self.facts.append(fact)
        self._tell(line_of(fact))

    def _look_at_files(self) -> None:
        files = self._machines.directory
        private = sorted(files.rglob("*.key"))
        open_to_others = [path.name for path in private if path.stat().st_mode & 0o077]
        travelled = [*files.glob("*.request"), *files.glob("*.bundle")]
        leaks = [path.name for path in travelled if b"PRIVATE KEY" in path.read_bytes()]
        self.judge(
            "keys",
            f"{len(private)} private keys, {len(open_to_others)} readable for others; "
            f"{len(leaks)} of {len(travelled)} files that travelled hold one",
            bool(private and travelled) and not open_to_others and not leaks,
        )

    def _see(self, first: Robot, second: Robot) -> None:
        self._tell("\nthe viewer looks")
        for robot in (first, second):
            self._wait(f"{robot.name} waits for its operator", partial(_waits, robot))
        listed = self._machines.run("list", *self._as(VIEWER, "viewer"))
        lines = listed.text.splitlines()
        named = [robot for robot in ROBOTS if any(line.startswith(f"{robot} ") for line in lines)]
        is_whole = named == list(ROBOTS) and listed.code == ExitCode.OK
        self.judge("the viewer lists robots", f"{', '.join(named)}, none of them lost", is_whole)

    def _drive(self, stack: ExitStack, robot: Robot) -> Child:
        self._tell("\nthe operator drives, faster than was granted")
        words = ("--speed", f"{WANTED_MPS:g}", "--seconds", str(DRIVE_S), "--deadman", f"{DEADMAN_S:g}")
        drive = self._machines.start(stack, "drive", "drive", robot.name, *words, *self._as(OPERATOR, "operator"))

        def is_fast() -> bool:
            return self._speed(robot) > 0.95 * OPERATOR_LIMIT_MPS

        self._wait(f"{robot.name} drives at {OPERATOR_LIMIT_MPS:g} m/s", is_fast)
        why = self._machines.run("why", robot.name, *self._as(VIEWER, "viewer"))
        holder = robot.state().state.lease_holder
        self.judge(
            "the viewer asks why",
            why.text.splitlines()[0] if why.text else "",
            why.code == ExitCode.OK and OPERATOR in why.text and holder == OPERATOR,
        )
        return drive

    def _meet_strangers(self) -> None:
        self._tell("\nan intruder knocks at the router")
        place = self._machines.endpoint.removeprefix("tls/")
        file = f"{INTRUDER}/no-certificate.json5"
        ours = f"{self._machines.directory}/{VIEWER}/ca.pem"
        content = {"transport": {"link": {"tls": {"root_ca_certificate": ours}}}}
        (self._machines.directory / file).write_text(json.dumps(content), encoding="utf-8")
        tried = {
            "without TLS": ("list", "--connect", f"tcp/{place}"),
            "without a certificate": ("list", "--connect", self._machines.endpoint, "--zenoh-config", file),
        }
        answers = self._machines.run_all((*words, "--timeout", TIGHT_S) for words in tried.values())
        for how, answer in zip(tried, answers, strict=True):
            self._judge_refused(f"an intruder {how}", answer, ExitCode.UNREACHABLE)
        # Our commands look at such files and send nothing; an intruder's own program does not.
        self._judge_refused(
            "an intruder with another authority's certificate",
            self._knock_with_foreign_files(),
            ExitCode.UNREACHABLE,
        )

    def _knock_with_foreign_files(self) -> Done:
        """Open a session with the intruder's certificate, by Zenoh alone."""
        settings = self._machines.settings(INTRUDER, "operator").zenoh
        try:
            close_session(open_session(settings, client_endpoints(settings), [], changes={MODE: "client"}))
        except CommandError as error:
            return Done(int(error.code), str(error))
        return Done(int(ExitCode.OK), "the router lets it in")

    def _command_without_a_grant(self) -> None:
        self._tell("\nothers command who may not")
        words = ("drive", ROBOTS[1], "--speed", "0.3", "--seconds", "1")
        viewer, desk = self._machines.run_all(
            [
                (*words, *self._with_certificate(VIEWER, "viewer")),
                (*words, *self._with_certificate("desk", "desk")),
            ]
        )
        self._judge_refused("the viewer commands", viewer, ExitCode.UNREACHABLE, "did not answer acquire")
        self._judge_refused("a desk without a grant commands", desk, ExitCode.REFUSED, Reason.PROOF_MISSING.value)

    def _forge(self, first: Robot, second: Robot, drive: Child) -> None:
        """The viewer's certificate in wrong hands: without its own rules, in the operator's name, for all robots.

        What is sent on one session with one priority arrives in its order. The stop that the viewer may send comes
        last: once the robot has that, the router has had all the rest.
        """
        self._tell(
            f"\nthe viewer's certificate is stolen: {FORGED_DRIVES} drives in the operator's name, a stop of all"
        )
        settings = self._without_rules()
        root = settings.robot.root
        session = open_towards_robots(settings.zenoh)
        with CommandPort(session, root, second.name, VIEWER) as own:
            as_operator = CommandPort(session, root, first.name, OPERATOR)
            to_all = CommandPort(session, root, keys.ALL, VIEWER)
            questions = [
                as_operator.begin("acquire", encode_request(Acquire()), WAIT_S),
                as_operator.begin("take", encode_request(Take(override=True)), WAIT_S),
            ]
            for number in range(FORGED_DRIVES):
                challenge = self._next_challenge(first)
                as_operator.put("drive", encode_request(_forged(number, challenge)))
            to_all.put("stop", b"")
            self._wait(f"{second.name} is stopped", lambda: self._stop_until_latched(own, second))
            answered = [question for question in questions if question.poll()]
        state = self._driven(first, drive)
        self.judge(
            "forged drives, leases, a stop of all",
            f"{len(answered)} answered; {first.name} is driven on by {state.lease_holder}, steers to "
            f"{state.target_angle_deg:g} deg; of all that the stop of {second.name} alone came through",
            not answered and not state.latched and state.target_angle_deg == 0.0,
        )

    def _next_challenge(self, robot: Robot) -> bytes:
        """A challenge not used before. Drives then go out no faster than an operator's, and none is dropped."""
        used = self._challenge
        self._wait("a new challenge", lambda: robot.state().state.challenge != used)
        self._challenge = robot.state().state.challenge
        return self._challenge

    def _stop_until_latched(self, port: CommandPort, robot: Robot) -> bool:
        """Send a stop again, as a stop always is; True once it is latched."""
        if Reason.REMOTE_STOP in robot.state().state.latched:
            return True
        port.put("stop", b"")
        return False

    def _stop_one(self, first: Robot, second: Robot, drive: Child) -> None:
        self._tell("\nthe operator resets what the stolen certificate stopped; the viewer may stop one robot")
        # A reset counts so long after the stop.
        counts_s = time.monotonic() + RESET_MIN_NS / 1e9
        self._wait("the time from which on a reset counts", lambda: time.monotonic() > counts_s)
        of = ("--of", second.state().state.stopped_by[0])
        reset = self._machines.run("reset", second.name, *of, *self._as(OPERATOR, "operator"))
        self.judge("the operator resets", reset.last, reset.code == ExitCode.OK)
        stop = self._machines.run("stop", second.name, *self._as(VIEWER, "viewer"))
        holder = self._driven(first, drive).lease_holder
        self.judge(
            "the viewer stops one robot",
            f"{stop.last}; {first.name} is driven on by {holder}",
            stop.code == ExitCode.OK and Reason.REMOTE_STOP in second.state().state.latched,
        )

    def _lock_out(self, robot: Robot, drive: Child) -> None:
        self._tell("\nthe operator's grant is revoked while the robot drives")
        key = self._key_of(OPERATOR)
        words = ("--directory", "authority", "-o", "revocations.statement")
        self._machines.provision([("revoke", "--key", key, *words)])
        self._driven(robot, drive)
        before_mps = self._speed(robot)
        # It is meant to end.
        del self._machines.children["drive"]
        with ThreadPoolExecutor(1) as pool:
            shown = pool.submit(
                self._machines.run,
                *("provision", "show", "revocations.statement", "--all", "--directory", "desk"),
            )
            self._wait(f"{robot.name} stands", lambda: self._stands(robot))
            answer = shown.result()
        self.judge(
            "robots take over the revocation",
            "; ".join(answer.text.split("\n")[:-1]),
            answer.code == ExitCode.OK and all(f"{name}: taken over" in answer.text for name in ROBOTS),
        )
        self._wait("the stop is an event", lambda: bool(self._event(robot, EventKind.STOPPED)))
        begin, end = (self._event(robot, kind) for kind in (EventKind.STOP, EventKind.STOPPED))
        lasted_s = (end.time_ns - begin.time_ns) / 1e9 if begin and end else 0.0
        state = robot.state().state
        self.judge(
            "the robot stops in a controlled way",
            f"{begin.text if begin else 'no stop'}; from {before_mps:.2f} m/s to rest in {lasted_s:.2f} s",
            begin is not None and begin.reason is Reason.GRANT_REVOKED and not state.latched and before_mps > 0,
        )
        code, last = drive.wait()
        self._judge_refused(
            "the operator's drive ends", Done(code, last), ExitCode.FAILURE, Reason.GRANT_REVOKED.value
        )
        once_more = ("drive", robot.name, "--speed", "0.3", "--seconds", "1", "--timeout", "2")
        again = self._machines.run(*once_more, *self._as(OPERATOR, "operator"))
        self._judge_refused("the operator drives again", again, ExitCode.REFUSED, "revoked")
        self.judge(
            "speed",
            f"{WANTED_MPS:g} m/s asked for, {OPERATOR_LIMIT_MPS:g} granted, {self._fastest_mps:.2f} measured",
            0 < self._fastest_mps <= 1.1 * OPERATOR_LIMIT_MPS,
        )

    def _verify(self) -> None:
        self._tell("\nwho commanded: the log is held against the signatures in it")
        words = ("recorder/log", "--authority", "authority/authority.json")
        done = self._machines.run("review", "verify", "--json", *words)
        try:
            found = [json.loads(line) for line in done.text.splitlines()]
            reports: dict[str, Any] = {robot: one for robot in ROBOTS for one in found if one["robot"] == robot}
            driven = reports[ROBOTS[0]]
        except (ValueError, LookupError, TypeError) as error:
            raise CommandError(f"cruiser review verify: {done.last}") from error
        for robot, report in reports.items():
            counts = [count for run in report["runs"] for count in run["subjects"].values()]
            proven = sum(count["proven"] for count in counts)
            lost = sum(count["missing"] + count["broken"] for count in counts)
            heads = sum(run["heads"] for run in report["runs"])
            self.judge(
                f"the log of {robot}",
                f"{proven} samples proven by {heads} chain heads, {lost} missing or changed",
                proven > 0 and not lost and not report["findings"],
            )
        # The operator's own, of after the revocation, are no forged ones.
        own = Reason.GRANT_REVOKED.value
        forged = sum(one["count"] for one in driven["refused"] if one["reason"] != own)
        stops = sum(one["count"] for one in driven["unproven_stops"])
        self.judge(
            f"what reached {ROBOTS[0]} of the forged commands",
            f"{forged} verbs and drives, {stops} stops, by its log",
            not forged and not stops,
        )
        signers = {
            one["id"]: " by ".join([one["name"], *one["signers"], "the authority"]) for one in driven["grants"]
        }
        holders = [one for one in driven["holders"] if one["drives"]]
        drives = [f"{one['drives']} drive commands of {signers.get(one['grant'], 'nobody')}" for one in holders]
        by_whom = [one["operator"] for one in holders]
        self.judge(f"who drove {ROBOTS[0]}", "; ".join(drives), by_whom == [OPERATOR])
        self.judge("cruiser review verify", f"exit code {done.code}", done.code == ExitCode.OK)

    def _judge_refused(self, what: str, done: Done, code: ExitCode, because: str = "") -> None:
        is_refused = done.code == code and because in done.text
        self.judge(what, f"{'refused' if is_refused else f'exit code {done.code}'}: {done.last}", is_refused)

    @staticmethod
    def _with_certificate(who: str, role: str) -> tuple[str, ...]:
        """Arguments of somebody who has the certificate, and asks for what it does not allow."""
        return "--zenoh-config", f"{who}/{role}.json5", "--operator", who

    def _as(self, who: str, role: str) -> tuple[str, ...]:
        return ("--config", f"{who}/{role}.toml")

    def _watch(self, robot: str) -> Robot:
        return Robot.connect(robot, VIEWER, self._machines.settings(VIEWER, "viewer"), WAIT_S, self._stopped)

    def _without_rules(self) -> Settings:
        """The viewer's settings, and a Zenoh file that has the certificate without the rules."""
        files = self._machines.directory
        content = json.loads((files / VIEWER / "viewer.json5").read_bytes())
        for rules in ("access_control", "low_pass_filter"):
            content.pop(rules)
        stolen = files / INTRUDER / "stolen.json5"
        stolen.write_text(json.dumps(content), encoding="utf-8")
        settings = self._machines.settings(VIEWER, "viewer")
        return msgspec.structs.replace(settings, zenoh=msgspec.structs.replace(settings.zenoh, config=str(stolen)))

    def _key_of(self, name: str) -> str:
        """The key that a site let in under this name: as a person would look it up."""
        issued: Sequence[dict[str, str]] = [
            json.loads(line)
            for line in (self._machines.directory / SITE / "issued.jsonl").read_text().splitlines()
        ]
        return next(one["key"] for one in issued if one["name"] == name)

    def _speed(self, robot: Robot) -> float:
        chassis = robot.state().chassis
        speed_mps = abs(chassis.speed_mps or 0.0) if chassis else 0.0
        self._fastest_mps = max(self._fastest_mps, speed_mps)
        return speed_mps

    def _driven(self, robot: Robot, drive: Child) -> SafetyState:
        """The state of the robot that is driven.

        Raises:
            CommandError: it is not; the drive says why.
        """
        state = robot.state().state
        if not state.engaged:
            raise CommandError(drive.wait()[1])
        return state

    def _stands(self, robot: Robot) -> bool:
        return self._speed(robot) == 0.0 and not robot.state().state.engaged

    def _event(self, robot: Robot, kind: EventKind) -> SafetyEvent | None:
        self._events += robot.events()
        return next((event for event in self._events if event.kind is kind), None)

    def _wait(self, what: str, condition: Callable[[], bool]) -> None:
        end_s = time.monotonic() + WAIT_S
        while not condition():
            if self._stopped():
                raise Interrupted
            self._machines.check()
            if time.monotonic() > end_s:
                raise CommandError(f"not seen within {WAIT_S:g} s: {what}")
            time.sleep(POLL_S)


def _waits(robot: Robot) -> bool:
    return is_idle(robot.state().state.blocked_by)


def _forged(number: int, challenge: bytes) -> Drive:
    return Drive(lease=1, seq=number, challenge=challenge, speed_mps=WANTED_MPS, angle_deg=FORGED_ANGLE_DEG)


def line_of(fact: JudgedFact) -> str:
    """A fact, for people."""
    return f"  {'ok ' if fact.holds else 'NOT AS IT SHOULD BE '} {fact.what}: {fact.seen}"
