"""When robots are believed, and what is signed for them."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from gateway.authority.operator_proof import KnownRobots, OperatorProof
from gateway.authority.session import RobotSigner, Unmet
from gateway.client.proof import (
    ASK_AGAIN_NS,
    CONFIRM_NS,
    SIGN_AGAIN_NS,
    Evidence,
    LinkProof,
    StopProof,
    stop_proof,
)
from gateway.telemetry.samples import Received
from schemas.authority.proof import GrantRole, RequestProof, chain_text
from schemas.authority.trust import fits
from schemas.decisions import StatementReply
from schemas.reasons import Reason
from schemas.settings import AuthoritySettings, Settings
from schemas.subjects import BY_NAME, BY_VERB, STATEMENT_REPLY_ENCODING
from tests.support.authority import CHALLENGE, NOW_S, Fleet, Party

MS = 1_000_000


def read(evidence: Evidence, *times_ms: int) -> bool:
    for time_ms in times_ms:
        evidence.add(time_ms * MS)
    return evidence.is_enough


@pytest.mark.parametrize(
    ("times_ms", "is_enough"),
    [
        ((0, 75, 150), True),
        ((0, 75, 149), False),
        ((0, 150), False),
        ((0,) * 100, False),
        ((0, 0, 0, 0, 5000, 5000, 5000), True),
    ],
    ids=["enough", "too briefly", "too few", "at once", "two late batches"],
)
def test_three_samples_in_150_ms_are_believed(times_ms: tuple[int, ...], *, is_enough: bool) -> None:
    assert CONFIRM_NS == 150 * MS
    assert read(Evidence(), *times_ms) is is_enough


def test_evidence_starts_over_after_a_contradiction_or_a_long_pause() -> None:
    evidence = Evidence(pause_max_ns=500 * MS)
    assert read(evidence, 0, 75, 150)
    evidence.clear()
    assert not read(evidence, 200, 210, 349)
    assert read(evidence, 350)
    assert not read(evidence, 851, 1352, 1853, 2354)
    assert read(evidence, 2400, 2900)


STOP = BY_VERB["stop"]
STATE = "fleet/cruiser-1/safety/state"


class FakeQuery:
    def __init__(self) -> None:
        self.replies: list[Received] = []
        self.is_over = False

    def poll(self) -> list[Received]:
        replies, self.replies = self.replies, []
        return replies


class FakePort:
    def __init__(self) -> None:
        self.asked: list[tuple[bytes, bytes, FakeQuery]] = []
        self.sent: list[tuple[str, str, bytes, bytes]] = []

    def begin_to_show(self, statement: bytes, question: bytes, _timeout_s: float) -> FakeQuery:
        self.asked.append((statement, question, FakeQuery()))
        return self.asked[-1][2]

    def put_signed(self, key: str, verb: str, payload: bytes, attachment: bytes) -> None:
        self.sent.append((key, verb, payload, attachment))


class Scene:
    """An operator who stops, a robot of the same fleet, and the clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_ns = 0
        monkeypatch.setattr("gateway.client.proof.time.monotonic_ns", lambda: self.now_ns)
        self.fleet, self.robot = Fleet(), Party("cruiser-1")
        self.fleet.authority.grant(self.robot, role=GrantRole.ROBOT, robots=["cruiser-1"])
        self.ann = self.fleet.operator()
        self.port: Any = FakePort()

    def operator(self) -> OperatorProof:
        return OperatorProof(self.ann.private, self.ann.chain, self.fleet.trust, "fleet", lambda: NOW_S)

    def signer(self, boot: bytes = b"boot no1") -> RobotSigner:
        return RobotSigner(self.robot.private, boot)

    def reply(self, question: bytes, boot: bytes = b"boot no1") -> Received:
        said = StatementReply(ok=True, reason=Reason.NONE, detail="", cure="", own=chain_text(self.robot.chain))
        payload, key = msgspec.msgpack.encode(said), "fleet/cruiser-1/@auth"
        attachment = self.signer(boot).reply(key, STATEMENT_REPLY_ENCODING, payload, question)
        return Received(key, STATEMENT_REPLY_ENCODING, payload, attachment)

    def state(self, sequence: int, boot: bytes = b"boot no1") -> Received:
        encoding, payload = BY_NAME["safety/state"].encoding, msgspec.msgpack.encode({"sequence": sequence})
        return Received(STATE, encoding, payload, self.signer(boot).publication(STATE, encoding, payload))


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Scene:
    return Scene(monkeypatch)


def test_a_stop_is_signed_for_each_robot_under_the_name_of_the_grant(scene: Scene) -> None:
    proof = StopProof(signer := scene.operator(), "fleet", signer)
    assert proof.name == "ann"
    for robot in ("cruiser-1", "cruiser-2", "cruiser-1"):
        proof.sign(scene.port, robot, CHALLENGE)
    scene.now_ns += SIGN_AGAIN_NS - 1
    proof.sign(scene.port, "cruiser-1", b"another.")
    scene.now_ns += 1
    proof.sign(scene.port, "cruiser-1", b"another.")
    assert [key for key, *_ in scene.port.sent] == [f"fleet/cruiser-{n}/@cmd/ann/stop" for n in (1, 2, 1)]
    challenges = []
    for key, verb, payload, attachment in scene.port.sent:
        said = RequestProof.read(attachment)
        assert said is not None
        assert (verb, payload, said.grant) == ("stop", b"", scene.ann.chain[0].id)
        assert fits(scene.ann.key, said.signature, said.signed(key, STOP.encoding, payload))
        challenges.append(said.challenge)
    assert challenges == [CHALLENGE, CHALLENGE, b"another."]


def test_who_has_no_key_signs_nothing(scene: Scene) -> None:
    proof = StopProof(KnownRobots(scene.fleet.trust, "fleet", lambda: NOW_S), "fleet")
    proof.sign(scene.port, "cruiser-1", CHALLENGE)
    assert (proof.name, scene.port.sent) == ("", [])
    proof.meet(scene.port)
    assert scene.port.asked[0][0] == b""


def test_the_reply_to_another_stop_is_none_to_this_one(scene: Scene) -> None:
    proof = StopProof(signer := scene.operator(), "fleet", signer)
    proof.meet(scene.port)
    scene.port.asked[0][2].replies = [scene.reply(scene.port.asked[0][1])]
    proof.meet(scene.port)
    yesterday, today = proof.attach("stop", b""), proof.attach("stop", b"")
    assert RequestProof.read(today) is None
    key, payload = "fleet/cruiser-1/@cmd/ann/stop", b"\x80"
    attachment = scene.signer().reply(key, STOP.reply_encoding, payload, yesterday)
    reply = Received(key, STOP.reply_encoding, payload, attachment)
    assert proof.is_reply(reply, yesterday)
    assert not proof.is_reply(reply, today)


def test_robots_are_asked_who_they_are_with_another_question_each_time(scene: Scene) -> None:
    proof = StopProof(signer := scene.operator(), "fleet", signer)
    proof.meet(scene.port)
    proof.meet(scene.port)
    ((_, former, query),) = scene.port.asked
    query.is_over = True
    scene.now_ns += ASK_AGAIN_NS - 1
    proof.meet(scene.port)
    assert len(scene.port.asked) == 1
    scene.now_ns += 1
    proof.meet(scene.port)
    assert len(scene.port.asked) == 2
    statement, question, query = scene.port.asked[1]
    assert (statement, question != former) == (signer.statement, True)
    query.replies = [scene.reply(former)]
    proof.meet(scene.port)
    assert not signer.has_met("cruiser-1")
    query.replies = [scene.reply(question)]
    proof.meet(scene.port)
    assert signer.has_met("cruiser-1")


def test_a_robot_is_asked_again_where_another_run_is_seen(scene: Scene) -> None:
    operator = scene.operator()
    operator.meet("cruiser-1", scene.reply(b"who?"), b"who?")
    proof = LinkProof(operator, "cruiser-1", "fleet")
    assert proof.believes(scene.state(5))
    proof.meet_again(scene.port)
    assert not scene.port.asked
    restarted = scene.state(0, b"boot no2")
    assert not proof.believes(restarted)
    proof.meet_again(scene.port)
    ((statement, question, query),) = scene.port.asked
    assert statement == operator.statement
    query.replies, query.is_over = [scene.reply(question, b"boot no2")], True
    proof.meet_again(scene.port)
    assert proof.believes(restarted)
    assert not proof.believes(scene.state(6))


def test_before_the_first_challenge_a_request_proves_nothing(scene: Scene) -> None:
    proof = LinkProof(scene.operator(), "cruiser-1", "fleet")
    first, second = proof.attach("stop", b""), proof.attach("stop", b"")
    assert first != second
    assert RequestProof.read(first) is None
    proof.challenge = CHALLENGE
    assert RequestProof.read(proof.attach("stop", b"")) is not None


def test_without_the_keys_of_the_authority_nothing_is_verified(scene: Scene) -> None:
    fault = Unmet(Reason.PROOF_MISSING, "authority.json is not there", "")
    proof = StopProof(fault, "fleet")
    proof.meet(scene.port)
    assert scene.port.asked == []
    assert proof.attach("stop", b"") != proof.attach("stop", b"")
    assert not proof.is_reply(scene.reply(b"question"), b"question")
    assert not proof.believes(scene.state(1))
    assert proof.doubt("cruiser-1") is fault


@pytest.mark.parametrize("who", ["operator", "viewer", "desk"])
def test_without_the_authoritys_file_the_cure_is_that_of_whose_machine_it_is(tmp_path: Path, who: str) -> None:
    (tmp_path / f"{who}-tls.key").write_text("")
    proof = stop_proof(Settings(authority=AuthoritySettings(mode="signed", directory=str(tmp_path))))
    assert proof is not None
    said = proof.doubt("cruiser-1").text
    assert said.startswith(f"{tmp_path / 'authority.json'} is not there; 'cruiser provision install'")
    assert f"({who}-NAME.bundle; " in said
    assert said.endswith(f"'cruiser provision renew {who}' asks for another")
