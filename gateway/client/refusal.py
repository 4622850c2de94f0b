"""Exceptions in place of success, which carry the reason and what would cure it.

Each is a ``CommandError`` too: a command that meets one ends with its line and its exit code.
"""

from __future__ import annotations

import re
from typing import Final

from schemas.command_line import CommandError, ExitCode, plain
from schemas.decisions import Reply
from schemas.reasons import ACQUIRE, TEXTS, Reason, cure_of

_METHODS: Final = {
    f"{ACQUIRE}, and use the number that it shows": "acquire it with robot.lease()",
    f"{ACQUIRE}, which renew it; a client of its own has to": "acquire it with robot.lease(), which renews it",
    ACQUIRE: "acquire it with robot.lease()",
    "'cruiser drive ROBOT' (driving: key g)": "lease.engage()",
    "'cruiser reset ROBOT' (driving: key r)": "lease.reset()",
    "'cruiser drive ROBOT'": "lease.drive()",
    "leave 'cruiser drive' first (lease.disengage())": "lease.disengage() first",
    "'cruiser lease ROBOT --take --role supervisor'": "robot.take(Role.SUPERVISOR)",
    "'cruiser lease ROBOT --take --override'": "robot.take(override=True)",
    "'cruiser lease ROBOT --take'": "robot.take()",
    "'cruiser lease ROBOT'": "robot.state().state.lease_holder",
    "'cruiser watch ROBOT' shows engaged": "lease.is_engaged is true",
    "'cruiser watch ROBOT'": "robot.state().health",
    "'cruiser list' for why (gateway/health)": "robot.state().health for why",
    "'cruiser list --json' for which frames (gateway/health)": "robot.state().health for which frames",
    "'cruiser stop ROBOT'": "robot.stop()",
    "'cruiser why ROBOT'": "robot.state().health.notes",
    "let go of the keys, or ": "",
}
"""In place of a command that a cure names a program calls this. The whole of a phrase comes before its parts."""

_EITHER: Final = re.compile(r"'cruiser [^']*', or (?=(?:lease|robot)\.)")


def for_programs(cure: str) -> str:
    """A cure by the library's methods, where it has one for the command."""
    cure = _EITHER.sub("", cure)
    for command, method in _METHODS.items():
        cure = cure.replace(command, method)
    return cure


class RobotError(CommandError):
    """The robot does not do what was requested.

    Attributes:
        reason: why, one enumeration for all of it.
        detail: the reason in words, with figures.
        cure: the way to make it succeed, by the library's methods.
    """

    code = ExitCode.FAILURE

    def __init__(self, what: str, reason: Reason, detail: str = "", cure: str = "", *, robot: str) -> None:
        self.reason = reason
        self.detail = detail or TEXTS[reason].means
        cure = cure or TEXTS[reason].cure
        self.cure = cure_of(for_programs(cure), robot)
        text, tail = f"{what}: {self.detail} ({reason.value})", ". Cure: " if cure else ""
        super().__init__(plain(f"{text}{tail}{self.cure}"), type(self).code)
        self.line = plain(f"{text}{tail}{cure_of(cure, robot)}")


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


def refused(robot: str, verb: str, reply: Reply, operator: str) -> Refused:
    """A refusing reply to an operator as an exception."""
    detail = reply.detail
    if reply.reason is Reason.LEASE_HELD:
        own = f"another session of {operator} holds the lease; it "
        detail = detail.replace(f"{TEXTS[Reason.LEASE_HELD].means}; by {operator}, ", own)
    return Refused(f"{robot} refuses {verb}", reply.reason, detail, reply.cure, robot=robot)
