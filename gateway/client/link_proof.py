"""The proof of what goes to one robot, and comes from it, in signed mode."""

from __future__ import annotations

import logging
import time
from pathlib import Path
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.operator_proof import KnownRobots, OperatorProof, new_lease_key
from gateway.provisioning.key_files import directory_of, read_identity, read_trust
from gateway.provisioning.tls_files import check_tls_files
from gateway.telemetry.received import Received
from gateway.zenoh.client import PendingQuery
from gateway.zenoh.operator import CommandPort
from schemas.authority.trust import Objection
from schemas.decisions import LeaseReply
from schemas.exit_codes import CommandError
from schemas.reasons import Reason
from schemas.requests import Acquire, Request, Take
from schemas.settings import Settings
from schemas.subjects import DRIVE_VERB

log = logging.getLogger(__name__)

SHOW_TIMEOUT_S: Final = 1.0
"""A robot answers a statement within a few ticks of 10 ms."""


def operator_proof(settings: Settings) -> OperatorProof | None:
    """The operator's key and grant, in signed mode.

    Raises:
        CommandError: a file is missing or wrong; the text names it, and the cure.
    """
    if settings.authority.mode != "signed":
        return None
    identity = read_identity(directory_of(settings.authority), "operator")
    if settings.zenoh.config:
        warning = check_tls_files(Path(settings.zenoh.config), "operator", time.time())
        if warning:
            log.warning("%s", warning)
    return OperatorProof(
        identity.private, identity.chain, identity.trust, settings.robot.root, lambda: int(time.time())
    )


class LinkProof:
    """Proves commands to one robot, and holds against its key what comes of it.

    Attributes:
        challenge: the newest one that the robot published; empty before the first.
    """

    def __init__(self, proof: OperatorProof, robot: str) -> None:
        self.challenge = b""
        self._proof = proof
        self._robot = robot
        self._lease_key: X25519PrivateKey | None = None

    def meet(self, commands: CommandPort) -> Objection | None:
        """Show the robot the operator's grant. Returns why it does not take it, or is no robot of the fleet."""
        refusal: Objection | None = Objection(
            Reason.PROOF_MISSING, "it does not answer on @auth: is it in signed mode?"
        )
        for received in commands.show(self._proof.statement, SHOW_TIMEOUT_S):
            refusal = self._proof.meet(self._robot, received)
            if refusal is None:
                return None
        return refusal

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
        """The attachment of a command. Before the first challenge there is none: a stop needs none."""
        if verb == DRIVE_VERB:
            return self._proof.drive(payload)
        return self._proof.request(self._robot, verb, payload, self.challenge) if self.challenge else b""

    def is_reply(self, received: Received, request: bytes) -> bool:
        """Is it the robot's reply to the request that had this attachment?"""
        return self._proof.is_reply(self._robot, received, request)

    def believes(self, received: Received) -> bool:
        """May this sample be believed?"""
        return self._proof.believes(self._robot, received)


class StopProof:
    """Believes of a stop only what the robots signed. The stop itself needs no proof, and has none."""

    def __init__(self, robots: KnownRobots, root: str, commands: CommandPort) -> None:
        self._robots = robots
        self._root = root
        self._commands = commands
        self._query: PendingQuery | None = None

    def meet(self) -> None:
        """Ask the robots who they are, again and again, without waiting."""
        if self._query is not None:
            for received in self._query.poll():
                self._robots.meet(self._robot_of(received), received)
        if self._query is None or self._query.is_over:
            self._query = self._commands.begin_to_show(b"", SHOW_TIMEOUT_S)

    def attach(self, _verb: str, _payload: bytes) -> bytes:
        """No attachment: a stop is served from anyone."""
        return b""

    def is_reply(self, received: Received, request: bytes) -> bool:
        """Is it a reply of the robot whose key it is under?"""
        return self._robots.is_reply(self._robot_of(received), received, request)

    def believes(self, received: Received) -> bool:
        """May this sample be believed?"""
        return self._robots.believes(self._robot_of(received), received)

    def _robot_of(self, received: Received) -> str:
        return received.key.removeprefix(f"{self._root}/").partition("/")[0]


def stop_proof(settings: Settings, commands: CommandPort) -> StopProof | None:
    """What a stop is believed by, in signed mode. Without the authority's keys it is believed as in open mode."""
    if settings.authority.mode != "signed":
        return None
    try:
        trust = read_trust(directory_of(settings.authority))
    except CommandError as error:
        log.warning("what robots answer to the stop is not proven: %s", error)
        return None
    robots = KnownRobots(trust, settings.robot.root, lambda: int(time.time()))
    return StopProof(robots, settings.robot.root, commands)
