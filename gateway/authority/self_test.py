"""Self-test of a robot in signed mode before anybody engages it, as far as it needs no network. Pure.

An access control that is wrong is silent: Zenoh lets everybody pass where a rule, a name or a switch is missing,
and says nothing of it. So is a library that verifies anything.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.authority.admission import SignedAdmission
from gateway.authority.operator_proof import OperatorProof, new_lease_key
from gateway.authority.signer import RobotSigner
from gateway.command.flow import PendingReply
from gateway.command.request import RawRequest
from schemas.authority.proof import ProofKind, signed_bytes
from schemas.authority.statement import Grant, GrantRole, Signed, body_of
from schemas.authority.trust import Objection, Trust
from schemas.decisions import LeaseReply
from schemas.reasons import Reason
from schemas.requests import Acquire, Drive, Engage, Request
from schemas.settings import Settings
from schemas.subjects import BY_VERB
from schemas.zenoh_link import Json

UNDER_WAY: Final = "it is under way: 'cruiser why' says when it has passed"
"""The verdict of the test before there is one."""

OPERATOR: Final = "self-test"
LEASE: Final = 1
CHALLENGE: Final = bytes(8)
UNTIL_S: Final = 2**53 - 1
"""The grant of the test is over for no clock: what refuses it has to be a signature."""


def access_fault(access: dict[str, Json], tls: dict[str, Json]) -> str:
    """Return the first flaw that lets anybody pass a Zenoh configuration's access control or TLS; empty if none.

    Args:
        access: ``access_control``, as Zenoh read it.
        tls: ``transport/link/tls``, the same.
    """
    for where, section, name, wanted in (
        ("transport.link.tls", tls, "enable_mtls", True),
        ("transport.link.tls", tls, "verify_name_on_connect", True),
        ("access_control", access, "enabled", True),
        ("access_control", access, "default_permission", "deny"),
    ):
        if section.get(name) != wanted:
            return f"{where}.{name} is not {str(wanted).lower()}"
    subjects = access.get("subjects")
    if not isinstance(subjects, list) or not subjects:
        return "access_control.subjects names nobody"
    for subject in subjects:
        if not isinstance(subject, dict) or not subject.get("cert_common_names"):
            said = subject.get("id") if isinstance(subject, dict) else subject
            return f"the subject {said!a} of access_control has no cert_common_names, and so is everybody"
    return ""


def admission_fault(settings: Settings, trust: Trust) -> str:
    """Return the check that a wrongly signed request would pass; empty if there is none.

    Args:
        settings: for the robot's name and root.
        trust: the robot's.
    """
    return next((words for holds, words in _findings(settings, trust) if not holds), "")


def _findings(settings: Settings, trust: Trust) -> Iterator[tuple[bool, str]]:
    """Run the checks: yield for each True if it holds, and the fault that it is otherwise.

    An operator of an authority that nobody else knows asks for a lease, engages and drives: with the right proofs
    where that authority counts, with each of them wrong there, and with the right ones where the robot's counts.
    """
    authority, person, robot = (Ed25519PrivateKey.generate() for _ in range(3))
    grant = Grant(
        serial=1,
        name=OPERATOR,
        key=person.public_key().public_bytes_raw().hex(),
        role=GrantRole.OPERATOR,
        robots=[settings.robot.name],
        verbs=list(BY_VERB),
        not_before=0,
        not_after=UNTIL_S,
        epoch=trust.epoch,
    )
    body, key = body_of(grant), authority.public_key().public_bytes_raw()
    chain = [Signed(body, key, authority.sign(signed_bytes(ProofKind.STATEMENT, body)), grant)]
    own = Trust(key, key, epoch=trust.epoch)
    operator = OperatorProof(person, chain, own, settings.robot.root, lambda: 0)
    bench = _Bench(settings, operator, RobotSigner(robot, bytes(8)))
    door, other = bench.door(own), bench.door(trust)
    refused = [
        isinstance(other.introduce(chain), Objection),
        isinstance(door.introduce([_changed(chain[0])]), Objection),
    ]
    yield refused[0], "a grant of an authority that is not the robot's is accepted"
    yield refused[1], "a grant with a wrong signature is accepted"
    door.introduce(chain)
    engage = bench.asks("engage", Engage(lease=LEASE, challenge=CHALLENGE))
    damaged = _damaged(bench.asks("engage", Engage(lease=LEASE, challenge=CHALLENGE)))
    for at, asked, reason, words in (
        (other, engage, Reason.GRANT_UNKNOWN, "a verb that an unknown grant signed is accepted"),
        (door, engage, Reason.NONE, "a verb with the right signature is refused"),
        (door, engage, Reason.REPLAYED, "a verb is accepted twice"),
        (door, damaged, Reason.PROOF_WRONG, "a verb with a wrong signature is accepted"),
    ):
        yield bench.ruling(at, asked) is reason, words
    yield bench.begin_lease(door), "no lease is given for the right signature"
    drive = bench.drives()
    yield bench.ruling(door, drive) is Reason.NONE, "a drive command with the right tag is refused"
    wrong = bench.ruling(door, _damaged(drive)) is Reason.PROOF_WRONG
    yield wrong, "a drive command with a wrong tag is accepted"


class _Bench:
    """An operator, and the doors that it stands before."""

    def __init__(self, settings: Settings, operator: OperatorProof, signer: RobotSigner) -> None:
        self._settings = settings
        self._operator = operator
        self._signer = signer
        self._handle = 0

    def door(self, trust: Trust) -> SignedAdmission:
        return SignedAdmission(self._settings, trust, self._signer, lambda _challenge, _now_ns: 0)

    def asks(self, verb: str, request: Request) -> RawRequest:
        self._handle += 1
        payload = msgspec.msgpack.encode(request)
        attachment = self._operator.request(self._settings.robot.name, verb, payload, CHALLENGE)
        return RawRequest(self._handle, verb, OPERATOR, payload, len(payload), attachment=attachment)

    def drives(self) -> RawRequest:
        payload = msgspec.msgpack.encode(
            Drive(lease=LEASE, seq=1, challenge=bytes(8), speed_mps=0.0, angle_deg=0.0)
        )
        attachment = self._operator.drive(payload)
        return RawRequest(0, "drive", OPERATOR, payload, len(payload), attachment=attachment)

    def ruling(self, door: SignedAdmission, raw: RawRequest) -> Reason:
        door.begin_tick(0)
        credentials = door.admit(raw, 0).credentials
        return Reason.PROOF_MISSING if credentials is None else credentials.reason

    def begin_lease(self, door: SignedAdmission) -> bool:
        """Agree on the key of a lease."""
        private, public = new_lease_key()
        acquire = self.asks("acquire", Acquire(public_key=public))
        if self.ruling(door, acquire) is not Reason.NONE:
            return False
        given = msgspec.msgpack.encode(LeaseReply(ok=True, reason=Reason.NONE, detail="", cure="", lease=LEASE))
        reply = door.reply(PendingReply(acquire.handle, "acquire", given))
        said = msgspec.msgpack.decode(reply.payload, type=LeaseReply)
        return self._operator.begin_lease(self._settings.robot.name, private, said, reply.attachment)


def _changed(signed: Signed) -> Signed:
    return msgspec.structs.replace(signed, signature=_other(signed.signature))


def _damaged(raw: RawRequest) -> RawRequest:
    return msgspec.structs.replace(raw, attachment=_other(raw.attachment))


def _other(proof: bytes) -> bytes:
    """The same but for the last bit."""
    return proof[:-1] + bytes([proof[-1] ^ 1])
