"""Virtual CAN interfaces of the kernel, with the knobs that ``ip link`` has."""

import itertools
import subprocess
from typing import Final, Self

_NUMBERS: Final = itertools.count()


class Vcan:
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
        return subprocess.run(["ip", "link", "show", self.name], capture_output=True, check=False).returncode == 0

    def create(self) -> None:
        _ip("link", "add", self.name, "type", "vcan")
        self.up()

    def up(self) -> None:
        _ip("link", "set", self.name, "up")

    def down(self) -> None:
        _ip("link", "set", self.name, "down")

    def remove(self) -> None:
        _ip("link", "delete", self.name)


class Cable:
    """Two connected interfaces. The chassis and a witness are at the ``far`` end."""

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
        _ip("link", "set", self.near, "up")

    def down(self) -> None:
        _ip("link", "set", self.near, "down")


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, timeout=30)
