"""can-utils as independent peers on the bus."""

import re
import subprocess
from pathlib import Path
from typing import Final, NamedTuple, Self

from tests.socketcan.turns import PEER, come_first
from tests.support.waiting import wait_until

_LINE: Final = re.compile(r"\((\d+)\.(\d{6})\) (\S+) ([0-9A-F]{3}|[0-9A-F]{8})#([0-9A-F]*)")
_MARK: Final = 0x7FF  # an unused identifier: candump listens once it has written it


class Dumped(NamedTuple):
    """A line of candump; ``at_us`` is the kernel's receive time."""

    at_us: int
    can_id: int
    data: bytes


class Candump:
    """``candump -L`` into a file; ``filters`` are candump's, ``IDENTIFIER:MASK``."""

    def __init__(self, channel: str, path: Path, *filters: str) -> None:
        self.path = path
        self._at = 0
        self._frames: list[Dumped] = []
        with path.open("wb") as file:
            what = ",".join([channel, *filters, *([f"{_MARK:03X}:{_MARK:03X}"] if filters else [])])
            self._process = subprocess.Popen(["candump", "-L", what], stdin=subprocess.DEVNULL, stdout=file)
        come_first(self._process.pid, PEER)
        wait_until(lambda: path.stat().st_size > 0, lambda: send(channel, _MARK, b""))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(30)

    @property
    def frames(self) -> list[Dumped]:
        with self.path.open("rb") as file:
            file.seek(self._at)
            text = file.read()
        whole = text[: text.rfind(b"\n") + 1]
        self._at += len(whole)
        for line in whole.decode("ascii").splitlines():
            found = _LINE.fullmatch(line)
            assert found is not None, line
            if int(found[4], 16) != _MARK:
                at_us = int(found[1]) * 1_000_000 + int(found[2])
                self._frames.append(Dumped(at_us, int(found[4], 16), bytes.fromhex(found[5])))
        return self._frames


def send(channel: str, can_id: int, data: bytes) -> None:
    """Send a frame by ``cansend``; identifiers up to 0x7FF are standard ones."""
    identifier = f"{can_id:03X}" if can_id <= _MARK else f"{can_id:08X}"
    subprocess.run(["cansend", channel, f"{identifier}#{data.hex().upper()}"], check=True, timeout=30)
