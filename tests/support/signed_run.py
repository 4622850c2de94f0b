"""Runs of a gateway in signed mode, made sample by sample, and their logs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gateway.command.rulings import Credentials
from recorder.disk.log_names import SIGNATURE_SUFFIX
from recorder.record.signed_mode import LogSigner
from schemas import keys
from schemas.authority.key_files import Identity
from schemas.authority.proof import Grant, GrantRole, chain_text
from schemas.decisions import (
    Decision,
    EventKind,
    Journal,
    SafetyEvent,
    Severity,
    SignedStatement,
    Verdict,
)
from schemas.journal import Kind
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.requests import Role
from schemas.subjects import BY_VERB
from tests.support.authority import NOW_S, Fleet, Party, S
from tests.support.logs import Log
from tests.support.messages import ROBOT, plain, sample_of

JOURNAL_NS = 50_000_000
PER_SECOND = S // JOURNAL_NS
LEASE = 77
CHALLENGE = b"ch-" + bytes(5)


class SignedRun:
    """One run of a robot's gateway; ``samples`` are what it published, in order."""

    def __init__(
        self,
        fleet: Fleet,
        robot: Party | None = None,
        *,
        boot: bytes = b"boot no1",
        at_s: int = NOW_S,
    ) -> None:
        self.fleet = fleet
        self.robot = robot or Party(ROBOT)
        if not self.robot.chain:
            fleet.authority.grant(self.robot, role=GrantRole.ROBOT, robots=[ROBOT])
        self.samples: list[Message] = []
        self.time_ns = at_s * S
        self._run = int.from_bytes(hashlib.sha256(boot).digest()[:6], "big")
        self._tick = self._run % 2**39
        self._next: dict[type[Message], int] = {}
        self._inputs = 0
        self.waiting: list[tuple[Any, ...]] = []
        self.show(chain_text(self.robot.chain))

    def publish(self, kind: type[Message], /, **said: Any) -> Message:  # noqa: ANN401 - fields of a message
        sequence = self._next[kind] = self._next.get(kind, -1) + 1
        message = plain(kind, time_ns=self.time_ns, sequence=sequence, **said)
        self.samples.append(message)
        return message

    def show(self, text: str) -> None:
        self.publish(SignedStatement, text=text)

    def ask(
        self,
        verb: str,
        by: Party,
        *,
        operator: str = "",
        payload: bytes = b"\x80",
        attachment: bytes | None = None,
        credentials: Credentials | None = None,
    ) -> None:
        """A request; by default it is signed correctly, and accepted."""
        name = operator or by.name
        key = keys.command("fleet", ROBOT, name, verb)
        proof = by.prove(key, BY_VERB[verb].encoding, payload, CHALLENGE) if attachment is None else attachment
        self.waiting.append(
            (
                Kind.REQUEST,
                1,
                1,
                verb,
                name,
                payload,
                len(payload),
                "",
                proof,
                credentials or credentials_of(by),
            )
        )

    def decide(self, request: str, operator: str) -> None:
        self.publish(
            Decision,
            tick=self._tick,
            request=request,
            operator=operator,
            lease=LEASE,
            verdict=Verdict.ACCEPTED,
            output_speed_mps=0.25,
            output_angle_deg=-0.0,
            frames_sent=4,
        )

    def seconds(self, count: int) -> None:
        """Let time pass: journals, decisions and an event."""
        for _ in range(count):
            for _ in range(PER_SECOND):
                self.time_ns += JOURNAL_NS
                self._tick += 5
                inputs = [*self.waiting, (Kind.TICK, 2, self.time_ns, 0, CHALLENGE)]
                self.waiting = []
                encoded = msgspec.msgpack.encode(inputs)
                self.publish(
                    Journal, run=self._run, first=self._inputs, count=len(inputs), inputs=encoded, rules=2
                )
                self._inputs += len(inputs)
            self.decide("drive", "ann")
            self.publish(
                SafetyEvent, tick=self._tick, severity=Severity.INFO, kind=EventKind.LEASE, reason=Reason.NONE,
                operator="ann", text="as it were",
            )  # fmt: skip


def credentials_of(party: Party, **changes: Any) -> Credentials:  # noqa: ANN401 - fields
    grant = party.chain[0].statement
    assert isinstance(grant, Grant)
    said: dict[str, Any] = {
        "serial": grant.serial,
        "role": Role(grant.role.value),
        "override": grant.override,
        "speed_limit_mps": grant.speed_limit_mps,
    }
    return Credentials(Reason.NONE, **(said | changes))


def driven(fleet: Fleet, seconds: int = 6, **how: Any) -> tuple[SignedRun, Party]:  # noqa: ANN401 - of the run
    """A run in which Ann acquires the lease, engages and drives."""
    run = SignedRun(fleet, **how)
    ann = fleet.operator("ann", speed_limit_mps=0.5)
    run.show(chain_text(ann.chain))
    run.seconds(1)
    run.ask("acquire", ann)
    run.ask("engage", ann)
    run.time_ns += JOURNAL_NS
    run.decide("acquire", "ann")
    run.decide("engage", "ann")
    run.time_ns -= JOURNAL_NS
    run.seconds(seconds - 1)
    return run, ann


def log_of(samples: Iterable[Message], *, late_ns: int = 2_000_000) -> bytes:
    log = Log()
    for message in samples:
        log.receive(sample_of(message), wall_ns=message.time_ns + late_ns)
    return log.close()


def of(samples: Sequence[Message], kind: type[Message]) -> list[int]:
    return [place for place, one in enumerate(samples) if type(one) is kind]


def replaced(samples: Sequence[Message], place: int, **changes: Any) -> list[Message]:  # noqa: ANN401 - fields
    return [
        msgspec.structs.replace(one, **changes) if number == place else one for number, one in enumerate(samples)
    ]


def recorder_of(fleet: Fleet, **changes: Any) -> LogSigner:  # noqa: ANN401 - fields of a grant
    """The signer of a fleet's recorder."""
    recorder = Party("depot-1")
    fleet.authority.grant(recorder, **({"role": GrantRole.RECORDER} | changes))
    return LogSigner(Identity(recorder.private, recorder.chain, fleet.trust))


def signed(log: Path, signer: LogSigner) -> Path:
    sha256 = hashlib.sha256(log.read_bytes()).hexdigest()
    log.with_name(log.name + SIGNATURE_SUFFIX).write_bytes(signer.sign(sha256, log.name))
    return log
