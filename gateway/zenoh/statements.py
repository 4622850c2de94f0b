"""Shows robots statements of their authority. Its session is its own."""

from __future__ import annotations

import time
from typing import Final, Self

import zenoh

from gateway.telemetry.received import Received
from gateway.zenoh.client import PendingQuery, SessionOwner, call_roll
from schemas import keys
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings
from schemas.zenoh_session import join, reason

AGAIN_S: Final = 0.02
"""A robot that many ask leaves some queries unanswered, and these end at once. They are sent again after this."""


class StatementPort(SessionOwner):
    """The session that sends statements to robots and receives their answers."""

    def __init__(self, session: zenoh.Session, root: str) -> None:
        """Use a session, which the port then owns.

        Args:
            session: an open session.
            root: first chunks of every key.
        """
        super().__init__(session)
        self._root = root

    @classmethod
    def open(cls, settings: Settings) -> Self:
        """Open a session to where the settings say.

        Raises:
            CommandError: see ``zenoh_session``.
        """
        return cls(join(settings.zenoh), settings.robot.root)

    def robots(self, timeout_s: float) -> list[str]:
        """The robots that are connected, by their liveliness tokens."""
        replies = call_roll(self._session, keys.liveliness(self._root), timeout_s).wait(timeout_s, timeout_s)
        found = {keys.robot_of_liveliness(self._root, reply.key) for reply in replies}
        return sorted(robot for robot in found if robot is not None)

    def show(self, robot: str, text: bytes, question: bytes, timeout_s: float) -> Received | None:
        """Show a robot a statement, again and again until it answers. Returns its answer; None if none comes.

        Args:
            robot: its name.
            text: the statement.
            question: the attachment, drawn for this question: the answer's signature covers it.
            timeout_s: the longest wait for it.

        Raises:
            CommandError: the session is closed.
        """
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            if replies := self._ask(robot, text, question, left_s).wait(left_s):
                return replies[0]
            time.sleep(AGAIN_S)
        return None

    def _ask(self, robot: str, text: bytes, question: bytes, timeout_s: float) -> PendingQuery:
        pending = PendingQuery()
        try:
            self._session.get(
                keys.authority(self._root, robot),
                pending.handler,
                payload=text,
                attachment=question,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.DROP,
                timeout=timeout_s,
            )
        except zenoh.ZError as error:
            raise CommandError(f"cannot ask: {reason(str(error))}", ExitCode.UNREACHABLE) from error
        return pending
