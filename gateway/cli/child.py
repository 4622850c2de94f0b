"""Our own commands as child processes, for commands that run several."""

from __future__ import annotations

import os
import re
import subprocess
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from gateway.cli import parent
from schemas.command_line import CommandError, ExitCode, module_command
from schemas.configuration import CONFIG_VARIABLE

READY_TIMEOUT_S: Final = 30.0
END_TIMEOUT_S: Final = 20.0
LINES_KEPT: Final = 50


CRUISER: Final = module_command("gateway")  # the command that runs the ``cruiser`` of this very installation


class Child:
    """One of our own commands in a process of its own. It says that it is ready with its first line on stderr.

    It ends when this process is gone, also by SIGKILL.

    Args:
        environment: all of its environment. Where it names no settings file, none is meant.
    """

    def __init__(
        self,
        name: str,
        words: Sequence[str],
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        self._name = name
        watched, self._held = os.pipe()
        try:
            self._process = subprocess.Popen(  # noqa: S603 - our own command
                # Ctrl-C is for the demo, which ends its children in their order.
                [*CRUISER, name, *words],
                start_new_session=True,
                env={CONFIG_VARIABLE: "", **environment, parent.VARIABLE: str(watched)},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                pass_fds=[watched],
            )
        except OSError:
            os.close(self._held)
            raise
        finally:
            os.close(watched)
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
        os.close(self._held)
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def wait_ready(self) -> str:
        if not self._spoke.wait(READY_TIMEOUT_S):
            raise CommandError(f"{self._name} does not get ready")
        line = self._said[0] if self._said else ""
        if not line.startswith(f"{self._name}: "):
            self._process.wait()
            self._thread.join()
            self.check()
        return line

    @property
    def is_over(self) -> bool:
        return self._process.poll() is not None

    def check(self) -> None:
        """Raise a CommandError if it has ended."""
        code = self._process.poll()
        if code is None:
            return
        self._thread.join()
        last = self._said[-1] if self._said else f"{self._name} ended with {code}"
        known = {exit_code.value for exit_code in ExitCode} - {ExitCode.OK.value}
        raise CommandError(last, ExitCode(code) if code in known else ExitCode.FAILURE)

    def end(self) -> str:
        """Ask it to stop. Returns its stdout."""
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


def address_of(chassis: Child) -> str:
    """Return HOST:PORT of a virtual chassis that was started on a free port."""
    ready = re.search(r" on (127\.0\.0\.1:\d+)", chassis.wait_ready())
    if ready is None:
        raise CommandError("the virtual chassis does not say where it is")
    return ready[1]


def fresh(directory: Path) -> Path:
    """The first of DIR, DIR-2, DIR-3 and so on that holds nothing yet."""

    def candidates() -> Iterator[Path]:
        yield directory
        yield from (directory.parent / f"{directory.name}-{number}" for number in count(2))

    try:
        return next(path for path in candidates() if not path.exists() or not any(path.iterdir()))
    except OSError as error:
        raise CommandError(f"cannot write in {error.filename or directory}: {error.strerror}") from error
