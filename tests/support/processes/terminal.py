"""A terminal of a user, with a command; passphrases are answered."""

import os
import pty
import re
import signal
import subprocess
import threading
from contextlib import suppress
from pathlib import Path
from typing import Final

TIMEOUT_S: Final = 400.0  # on a busy machine the demo begins again and again
ASKS: Final = re.compile(r"passphrase (?:for|of) [^\n]*: |once more: ")


class Terminal:
    def __init__(self, words: list[str], directory: Path, environment: dict[str, str]) -> None:
        master, slave = pty.openpty()
        self._master = os.fdopen(master, "r+b", buffering=0)
        self.process = subprocess.Popen(
            words, cwd=directory, env=environment, stdin=slave, stdout=slave, stderr=slave, start_new_session=True
        )
        os.close(slave)
        self.shows = ""
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def wait(self) -> int:
        try:
            return self.process.wait(TIMEOUT_S)
        except subprocess.TimeoutExpired:
            # All of the terminal's: what a make has started too.
            os.killpg(self.process.pid, signal.SIGTERM)
            self.process.wait()
            raise
        finally:
            self._thread.join()
            # Not before: the last process that leaves it could still get a SIGHUP.
            self._master.close()

    def end(self) -> int:
        """Press Ctrl-C. Returns the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.wait()

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGTERM)
        self.wait()

    def is_showing(self, says: str) -> bool:
        """Whether it shows this, or has ended."""
        return re.search(says, self.shows) is not None or self.process.poll() is not None

    def _read(self) -> None:
        answered = 0
        # Reading fails with EIO once nobody has the terminal any more.
        with suppress(OSError):
            while data := self._master.read(65536):
                self.shows += data.decode(errors="replace").replace("\r\n", "\n")
                for _ in ASKS.findall(self.shows)[answered:]:
                    self._master.write(b"correct horse\n")
                    answered += 1
