"""``cruiser provision show`` against robots on loopback, which judge as the gateway does."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import zenoh

from gateway.authority.admission import SignedAdmission
from gateway.authority.robot_authority import Kept, RobotAuthority, TimeFloor
from gateway.authority.session import RobotSigner
from gateway.command.flow import PendingReply
from gateway.command.rulings import RawRequest
from schemas.authority.key_files import read_identity
from schemas.command_line import ExitCode
from schemas.reasons import Reason
from schemas.settings import AuthoritySettings, RobotSettings, Settings
from schemas.subjects import STATEMENT_REPLY_ENCODING, TEXT_MAX_BYTES
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.provisioning import ProvisionedFleet, run

CHALLENGE = b"newest.."


class FakeRobot:
    """A robot's authority on Zenoh: its token, its challenge, and its answers to statements.

    Attributes:
        kept: what it answers in place of anything else: an answer to a question of before.
        drops: so many queries it leaves unanswered, as one that is flooded does.
    """

    def __init__(self, session: zenoh.Session, directory: Path, name: str) -> None:
        identity = read_identity(directory, "robot")
        settings = Settings(robot=RobotSettings(name=name), authority=AuthoritySettings(mode="signed"))
        signer = RobotSigner(identity.private, b"boot no1")
        admission = SignedAdmission(settings, identity.trust, signer, self._age)
        floor = TimeFloor(0, time.monotonic_ns())
        self.authority = RobotAuthority(settings, admission, signer, floor, identity.chain, Kept())
        self.name = name
        self.kept: PendingReply | None = None
        self.drops = 0
        self._tick()
        self._ends = threading.Event()
        self._session = session
        self._token = session.liveliness().declare_token(f"fleet/{name}/gateway")
        self._queries = session.declare_queryable(
            f"fleet/{name}/@auth", zenoh.handlers.RingChannel(16), complete=True
        )
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def answer(self, text: bytes, question: bytes) -> PendingReply:
        """What it says to a statement."""
        raw = RawRequest(1, "", "", text, min(len(text), TEXT_MAX_BYTES), attachment=question)
        return self.authority.receive(raw, time.monotonic_ns())

    def close(self) -> None:
        self._ends.set()
        self._thread.join()
        self._token.undeclare()
        self._queries.undeclare()

    @staticmethod
    def _age(challenge: bytes, _now_ns: int) -> int | Reason:
        return 0 if challenge == CHALLENGE else Reason.CHALLENGE_UNKNOWN

    def _tick(self) -> None:
        now_ns = time.monotonic_ns()
        self.authority.tick(now_ns, now_ns, time.time_ns())

    def _run(self) -> None:
        state = msgspec.msgpack.encode({"challenge": CHALLENGE})
        while not self._ends.wait(0.01):
            self._tick()
            self._session.put(f"fleet/{self.name}/safety/state", state)
            query = self._queries.try_recv()
            if query is None:
                continue
            if self.drops:
                self.drops -= 1
                query.drop()
                continue
            with query:
                payload = b"" if query.payload is None else query.payload.to_bytes()
                question = b"" if query.attachment is None else query.attachment.to_bytes()
                reply = self.kept or self.answer(payload, question)
                query.reply(
                    f"fleet/{self.name}/@auth",
                    reply.payload,
                    encoding=STATEMENT_REPLY_ENCODING,
                    attachment=reply.attachment,
                )


class Fleet(ProvisionedFleet):
    """A fleet with two robots on Zenoh, and ann, who is an operator."""

    def __init__(self, place: Path, endpoint: str, session: zenoh.Session) -> None:
        super().__init__(place)
        self.endpoint = endpoint
        self.ann = self.let_in("operator", "ann")
        names = ("cruiser-1", "cruiser-2")
        self.robots = {name: FakeRobot(session, self.let_in("robot", name), name) for name in names}


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    """On plain TCP: who may send is tested elsewhere."""
    monkeypatch.chdir(tmp_path)
    endpoint = free_endpoint()
    with Peer(endpoint) as peer:
        found = Fleet(tmp_path, endpoint, peer.session)
        # The certificates' file names a router that is not there.
        for file in tmp_path.rglob("operator.json5"):
            file.unlink()
        try:
            yield found
        finally:
            for robot in found.robots.values():
                robot.close()


def tell(fleet: Fleet, *words: str, where: str = "ann") -> int:
    return run(*words, "--connect", fleet.endpoint, "--directory", fleet.place / where, "--timeout", "2")


def test_each_robot_says_what_became_of_it(fleet: Fleet, capsys: pytest.CaptureFixture[str]) -> None:
    """Taken over; known already; refused, with the cure; no answer: each with its exit code."""
    run("revoke", "ann", "--directory", fleet.place / "authority", "-o", "one.statement")
    run("revoke", "--key", "0" * 64, "--directory", fleet.place / "authority", "-o", "two.statement")
    capsys.readouterr()
    assert tell(fleet, "show", "operator-ann.bundle", "--all") == ExitCode.OK
    assert capsys.readouterr().out == "cruiser-1: taken over\ncruiser-2: taken over\n"
    assert tell(fleet, "show", "two.statement", "--robot", "cruiser-1") == ExitCode.OK
    assert tell(fleet, "show", "one.statement", "--all") == ExitCode.OK
    out = capsys.readouterr().out
    assert "cruiser-1: has it, or a newer one" in out
    assert "cruiser-2: taken over" in out
    assert tell(fleet, "show", "operator-ann.bundle", "--all") == ExitCode.REFUSED
    assert "cruiser-1: refused: the grant was revoked" in capsys.readouterr().out
    assert tell(fleet, "show", "two.statement", "--robot", "cruiser-9") == ExitCode.UNREACHABLE
    both = ("--robot", "cruiser-1", "--robot", "cruiser-9")
    assert tell(fleet, "show", "two.statement", *both) == ExitCode.PARTIAL


def test_a_robot_that_leaves_queries_unanswered_is_asked_again(
    fleet: Fleet, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that is flooded has no time for all of them, and each that it drops ends at once."""
    run("revoke", "ann", "--directory", fleet.place / "authority", "-o", "one.statement")
    capsys.readouterr()
    fleet.robots["cruiser-1"].drops = 5
    assert tell(fleet, "show", "one.statement", "--robot", "cruiser-1") == ExitCode.OK
    assert capsys.readouterr().out == "cruiser-1: taken over\n"
    assert fleet.robots["cruiser-1"].drops == 0


def test_an_answer_of_before_is_not_believed(fleet: Fleet, capsys: pytest.CaptureFixture[str]) -> None:
    """Else whoever keeps a revocation from a robot would let it seem to have it."""
    robot = fleet.robots["cruiser-1"]
    ann = (fleet.place / "ann" / "operator.grant").read_bytes()
    robot.kept = robot.answer(ann, b"asked yesterday.")
    assert tell(fleet, "show", "operator-ann.bundle", "--robot", "cruiser-1") == ExitCode.FAILURE
    assert "cruiser-1: yes, and the answer is not proven" in capsys.readouterr().out
