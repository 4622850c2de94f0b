"""Exit codes of commands, and the error that carries one with a line that gives the cause."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """The exit codes of every command."""

    OK = 0
    FAILURE = 1
    """Findings, or a failure that fits nothing below."""
    USAGE = 2
    """Wrong arguments or a wrong configuration."""
    PARTIAL = 3
    """Part of the input could be read or done."""
    UNREACHABLE = 4
    """A bus, a robot or a Zenoh node does not answer."""
    REFUSED = 5
    """The robot refused the request."""


class CommandError(Exception):
    """A command cannot go on: one clear line for the person, and an exit code.

    Attributes:
        line: for whoever gave the command. The exception's own text is for whoever calls the library.
    """

    def __init__(self, message: str, code: ExitCode = ExitCode.FAILURE) -> None:
        super().__init__(message)
        self.code = code
        self.line = message
