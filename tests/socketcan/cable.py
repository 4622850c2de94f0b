"""A cable between two CAN interfaces of the kernel: what one end does, the other need not notice."""

import itertools
import subprocess
from typing import Final, Self

_NUMBERS: Final = itertools.count()


class Cable:
    """Two ends that hear each other while both are up. The chassis and a witness are at the ``far`` one."""

    def __init__(self) -> None:
        number = next(_NUMBERS)
        self.near, self.far = f"near{number}", f"far{number}"
        _ip("link", "add", self.near, "type", "vxcan", "peer", "name", self.far)
        _ip("link", "set", self.far, "up")
        self.up()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        _ip("link", "delete", self.near)

    def up(self) -> None:
        """The near end."""
        _ip("link", "set", self.near, "up")

    def down(self) -> None:
        """The near end."""
        _ip("link", "set", self.near, "down")


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, timeout=30)
