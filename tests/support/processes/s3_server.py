"""A server that speaks S3, as a process: gofakes3, which ``make store-server`` builds."""

from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from tests.support.waiting import wait_until

PROGRAM: Final = os.environ.get("S3_SERVER", "")

BUCKET: Final = "fleet-logs"


@contextmanager
def s3_server(port: int, scratch: Path) -> Iterator[None]:
    """The server on a port of the loopback, with an empty bucket."""
    words = [PROGRAM, "-backend", "memory", "-host", f"127.0.0.1:{port}", "-initialbucket", BUCKET]
    with (scratch / "s3.log").open("ab") as said, subprocess.Popen(words, stdout=said, stderr=said) as server:
        try:
            wait_until(lambda: _answers(port))
            yield
        finally:
            server.kill()


def _answers(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
        return True
    return False
