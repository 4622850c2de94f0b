"""Exceptions in place of success, which carry the reason and what would cure it.

Each is a ``CommandError`` too: a command that meets one ends with its line and its exit code.
"""

from __future__ import annotations

from schemas.decisions import Reply
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.reasons import TEXTS, Reason, cure_of


class RobotError(CommandError):
    """The robot does not do what was requested.

    Attributes:
        reason: why, one enumeration for all of it.
        detail: the reason in words, with figures.
        cure: the way to make it succeed, with the robot's name.
    """

    code = ExitCode.FAILURE

    def __init__(self, what: str, reason: Reason, detail: str = "", cure: str = "", *, robot: str) -> None:
        self.reason = reason
        self.detail = detail or TEXTS[reason].means
        self.cure = cure_of(cure or TEXTS[reason].cure, robot)
        tail = f". Cure: {self.cure}" if self.cure else ""
        super().__init__(plain(f"{what}: {self.detail} ({reason.value}){tail}"), type(self).code)


class Refused(RobotError):  # noqa: N818 - an outcome's name, as programs read it
    """The robot refused a request."""

    code = ExitCode.REFUSED


class Stopped(RobotError):  # noqa: N818 - an outcome's name, as programs read it
    """The robot was stopped, or gave up its chassis: it rejects drive commands until it is engaged again."""


class LeaseLost(RobotError):  # noqa: N818 - an outcome's name, as programs read it
    """The lease is no longer ours."""


class Unreachable(CommandError):  # noqa: N818 - an outcome's name, as programs read it
    """The robot does not answer, or what it says cannot be read."""

    def __init__(self, message: str) -> None:
        super().__init__(plain(message), ExitCode.UNREACHABLE)


def refused(robot: str, verb: str, reply: Reply) -> Refused:
    """A refusing reply as an exception."""
    return Refused(f"{robot} refuses {verb}", reply.reason, reply.detail, reply.cure, robot=robot)
