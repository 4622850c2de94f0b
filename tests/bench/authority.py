"""CPU time of each step of signed mode, in microseconds: medians of rounds, without I/O and without threads."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable
from statistics import median
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.admission import SignedAdmission
from gateway.authority.operator_proof import OperatorProof
from gateway.authority.session import RobotSigner, public_bytes
from gateway.command.flow import PendingReply
from gateway.command.rulings import RawRequest
from gateway.telemetry.samples import Received
from schemas import codec, keys
from schemas.authority.proof import GrantRole, chain_text
from schemas.authority.trust import HeldGrant
from schemas.decisions import LeaseReply, StatementReply
from schemas.reasons import Reason
from schemas.requests import Acquire, Drive
from schemas.settings import Settings
from schemas.subjects import BY_NAME, STATEMENT_REPLY_ENCODING
from tests.bench.loads import Row
from tests.support.authority import CHALLENGE, NOW_S, Fleet, Party
from tests.support.messages import STANDBY

STATES_PER_S: Final = 50
"""While the robot is engaged."""

LEASE: Final = 4711
ROOT, ROBOT, NAME = "fleet", "cruiser-1", "ann"
STATE: Final = BY_NAME["safety/state"]


def cpu_us(step: Callable[[], object], times: int, rounds: int) -> float:
    """Process CPU time of one step: the median of rounds of so many."""
    measured = []
    for _ in range(rounds):
        begun_ns = time.process_time_ns()
        for _ in itertools.repeat(None, times):
            step()
        measured.append((time.process_time_ns() - begun_ns) / times / 1000)
    return median(measured)


class Parties:
    """A robot and the operator who holds its lease, with nothing but bytes between them."""

    def __init__(self) -> None:
        fleet, robot = Fleet(), Party(ROBOT)
        fleet.authority.grant(robot, role=GrantRole.ROBOT, robots=[ROBOT])
        ann = fleet.operator(NAME)
        self.signer = RobotSigner(robot.private, os.urandom(8))
        self.admission = SignedAdmission(Settings(), fleet.trust, self.signer, lambda *_: 20_000_000)
        self.admission.now_s = NOW_S
        self.now_ns = 0
        self.begin_tick()
        assert isinstance(self.admission.introduce(ann.chain), HeldGrant)
        self.operator = OperatorProof(ann.private, ann.chain, fleet.trust, ROOT, lambda: NOW_S)
        key = keys.authority(ROOT, ROBOT)
        said = StatementReply(ok=True, reason=Reason.NONE, detail="", cure="", own=chain_text(robot.chain))
        payload = codec.encode(said)
        attachment = self.signer.reply(key, STATEMENT_REPLY_ENCODING, payload, b"who?")
        reply = Received(key, STATEMENT_REPLY_ENCODING, payload, attachment)
        assert self.operator.meet(ROBOT, reply, b"who?") is None
        self.acquire()

    def begin_tick(self) -> None:
        """Begin a tick, so that signatures are checked again."""
        self.now_ns += 10_000_000
        self.admission.begin_tick(self.now_ns)

    def ask(self, verb: str, payload: bytes, attachment: bytes, said: bytes) -> PendingReply:
        self.begin_tick()
        raw = RawRequest(1, verb, NAME, payload, len(payload), attachment=attachment)
        credentials = self.admission.admit(raw, self.now_ns).credentials
        assert credentials is not None
        assert credentials.reason is Reason.NONE
        return self.admission.reply(PendingReply(1, verb, said))

    def acquire(self) -> None:
        private = X25519PrivateKey.generate()
        payload = codec.encode(Acquire(public_key=public_bytes(private)))
        attachment = self.operator.request(ROBOT, "acquire", payload, CHALLENGE)
        given = LeaseReply(ok=True, reason=Reason.NONE, detail="", cure="", lease=LEASE, expires_s=2.0)
        reply = self.ask("acquire", payload, attachment, codec.encode(given))
        said = msgspec.msgpack.decode(reply.payload, type=LeaseReply)
        assert self.operator.begin_lease(ROBOT, private, said, reply.attachment)

    def judge(self, attachment: bytes, payload: bytes, verb: str = "drive") -> Callable[[], object]:
        """The step that judges a request without a reply."""
        raw = RawRequest(0, verb, NAME, payload, len(payload), attachment=attachment)
        return lambda: self.admission.admit(raw, self.now_ns)


def rows(rounds: int) -> list[Row]:
    parties = Parties()
    operator, signer = parties.operator, parties.signer
    drive = codec.encode(Drive(lease=LEASE, seq=1, challenge=CHALLENGE, speed_mps=0.3, angle_deg=1.0))
    proven = operator.drive(drive)
    admitted = parties.admission.admit(RawRequest(0, "drive", NAME, drive, len(drive), attachment=proven), 0)
    assert admitted.credentials is not None
    assert admitted.credentials.reason is Reason.NONE

    renewals = iter([operator.request(ROBOT, "renew", b"\x80", CHALLENGE) for _ in range(200 * rounds)])
    state_key = f"{ROOT}/{ROBOT}/{STATE.name}"
    state = codec.encode(STANDBY)
    signed = Received(state_key, STATE.encoding, state, signer.publication(state_key, STATE.encoding, state))
    assert operator.is_state(ROBOT, signed)

    state_us = cpu_us(lambda: signer.publication(state_key, STATE.encoding, state), 200, rounds)
    forged = proven[:-1] + bytes([proven[-1] ^ 1])
    elsewhere = proven[:1] + bytes(8) + proven[9:]
    judged = [
        ("judge a drive", proven, "under 8 us"),
        ("  refuse one without a proof", b"", "under 1 us"),
        ("  refuse one under an unknown lease", elsewhere, "under 1 us"),
        ("  refuse one with a wrong tag", forged, ""),
    ]
    return [
        *((name, _us(cpu_us(parties.judge(proof, drive), 10_000, rounds)), goal) for name, proof, goal in judged),
        (
            "judge a signed verb and sign its reply",
            _us(cpu_us(lambda: parties.ask("renew", b"\x80", next(renewals), b"\x80"), 200, rounds)),
            "",
        ),
        ("  acquire, both sides: signatures, keys, replies", _us(cpu_us(parties.acquire, 100, rounds)), ""),
        ("operator: prove a drive", _us(cpu_us(lambda: operator.drive(drive), 10_000, rounds)), ""),
        (
            "operator: sign a verb",
            _us(cpu_us(lambda: operator.request(ROBOT, "renew", b"\x80", CHALLENGE), 200, rounds)),
            "",
        ),
        (
            "operator: verify safety/state",
            _us(cpu_us(lambda: operator.is_state(ROBOT, signed), 200, rounds)),
            "",
        ),
        ("robot: sign safety/state", _us(state_us), ""),
        (f"  share of a core at {STATES_PER_S} Hz", f"{state_us * STATES_PER_S / 1e4:.2f} %", ""),
    ]


def _us(microseconds: float) -> str:
    return f"{microseconds:.2f} us" if microseconds < 10 else f"{microseconds:.0f} us"
