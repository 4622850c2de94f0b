"""When to believe a robot: samples that agree for a while, and in signed mode signatures.

Anyone on the network can forge samples, but the robot's own contradict them many times a second. So all samples
must be read: a lost one may be the contradiction. They may be read late and in batches; each has the time of its
reading, because everything delivered until then is read in the same batch, before anything is believed.
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
    """Collects samples that agree, until there are enough to believe. A longer pause starts over."""

    def __init__(self, pause_max_ns: float = inf) -> None:
        self._pause_max_ns = pause_max_ns
        self._count = self._first_ns = self._last_ns = 0

    def add(self, now_ns: int) -> bool:
        """Add a sample; return True if there are enough."""
        if not self._count or now_ns - self._last_ns > self._pause_max_ns:
            self._count, self._first_ns = 0, now_ns
        self._count, self._last_ns = self._count + 1, now_ns
        return self.is_enough

    @property
    def is_enough(self) -> bool:
        return self._count >= CONFIRM_SAMPLES and self._last_ns - self._first_ns >= CONFIRM_NS

    def clear(self) -> None:
        """Start over: a sample contradicts, or some may be missing."""
        self._count = 0


log = logging.getLogger(__name__)

SHOW_TIMEOUT_S: Final = 1.0  # a robot answers a statement within a few ticks of 10 ms
ASK_AGAIN_NS: Final = 250_000_000  # shortest time between two queries for identities
WITHOUT_GRANT: Final = ("viewer", "desk")  # roles of machines that have a certificate, and no key that signs
SIGN_AGAIN_NS: Final = 250_000_000  # a stop is signed again for the same robot after this time: a put may be lost


class _Meeting:
    """Queries robots' identities without waiting, each time with a new question."""

    def __init__(self, robots: KnownRobots, root: str) -> None:
        self._robots = robots
        self._root = root
        self._query: PendingQuery | None = None
        self._question = b""
        self._asked_ns = -ASK_AGAIN_NS

    def step(self, commands: CommandPort, statement: bytes, *, is_wanted: bool) -> None:
        """Read replies, and query again if that is wanted and due."""
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
    """Return the operator's key and grant in signed mode; for a viewer or a desk what verifies robots."""
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
        challenge: the robot's newest; empty before the first.
    """

    def __init__(self, proof: OperatorProof | ViewerProof, robot: str, root: str) -> None:
        self.challenge = b""
        self._proof = proof
        self._robot = robot
        self._lease_key: X25519PrivateKey | None = None
        self._meeting = _Meeting(proof, root)

    def meet(self, commands: CommandPort) -> Objection | None:
        """Send the robot the operator's grant. Returns why it is refused or the robot is not verified."""
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
        """If samples of another run arrive, query which run is current, without waiting."""
        self._meeting.step(commands, self._proof.statement, is_wanted=self._proof.is_to_meet_again(self._robot))

    def with_key(self, request: Request) -> Request:
        """Add a new public key to a request for a lease."""
        if not isinstance(request, Acquire | Take):
            return request
        self._lease_key, public = new_lease_key()
        return msgspec.structs.replace(request, public_key=public)

    def begin_lease(self, reply: LeaseReply, attachment: bytes) -> bool:
        """Agree with the robot on the lease's key; False if its reply has none."""
        private, self._lease_key = self._lease_key, None
        return private is None or self._proof.begin_lease(self._robot, private, reply, attachment)

    def attach(self, verb: str, payload: bytes) -> bytes:
        """Return a command's attachment. Before the first challenge it proves nothing: a stop needs no proof."""
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
    """Verifies the robots' answers to a stop, and signs the stop for them.

    The stop itself goes out unsigned, at once. With a key and a grant it is signed too, as soon as a robot
    publishes a challenge, so that the record names the operator. Nothing here raises or waits.

    Attributes:
        name: of the operator, by the grant; empty without one.
        may_stop_all: the certificate may stop all robots at once; a viewer's stops one by its name.
    """

    def __init__(
        self,
        robots: KnownRobots | Unmet,
        root: str,
        signer: OperatorProof | None = None,
        *,
        may_stop_all: bool = True,
    ) -> None:
        """Begin without verified robots. ``robots`` is the signer, if any; or why nothing can be verified."""
        self.name = "" if signer is None else signer.name
        self.may_stop_all = may_stop_all
        self._fault = robots if isinstance(robots, Unmet) else None
        self._robots = None if isinstance(robots, Unmet) else robots
        self._signer = signer
        self._root = root
        self._meeting = None if self._robots is None else _Meeting(self._robots, root)
        self._signed_ns: dict[str, int] = {}

    def meet(self, commands: CommandPort) -> None:
        """Query the robots' identities repeatedly, with the grant if there is one."""
        if self._meeting is not None:
            self._meeting.step(commands, b"" if self._signer is None else self._signer.statement, is_wanted=True)

    def doubt(self, robot: str) -> Unmet:
        return self._fault or (SILENT if self._robots is None else self._robots.doubt(robot))

    def sign(self, commands: CommandPort, robot: str, challenge: bytes) -> None:
        """Send a robot a signed stop over its challenge, from time to time."""
        now_ns = time.monotonic_ns()
        if self._signer is None or now_ns - self._signed_ns.get(robot, -SIGN_AGAIN_NS) < SIGN_AGAIN_NS:
            return
        self._signed_ns[robot] = now_ns
        attachment = self._signer.request(robot, STOP_VERB, b"", challenge)
        commands.put_signed(keys.command(self._root, robot, self.name, STOP_VERB), STOP_VERB, b"", attachment)

    def attach(self, _verb: str, _payload: bytes) -> bytes:
        """Return random bytes: a stop needs no proof, and its reply must answer this stop."""
        return new_question()

    def is_reply(self, received: Received, request: bytes) -> bool:
        """Return True for a reply of the robot in whose key it was sent."""
        robots = self._robots
        return robots is not None and robots.is_reply(robot_of(received, self._root), received, request)

    def believes(self, received: Received) -> bool:
        robots = self._robots
        return robots is not None and robots.believes(robot_of(received, self._root), received)


def stop_proof(settings: Settings) -> StopProof | None:
    """Return what signs a stop and verifies its replies in signed mode; None in open mode.

    The stop is sent in any case: without the authority's keys its replies are not verified, without an operator's
    key or grant it is not signed.
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
    """Return the role that was provisioned in a directory, for cures; an operator comes first."""
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
