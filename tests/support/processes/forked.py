"""``cruiser`` commands as processes, without most of the cost of their imports.

Each is forked from a process that has imported all commands, without threads or open files. With PYTHONPATH, which
may name another version, a new interpreter starts instead.
"""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Final

from gateway.cli.main import COMMANDS, main

_CONTEXT: Final = get_context("forkserver")
_CONTEXT.set_forkserver_preload([__name__, *(place.partition(":")[0] for place, _ in COMMANDS.values())])


class Forked:
    def __init__(self, words: Sequence[str], environment: Mapping[str, str]) -> None:
        self._words = list(words)
        # The fork server tells a code once: of two threads that read it, one would take its end for 255.
        self._reading = threading.Lock()
        self._code: int | None = None
        (out, to_out), (err, to_err) = os.pipe(), os.pipe()
        with Connection(to_out, readable=False) as stdout, Connection(to_err, readable=False) as stderr:
            self._process = _CONTEXT.Process(
                target=_run, args=(self._words, dict(environment), str(Path.cwd()), stdout, stderr)
            )
            self._process.start()
        self.stdout: Final[IO[str]] = open(out, encoding="utf-8")  # noqa: PTH123, SIM115 - a descriptor
        self.stderr: Final[IO[str]] = open(err, encoding="utf-8")  # noqa: PTH123, SIM115 - a descriptor

    @property
    def pid(self) -> int:
        assert self._process.pid is not None
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """The exit code, or the negative number of the signal that ended it; None while it runs."""
        # Another thread that waits for it reads the code.
        if self._code is None and self._reading.acquire(blocking=False):
            try:
                self._code = self._process.exitcode
            finally:
                self._reading.release()
        return self._code

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        if self._reading.acquire(timeout=-1 if timeout is None else timeout):
            try:
                self._process.join(timeout)
                self._code = self._process.exitcode
            finally:
                self._reading.release()
        if (code := self._code) is None:
            raise subprocess.TimeoutExpired(["cruiser", *self._words], timeout or 0.0)
        return code

    def communicate(self, timeout: float) -> tuple[str, str]:
        """Wait for the end. Returns the rest of stdout and stderr; kills it after the timeout."""
        with ThreadPoolExecutor(2) as readers, self.stdout, self.stderr:
            out, err = readers.submit(self.stdout.read), readers.submit(self.stderr.read)
            try:
                self.wait(timeout)
            except subprocess.TimeoutExpired:
                self.kill()
                raise
            return out.result(), err.result()

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def _run(
    words: list[str], environment: Mapping[str, str], directory: str, stdout: Connection, stderr: Connection
) -> None:
    os.chdir(directory)
    # Under nohup the tests ignore it; what they start is told by it to end.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    os.environ.clear()
    os.environ.update(environment)
    with stdout, stderr, open(os.devnull, "rb") as stdin:  # noqa: PTH123
        for number, descriptor in enumerate((stdin.fileno(), stdout.fileno(), stderr.fileno())):
            os.dup2(descriptor, number)
    if "PYTHONPATH" in environment:
        os.execve(sys.executable, [sys.executable, "-m", "gateway", *words], environment)  # noqa: S606
    sys.stdin = open(0, encoding="utf-8")  # noqa: SIM115 - as the interpreter does
    sys.stdout = open(1, "w", encoding="utf-8")  # noqa: SIM115 - the same
    sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", buffering=1)  # noqa: SIM115 - the same
    sys.argv = ["cruiser", *words]
    sys.exit(main())
