"""A virtual CAN interface of the kernel, with the knobs that ``ip link`` has."""

import itertools
import subprocess
from typing import Final, Self

_NUMBERS: Final = itertools.count()


class Vcan:
    """An interface of its own, up, until the block ends."""

    def __init__(self) -> None:
        self.name = f"vcan{next(_NUMBERS)}"
        self.create()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.exists:
            self.remove()

    @property
    def exists(self) -> bool:
        """The kernel has it, up or down."""
        return subprocess.run(["ip", "link", "show", self.name], capture_output=True, check=False).returncode == 0

    def create(self) -> None:
        """Make it anew, and up."""
        _ip("link", "add", self.name, "type", "vcan")
        self.up()

    def up(self) -> None:
        _ip("link", "set", self.name, "up")

    def down(self) -> None:
        _ip("link", "set", self.name, "down")

    def remove(self) -> None:
        """Take it away, as an adapter that is pulled out."""
        _ip("link", "delete", self.name)


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, timeout=30)
