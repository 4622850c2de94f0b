"""The belief in robots: samples that agree for a while, and in signed mode what they signed.

Anyone on its network can forge a robot's samples. A robot that is not so says otherwise many times a second.
Whoever reads must see all of that: a sample that is lost may be the one that contradicts. Samples may be read late
and many at once. Each has the time when it is read: what was delivered until then is read in the same batch,
before anything is believed.
"""

from __future__ import annotations

import logging
import time
from math import inf
from pathlib import Path
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.enrolment import TLS_KEY_FILE
from gateway.authority.operator_proof import KnownRobots, OperatorProof, ViewerProof, new_lease_key, new_question
from gateway.authority.session import SILENT, Unmet
from gateway.provisioning.key_files import check_tls_files
from gateway.telemetry.samples import Received
from gateway.zenoh.client import PendingQuery
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.authority.key_files import KEY_FILE, directory_of, read_identity, read_trust
from schemas.authority.trust import Objection
from schemas.command_line import CommandError
from schemas.decisions import LeaseReply
from schemas.reasons import Reason
from schemas.requests import Acquire, Request, Take
from schemas.settings import Settings
from schemas.subjects import DRIVE_VERB, STOP_VERB

CONFIRM_NS: Final = 150_000_000  # time over which a robot's states must agree to be believed
CONFIRM_SAMPLES: Final = 3  # samples in which it must say so: anyone can put a false one between the robot's own


class Evidence:
    """Samples that say the same, until there are enough of them to be believed."""

    def __init__(self, pause_max_ns: float = inf) -> None:
        """Begin with none.

        Args:
            pause_max_ns: samples before a longer pause prove nothing any more.
        """
        self._pause_max_ns = pause_max_ns
        self._count = self._first_ns = self._last_ns = 0

    def add(self, now_ns: int) -> bool:
        """One more, read now. Whether they are enough."""
        if not self._count or now_ns - self._last_ns > self._pause_max_ns:
            self._count, self._first_ns = 0, now_ns
        self._count, self._last_ns = self._count + 1, now_ns
        return self.is_enough

    @property
    def is_enough(self) -> bool:
        return self._count >= CONFIRM_SAMPLES and self._last_ns - self._first_ns >= CONFIRM_NS

    def clear(self) -> None:
        """A sample says otherwise, or some may be missing."""
        self._count = 0


log = logging.getLogger(__name__)

SHOW_TIMEOUT_S: Final = 1.0  # a robot answers a statement within a few ticks of 10 ms
ASK_AGAIN_NS: Final = 250_000_000
"""The shortest time between two queries for a robot's identity: somebody may repeat samples of a former run."""

WITHOUT_GRANT: Final = ("viewer", "desk")  # roles of machines that have a certificate, and no key that signs
SIGN_AGAIN_NS: Final = 250_000_000  # a stop is signed again for the same robot after this time: a put may be lost


class _Meeting:
    """Asks robots who they are, without waiting, each time with a question of its own."""

    def __init__(self, robots: KnownRobots, root: str) -> None:
        self._robots = robots
        self._root = root
        self._query: PendingQuery | None = None
        self._question = b""
        self._asked_ns = -ASK_AGAIN_NS

    def step(self, commands: CommandPort, statement: bytes, *, is_wanted: bool) -> None:
        """Read the replies that have come, and ask again if that is wanted, and time."""
        if self._query is not None:
            for received in self._query.poll():
                self._robots.meet(robot_of(received, self._root), received, self._question)
        now_ns = time.monotonic_ns()
        is_due = (self._query is None or self._query.is_over) and now_ns - self._asked_ns >= ASK_AGAIN_NS
        if not is_wanted or not is_due:
            return
        self._asked_ns, self._question = now_ns, new_question()
        try:
            self._query = commands.begin_to_show(statement, self._question, SHOW_TIMEOUT_S)
        except CommandError as error:
            log.debug("who the robots are could not be asked: %s", error)


def robot_of(received: Received, root: str) -> str:
    return received.key.removeprefix(f"{root}/").partition("/")[0]


def operator_proof(settings: Settings) -> OperatorProof | ViewerProof | None:
    """The operator's key and grant, in signed mode; of a viewer's or a desk's machine what verifies robots."""
    if settings.authority.mode != "signed":
        return None
    directory = directory_of(settings.authority)
    is_operators = (directory / KEY_FILE.format(who="operator")).exists()
    if not is_operators and any((directory / TLS_KEY_FILE.format(who=who)).exists() for who in WITHOUT_GRANT):
        return ViewerProof(read_trust(directory, _whose(directory)), settings.robot.root, _now_s)
    identity = read_identity(directory, "operator")
    if settings.zenoh.config:
        warning = check_tls_files(Path(settings.zenoh.config), "operator", time.time())
        if warning:
            log.warning("%s", warning)
    return OperatorProof(identity.private, identity.chain, identity.trust, settings.robot.root, _now_s)


class LinkProof:
    """Signs commands to one robot, and verifies its replies and samples.

    Attributes:
        challenge: the newest one that the robot published; empty before the first.
    """

    def __init__(self, proof: OperatorProof | ViewerProof, robot: str, root: str) -> None:
        self.challenge = b""
        self._proof = proof
        self._robot = robot
        self._lease_key: X25519PrivateKey | None = None
        self._meeting = _Meeting(proof, root)

    def meet(self, commands: CommandPort) -> Objection | None:
        """Show the robot the operator's grant. Returns why it does not take it, or is no robot of the fleet."""
        refusal: Objection | None = Objection(
            Reason.PROOF_MISSING, "it does not answer on @auth: is it in signed mode?"
        )
        question = new_question()
        for received in commands.show(self._proof.statement, question, SHOW_TIMEOUT_S):
            refusal = self._proof.meet(self._robot, received, question)
            if refusal is None:
                return None
        return refusal

    @property
    def unmet(self) -> Unmet:
        return self._proof.unmet(self._robot) or SILENT

    def doubt(self, robot: str) -> Unmet:
        return self._proof.doubt(robot)

    def meet_again(self, commands: CommandPort) -> None:
        """If samples of another run of the robot arrive, ask which run is the present one, without waiting."""
        self._meeting.step(commands, self._proof.statement, is_wanted=self._proof.is_to_meet_again(self._robot))

    def with_key(self, request: Request) -> Request:
        """The request, with a new public key if it is for a lease."""
        if not isinstance(request, Acquire | Take):
            return request
        self._lease_key, public = new_lease_key()
        return msgspec.structs.replace(request, public_key=public)

    def begin_lease(self, reply: LeaseReply, attachment: bytes) -> bool:
        """Agree with the robot on the key of the lease that it gave; False if its reply has no key."""
        private, self._lease_key = self._lease_key, None
        return private is None or self._proof.begin_lease(self._robot, private, reply, attachment)

    def attach(self, verb: str, payload: bytes) -> bytes:
        """The attachment of a command. Before the first challenge it proves nothing: a stop needs no proof."""
        if verb == DRIVE_VERB:
            return self._proof.drive(payload)
        if not self.challenge:
            return new_question()
        return self._proof.request(self._robot, verb, payload, self.challenge)

    def is_reply(self, received: Received, request: bytes) -> bool:
        return self._proof.is_reply(self._robot, received, request)

    def believes(self, received: Received) -> bool:
        return self._proof.believes(self._robot, received)


class StopProof:
    """Believes of a stop only what the robots signed, and signed for it.

    The stop itself goes out without a proof, at once. Who has a key and a grant signs it besides, as soon as a
    robot says a challenge: so the record says who it was. Nothing here raises, or is waited for.

    Attributes:
        name: of the operator, by the grant; empty without one.
        may_stop_all: the certificate lets its holder stop all robots at once; a viewer's stops one by its name.
    """

    def __init__(
        self,
        robots: KnownRobots | Unmet,
        root: str,
        signer: OperatorProof | None = None,
        *,
        may_stop_all: bool = True,
    ) -> None:
        """With no robot met.

        Args:
            robots: the trusted robots; the signer itself, if there is one. Or why no robot can be verified.
            may_stop_all: the certificate lets its holder stop all robots at once.
        """
        self.name = "" if signer is None else signer.name
        self.may_stop_all = may_stop_all
        self._fault = robots if isinstance(robots, Unmet) else None
        self._robots = None if isinstance(robots, Unmet) else robots
        self._signer = signer
        self._root = root
        self._meeting = None if self._robots is None else _Meeting(self._robots, root)
        self._signed_ns: dict[str, int] = {}

    def meet(self, commands: CommandPort) -> None:
        """Ask the robots who they are, again and again, and show them the grant, if there is one."""
        if self._meeting is not None:
            self._meeting.step(commands, b"" if self._signer is None else self._signer.statement, is_wanted=True)

    def doubt(self, robot: str) -> Unmet:
        return self._fault or (SILENT if self._robots is None else self._robots.doubt(robot))

    def sign(self, commands: CommandPort, robot: str, challenge: bytes) -> None:
        """Send a robot a signed stop, now and then: it published this challenge."""
        now_ns = time.monotonic_ns()
        if self._signer is None or now_ns - self._signed_ns.get(robot, -SIGN_AGAIN_NS) < SIGN_AGAIN_NS:
            return
        self._signed_ns[robot] = now_ns
        attachment = self._signer.request(robot, STOP_VERB, b"", challenge)
        commands.put_signed(keys.command(self._root, robot, self.name, STOP_VERB), STOP_VERB, b"", attachment)

    def attach(self, _verb: str, _payload: bytes) -> bytes:
        """Random bytes, which prove nothing: a stop is served from anyone, and its reply answers no other one."""
        return new_question()

    def is_reply(self, received: Received, request: bytes) -> bool:
        """Return True if it is a reply of the robot whose key it is under."""
        robots = self._robots
        return robots is not None and robots.is_reply(robot_of(received, self._root), received, request)

    def believes(self, received: Received) -> bool:
        robots = self._robots
        return robots is not None and robots.believes(robot_of(received, self._root), received)


def stop_proof(settings: Settings) -> StopProof | None:
    """Return the keys that sign a stop and verify its replies in signed mode; None in open mode.

    A stop is sent whatever the files hold. Without the authority's keys its replies are not verified; without an
    operator's key or grant it is not signed.
    """
    if settings.authority.mode != "signed":
        return None
    directory, root = directory_of(settings.authority), settings.robot.root
    may_stop_all = (directory / KEY_FILE.format(who="operator")).exists() or not (
        directory / TLS_KEY_FILE.format(who="viewer")
    ).exists()
    try:
        trust = read_trust(directory, _whose(directory))
    except CommandError as error:
        # The error names the cure.
        return StopProof(Unmet(Reason.PROOF_MISSING, str(error), ""), root, may_stop_all=may_stop_all)
    signer = _stop_signer(directory, root)
    robots = signer or KnownRobots(trust, root, _now_s)
    return StopProof(robots, root, signer, may_stop_all=may_stop_all)


def _whose(directory: Path) -> str:
    """Return the role of who was provisioned in a directory, for the cures; an operator comes first."""
    return next(
        (who for who in ("operator", *WITHOUT_GRANT) if (directory / TLS_KEY_FILE.format(who=who)).exists()),
        "operator",
    )


def _stop_signer(directory: Path, root: str) -> OperatorProof | None:
    if not (directory / KEY_FILE.format(who="operator")).exists():
        return None  # A viewer has none.
    try:
        identity = read_identity(directory, "operator")
        signer = OperatorProof(identity.private, identity.chain, identity.trust, root, _now_s)
        keys.command(root, keys.ALL, signer.name, STOP_VERB)
    except (CommandError, ValueError) as error:
        log.warning("the stop is not signed: %s", error)
        return None
    return signer


def _now_s() -> int:
    return int(time.time())
