"""The proof that a gateway which answers under a robot's name was granted that name. Pure.

Anybody's gateway could answer on ``gateway/info`` under any name, since certificates of robots say only that they
are robots. So the answer is signed over bytes drawn for the query, and has the chain of the robot's grant.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Final

from gateway.authority.admission import SignedAdmission
from gateway.authority.signer import RobotSigner
from schemas import keys
from schemas.authority.proof import (
    ROBOT_PROOF_BYTES,
    Grant,
    GrantRole,
    RobotProof,
    Signed,
    StatementFault,
    chain_text,
    read_chain,
)
from schemas.authority.trust import HeldGrant, fits
from schemas.settings import Settings
from schemas.subjects import BY_NAME

QUESTION_BYTES: Final = 16

_INFO: Final = BY_NAME["gateway/info"]


class NameProof:
    """Answers for the robot's name, and judges who else does."""

    def __init__(
        self,
        settings: Settings,
        signer: RobotSigner,
        admission: SignedAdmission,
        own: Callable[[], list[Signed]],
    ) -> None:
        """For the robot that the settings name.

        Args:
            settings: the robot's name and root.
            signer: the robot's.
            admission: knows the authority.
            own: the chain of the robot's own grant, as it is now.
        """
        self._robot = settings.robot.name
        self._key = keys.build(settings.robot.root, settings.robot.name, _INFO)
        self._signer = signer
        self._admission = admission
        self._own = own

    def attachment(self, payload: bytes, question: bytes) -> bytes:
        """The attachment of an answer: the robot's proof, and behind it the chain of its grant, as text."""
        return self._signer.reply(self._key, _INFO.encoding, payload, question) + chain_text(self._own()).encode()

    def is_namesake(self, payload: bytes, attachment: bytes, question: bytes, now_s: int) -> bool:
        """Return True if an answer is of a gateway with this robot's key, or with a grant for its name.

        Args:
            payload: the answer's.
            attachment: the answer's.
            question: the attachment of the query, drawn for it (``new_name_question``).
            now_s: seconds since 1970.
        """
        proof = RobotProof.read(attachment[:ROBOT_PROOF_BYTES])
        if proof is None:
            return False
        text = proof.signed_reply(self._key, _INFO.encoding, payload, question)
        if fits(self._signer.public_key, proof.signature, text):
            return True
        chain = read_chain(attachment[ROBOT_PROOF_BYTES:])
        if isinstance(chain, StatementFault):
            return False
        # At its beginning, if this computer's clock is behind.
        starts = [one.statement.not_before for one in chain if isinstance(one.statement, Grant)]
        held = self._admission.trust.judge(chain, max([now_s, *starts]))
        return (
            isinstance(held, HeldGrant)
            and (held.grant.role, held.grant.name) == (GrantRole.ROBOT, self._robot)
            and fits(held.key, proof.signature, text)
        )


def new_name_question() -> bytes:
    """The attachment of one query for a namesake: random."""
    return secrets.token_bytes(QUESTION_BYTES)
