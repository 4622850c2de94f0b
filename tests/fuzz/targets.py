"""Targets of the fuzzer: functions of untrusted bytes, each with valid seeds and a rule.

A target raises if its rule is broken: an unexpected exception, an unsigned statement accepted, a value that is not
restored from its own bytes. Keys are derived from names, so that every process has the same.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from io import BytesIO
from typing import Any, Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.admission import SignedAdmission
from gateway.authority.operator_proof import OperatorProof
from gateway.authority.session import RobotSigner
from gateway.cli import decode
from gateway.cli.desk_server import Hub
from gateway.command.flow import PendingReply
from gateway.command.rulings import RawRequest
from gateway.telemetry.samples import Received
from recorder.mcap import recovery
from recorder.mcap.reader import is_mcap, read_pieces
from recorder.mcap.summary_reader import read_summary
from recorder.record.orders import Orders
from recorder.record.recorder import Recorder
from schemas import codec, keys
from schemas.authority.proof import (
    DriveProof,
    GrantRole,
    RequestProof,
    RobotProof,
    StatementFault,
    chain_text,
    read_chain,
)
from schemas.authority.trust import HeldGrant, Trust
from schemas.codec import PayloadFault
from schemas.decisions import EventKind, LeaseReply, StatementReply
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.recording import Mark
from schemas.requests import Acquire, Drive, Request
from schemas.settings import Settings
from schemas.subjects import (
    ALL_SUBJECTS,
    ALL_VERBS,
    BY_VERB,
    RECORDER_COMMANDS,
    STATEMENT_REPLY_ENCODING,
    SUBJECTS,
    Subject,
    Verb,
)
from tests.support.authority import CHALLENGE, NOW_S, AuthorityBench, Fleet, Party
from tests.support.fakes.desk import FakeCommandPort, FakeDeskListener
from tests.support.fakes.recording import RECORDER_PLAN, FakeAsked, MemoryWriter
from tests.support.logs import foreign_log, gears, own_log, small_log
from tests.support.messages import (
    STANDBY,
    WALL_NS,
    FakeSample,
    batch,
    feedback,
    gear,
    info,
    key_of,
    recorder_health,
    safety_event,
    sample_of,
)
from tests.support.walking import walk

ROOT, ROBOT = "fleet", "cruiser-1"
BOOT: Final = b"boot no1"
LEASE: Final = 4711
NS: Final = 1_000_000_000


class Target(msgspec.Struct, frozen=True):
    name: str
    run: Callable[[bytes], None]
    seeds: Sequence[bytes]


# Who signs. Keys that are the same in each process.


def _key_of(name: str) -> bytes:
    return hashlib.sha256(name.encode()).digest()


def _known(party: Party) -> Party:
    party.private = Ed25519PrivateKey.from_private_bytes(_key_of(party.name))
    return party


def _fleet() -> Fleet:
    fleet = Fleet()
    for party in (fleet.authority, fleet.standby):
        _known(party)
    fleet.trust = Trust(fleet.authority.key, fleet.standby.key)
    return fleet


FLEET: Final = _fleet()
ANN, ROBOT_PARTY = _known(Party("ann")), _known(Party(ROBOT))
FLEET.authority.grant(ANN, speed_limit_mps=0.5)
FLEET.authority.grant(ROBOT_PARTY, role=GrantRole.ROBOT, robots=[ROBOT])
SIGNED: Final = {
    one.body: one
    for one in (
        *ANN.chain,
        *ROBOT_PARTY.chain,
        FLEET.authority.revoke(1, keys=(bytes(32),)),
        FLEET.standby.rotate(1, FLEET.standby, FLEET.authority),
    )
}
"""All signed statements."""


def _age(challenge: bytes, _now_ns: int) -> int | Reason:
    return 20_000_000 if challenge == CHALLENGE else Reason.CHALLENGE_UNKNOWN


# The targets.


def statements(data: bytes) -> None:
    """A chain that is read has the same text again; only signed grants are valid."""
    chain = read_chain(data)
    if isinstance(chain, StatementFault):
        return
    assert read_chain(chain_text(chain).encode()) == chain
    held = FLEET.trust.judge(chain, NOW_S)
    if isinstance(held, HeldGrant):
        assert all(one.body in SIGNED for one in chain)
        assert held.grant.speed_limit_mps == (0.5 if held.key == ANN.key else None)
    for change in (FLEET.trust.revoke, FLEET.trust.rotate):
        if isinstance(change(chain[0]), Trust):
            assert chain[0].body in SIGNED


def shown(data: bytes) -> None:
    """A robot replies to every statement, and accepts signed ones only."""
    text = data.decode("utf-8", "replace")
    bench = AuthorityBench(FLEET)
    said = bench.show(text)
    if said.ok:
        chain = read_chain(text.encode())
        assert not isinstance(chain, StatementFault)
        assert chain[0].body in SIGNED
    bench.tick()


def attachments(data: bytes) -> None:
    """A proof that is read has the same bytes again."""
    for kind in (RequestProof, DriveProof, RobotProof):
        proof = kind.read(data)
        assert proof is None or proof.attachment() == data


class _Door:
    """A robot's admission that knows ann and gave ann a lease."""

    def __init__(self) -> None:
        self.admission = SignedAdmission(
            Settings(),
            FLEET.trust,
            RobotSigner(ROBOT_PARTY.private, BOOT),
            _age,
            lambda: X25519PrivateKey.from_private_bytes(_key_of("lease")),
        )
        self.admission.now_s = NOW_S
        self.operator = OperatorProof(ANN.private, ANN.chain, FLEET.trust, ROOT, lambda: NOW_S, bytes)
        self.now_ns = 0
        self.begin_tick()
        assert isinstance(self.admission.introduce(ANN.chain), HeldGrant)
        private = X25519PrivateKey.from_private_bytes(_key_of("operator"))
        request = codec.encode(Acquire(public_key=private.public_key().public_bytes_raw()))
        attachment = self.operator.request(ROBOT, "acquire", request, CHALLENGE)
        self.admission.admit(RawRequest(1, "acquire", "ann", request, len(request), attachment=attachment), 0)
        self.reply = self.admission.reply(PendingReply(1, "acquire", LEASE_REPLY))
        said = msgspec.msgpack.decode(self.reply.payload, type=LeaseReply)
        assert self.operator.begin_lease(ROBOT, private, said, self.reply.attachment)
        self.begin_tick()

    def begin_tick(self) -> None:
        """Begin a tick so much later that all nonces are forgotten."""
        self.now_ns += 10 * NS
        self.admission.begin_tick(self.now_ns)


LEASE_REPLY: Final = codec.encode(
    LeaseReply(ok=True, reason=Reason.NONE, detail="", cure="", lease=LEASE, expires_s=2.0)
)
DOOR: Final = _Door()
DRIVE: Final = codec.encode(Drive(lease=LEASE, seq=1, challenge=CHALLENGE, speed_mps=0.3, angle_deg=0.0))
VERBS: Final = (*BY_VERB, "nonsense", "")
OPERATORS: Final = ("ann", "bob", "")


def _request(verb: str, operator: str, attachment: bytes, payload: bytes) -> bytes:
    return bytes([VERBS.index(verb), OPERATORS.index(operator), len(attachment)]) + attachment + payload


PROVEN: Final = {
    ("drive", "ann", DOOR.operator.drive(DRIVE), DRIVE),
    *(
        (verb, "ann", DOOR.operator.request(ROBOT, verb, payload, CHALLENGE)[:89], payload)
        for verb in BY_VERB
        if verb != "drive"
        for payload in (b"", b"\x80")
    ),
}
"""All requests that ann signed, up to their signatures."""


def requests(data: bytes) -> None:
    """Only requests that ann signed are accepted, and every query gets a reply."""
    if len(data) < 3:
        return
    verb, operator = VERBS[data[0] % len(VERBS)], OPERATORS[data[1] % len(OPERATORS)]
    attachment, payload = data[3 : 3 + data[2]], data[3 + data[2] :]
    raw = RawRequest(7, verb, operator, payload, len(payload), attachment=attachment)
    DOOR.begin_tick()
    DOOR.admission.may_be_holders(verb, payload, attachment)
    credentials = DOOR.admission.admit(raw, DOOR.now_ns).credentials
    assert credentials is not None
    # The tag after a verb's signature gives priority only, so any tag is as good as none.
    signed = attachment[:89] if len(attachment) == 105 else attachment
    is_proven = (verb, operator, signed, payload) in PROVEN
    # A drive's tag is checked with the lease's key; the arbiter compares the operator's name.
    is_proven |= verb == "drive" and (verb, "ann", attachment, payload) in PROVEN
    assert (credentials.reason is Reason.NONE) == is_proven, (verb, operator, credentials)
    DOOR.admission.reply(PendingReply(7, verb, b"\x80" if verb not in {"acquire", "take"} else REFUSED_LEASE))


REFUSED_LEASE: Final = codec.encode(LeaseReply(ok=False, reason=Reason.LEASE_HELD, detail="", cure=""))


def _met() -> tuple[OperatorProof, Received]:
    payload = codec.encode(StatementReply(True, Reason.NONE, "", "", own=chain_text(ROBOT_PARTY.chain)))  # noqa: FBT003
    signer = RobotSigner(ROBOT_PARTY.private, BOOT)
    key = keys.authority(ROOT, ROBOT)
    reply = Received(
        key, STATEMENT_REPLY_ENCODING, payload, signer.reply(key, STATEMENT_REPLY_ENCODING, payload, QUESTION)
    )
    return OperatorProof(ANN.private, ANN.chain, FLEET.trust, ROOT, lambda: NOW_S), reply


QUESTION: Final = b"who?"
OPERATOR, MEETING = _met()
assert OPERATOR.meet(ROBOT, MEETING, QUESTION) is None
STATE: Final = RobotSigner(ROBOT_PARTY.private, BOOT).publication("fleet/cruiser-1/safety/state", "e", b"state")


def replies(data: bytes) -> None:
    """An operator accepts only what the robot signed."""
    if not data:
        return
    attachment, payload = data[1 : 1 + data[0]], data[1 + data[0] :]
    newcomer = OperatorProof(ANN.private, ANN.chain, FLEET.trust, ROOT, lambda: NOW_S)
    newcomer.meet(ROBOT, msgspec.structs.replace(MEETING, payload=payload, attachment=attachment), QUESTION)
    assert newcomer.has_met(ROBOT) == ((payload, attachment) == (MEETING.payload, MEETING.attachment))
    state = Received("fleet/cruiser-1/safety/state", "e", payload, attachment)
    assert OPERATOR.is_state(ROBOT, state) == ((payload, attachment) == (b"state", STATE))
    assert not OPERATOR.is_reply(ROBOT, state, attachment)


def payloads(data: bytes) -> None:
    """A payload that is read is restored from its own bytes."""
    if not data:
        return
    kind = KINDS[data[0] % len(KINDS)]
    read = _decoded(kind, data[1:])
    if not isinstance(read, PayloadFault):
        written = codec.encode(read)
        again = _decoded(kind, written)
        assert not isinstance(again, PayloadFault), again
        assert codec.encode(again) == written


def _decoded(kind: Subject | Verb[Any], payload: bytes) -> Message | Request | PayloadFault:
    return codec.decode(kind, payload) if isinstance(kind, Subject) else codec.decode_request(kind, payload)


def key_expressions(data: bytes) -> None:
    """A key that is parsed is built again from its parts."""
    key = data.decode("utf-8", "replace")
    parts = keys.parse(key)
    if parts is not None and parts.robot:
        assert keys.build(parts.root, parts.robot, parts.subject, parts.bus) == key
    elif parts is not None:
        assert keys.of_recorder(parts.root, parts.recorder, parts.subject.name) == key
    operator, verb = keys.parse_command(key)
    if operator:
        assert keys.command("fleet", "cruiser-1", operator, verb).endswith(f"/{operator}/{verb}")
    assert "/" not in verb
    assert not verb or key.endswith(f"/{verb}")
    robot = keys.robot_of_liveliness("fleet", key)
    assert robot is None or keys.liveliness("fleet", robot) == key


def candump_lines(data: bytes) -> None:
    """Lines of candump give frames that a bus can carry."""
    line = decode.parse(data.decode("utf-8", "replace"))
    if line is not None:
        assert len(line.frame.data) <= 64
        assert line.time_ns is None or 0 <= line.time_ns < 10**19


def logs(data: bytes) -> None:
    """A log in any state can be read, by its summary too, and copied without losing a good message."""
    stream, size = BytesIO(data), len(data)
    survey = recovery.survey(stream, size)
    assert 0 <= survey.end <= size
    read_summary(stream)
    if not is_mcap(stream):
        return
    for is_verifying in (True, False):
        for _ in read_pieces(stream, size, is_verifying=is_verifying):
            pass
    for _ in walk(stream, size):
        pass
    copy = BytesIO()
    recovery.copy_good(stream, size, copy, "fuzz")
    assert recovery.survey(copy, len(copy.getvalue())).messages == survey.messages


def orders(data: bytes) -> None:
    """Each request to a recorder gets one reply."""
    if not data:
        return
    recorder, writer = Recorder(RECORDER_PLAN), MemoryWriter()
    writer.apply(recorder.receive([sample_of(gear(0))], 0))
    desk = Orders(recorder, lambda: recorder_health(recorder.state), lambda: True)
    verb = RECORDER_COMMANDS[data[0] % len(RECORDER_COMMANDS)]
    asked = FakeAsked(codec.decode_request(verb, data[1:]))
    writer.apply(desk.handle(asked.asked, 0, WALL_NS))
    desk.tick(10 * NS)
    assert len(asked.replies) == 1


def samples(data: bytes) -> None:
    """A recorder records whatever a sample contains."""
    if not data:
        return
    recorder, writer = Recorder(RECORDER_PLAN), MemoryWriter()
    subject = SUBJECTS[data[0] % len(SUBJECTS)]
    for sequence in range(2):
        sample = FakeSample(key_of(subject.type), subject.encoding, data[1:], source=("publisher", sequence))
        writer.apply(recorder.receive([sample], sequence * NS))
    writer.apply(recorder.tick(3 * NS, WALL_NS, {}))


def browsers(data: bytes) -> None:
    """A browser's message goes to one robot, under one name, by one verb."""
    listener, port = FakeDeskListener(), FakeCommandPort()
    hub = Hub(Settings(), listener, port)  # type: ignore[arg-type]
    browser = hub.join()
    with suppress(RuntimeError):  # The outcome of a stop is waited for in a loop, and there is none.
        hub.receive(browser, data)
    hub.step(NS)
    browser.outbox.take()
    for key, *_ in (*port.puts, *port.questions):
        robot, _, rest = key.removeprefix(f"{ROOT}/").partition("/")
        assert re.fullmatch(r"[a-z0-9-]+", robot) or (robot == keys.ALL and rest.endswith("/stop")), key
        assert re.fullmatch(r"@auth|@cmd/[A-Za-z0-9_.-]+/[a-z_]+", rest), key


# All of them, with their seeds.


MESSAGES: Final = (STANDBY, gear(0), info(), safety_event(EventKind.ENGAGED), batch(0, [(WALL_NS, feedback(0))]))
KINDS: Final[tuple[Subject | Verb[Any], ...]] = (*ALL_SUBJECTS, *ALL_VERBS)
ORDERS: Final = (b"\x80", codec.encode(Mark("", "it swerved")))


def _place(message: object, of: Sequence[Subject]) -> bytes:
    return bytes([next(number for number, one in enumerate(of) if one.type is type(message))])


SEEDS: Final[dict[Callable[[bytes], None], Sequence[bytes]]] = {
    statements: [
        chain_text(ANN.chain).encode(),
        *(one.text().encode() for one in SIGNED.values()),
        b"# nothing\n",
    ],
    shown: [chain_text(ANN.chain).encode(), *(one.text().encode() for one in SIGNED.values())],
    attachments: sorted({proven[2] for proven in PROVEN} | {STATE}),
    requests: sorted(_request(*proven) for proven in PROVEN),
    replies: [
        bytes([len(attachment)]) + attachment + payload
        for attachment, payload in ((MEETING.attachment, MEETING.payload), (STATE, b"state"))
    ],
    payloads: [
        *(bytes([number, 0x80]) for number in range(len(KINDS))),
        *(_place(one, ALL_SUBJECTS) + codec.encode(one) for one in MESSAGES),
        bytes([KINDS.index(BY_VERB["drive"])]) + DRIVE,
    ],
    key_expressions: [
        *(key_of(subject.type).encode() for subject in SUBJECTS),
        b"fleet/@recorder/depot/health",
        b"fleet/cruiser-1/@cmd/ann/drive",
        b"fleet/cruiser-1/gateway",
        b"fleet/cruiser-1/state\n",
        b"fleet/cruiser-1/@cmd/first/stop\n",
        b"fleet/cruiser-1/@cmd/*/stop",
        b"fleet/@cmd/first/@cmd/second/stop",
    ],
    candump_lines: [
        b"(1436509052.249713) vcan0 18C4D1EF#0104000000000005",
        b"(1436509052.249713) vcan0 123#R8",
        b"(1436509052.249713) vcan0 123##1112233 T",
        b"  vcan0  18C4D1EF   [8]  01 04 00 00 00 00 00 05",
        b" (1436509052.249713)  vcan0  RX B -  18C4D1EF  [02]  01 04   '..'",
    ],
    logs: [small_log(), own_log([gears(0, 3, 100), gears(3, 3, 200)]), foreign_log()],
    orders: [bytes([number]) + payload for number in range(len(RECORDER_COMMANDS)) for payload in ORDERS],
    browsers: [
        msgspec.msgpack.encode({"robot": ROBOT, "operator": "ann", **said})
        for said in (
            {"is": "ask", "number": 1, "verb": "acquire", "payload": b"\x80", "attachment": b""},
            {"is": "drive", "payload": DRIVE, "attachment": bytes(25)},
            {"is": "stop"},
            {"is": "request"},
            {"is": "answer", "asker": "bob", "granted": True},
            {"is": "acknowledge", "word": "latched"},
        )
    ],
    samples: [_place(one, SUBJECTS) + codec.encode(one) for one in MESSAGES],
}
TARGETS: Final = [Target(run.__name__, run, seeds) for run, seeds in SEEDS.items()]

BY_NAME: Final = {target.name: target for target in TARGETS}
