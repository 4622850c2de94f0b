"""One of our own commands as a child process, for commands that run several."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from types import TracebackType
from typing import Final, Self

from schemas.exit_codes import CommandError, ExitCode

READY_TIMEOUT_S: Final = 30.0
END_TIMEOUT_S: Final = 20.0
LINES_KEPT: Final = 50


class Child:
    """One of our own commands in a process of its own. It says that it is ready with its first line on stderr."""

    def __init__(self, name: str, words: Sequence[str], **environment: str) -> None:
        self._name = name
        command = [sys.executable, "-m", "gateway", name, *words]
        self._process = subprocess.Popen(  # noqa: S603 - our own command
            # Ctrl-C is for the demo, which ends its children in their order.
            command,
            start_new_session=True,
            env=os.environ | environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._said: deque[str] = deque(maxlen=LINES_KEPT)
        self._spoke = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._thread.join()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def wait_ready(self) -> str:
        """Its first line.

        Raises:
            CommandError: it ended instead, or says nothing.
        """
        if not self._spoke.wait(READY_TIMEOUT_S):
            raise CommandError(f"{self._name} does not get ready")
        line = self._said[0] if self._said else ""
        if not line.startswith(f"{self._name}: "):
            self._process.wait()
            self._thread.join()
            self.check()
        return line

    def check(self) -> None:
        """Raise a CommandError if it has ended."""
        code = self._process.poll()
        if code is None:
            return
        self._thread.join()
        last = self._said[-1] if self._said else f"{self._name} ended with {code}"
        known = {exit_code.value for exit_code in ExitCode} - {ExitCode.OK.value}
        raise CommandError(last, ExitCode(code) if code in known else ExitCode.FAILURE)

    def type(self, line: str) -> None:
        """Type a line into it."""
        if self._process.stdin is not None:
            try:
                self._process.stdin.write(f"{line}\n")
                self._process.stdin.flush()
            except BrokenPipeError as error:
                raise CommandError(f"{self._name} has ended") from error

    def end(self) -> str:
        """Ask it to stop. Returns its stdout.

        Raises:
            CommandError: it ended before, or does not end.
        """
        self.check()
        self._process.terminate()
        try:
            # What it prints is short and waits in the pipe.
            self._process.wait(END_TIMEOUT_S)
            out = self._process.stdout.read() if self._process.stdout else ""
        except subprocess.TimeoutExpired as error:
            raise CommandError(f"{self._name} does not stop") from error
        # What a recorder dropped on a busy machine is in its result, and no reason to have none.
        if self._process.returncode not in {ExitCode.OK, ExitCode.PARTIAL}:
            self.check()
        return out

    def _listen(self) -> None:
        """Take what it says on stderr; its first line, or its end, is what others wait for."""
        for line in self._process.stderr or ():
            self._said.append(line.rstrip("\n"))
            self._spoke.set()
        self._spoke.set()
