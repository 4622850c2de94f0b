"""The load figures on a vcan of the kernel.

Usage: python -m tests.bench.on_vcan [--seconds N]; in user-mode Linux: tests/socketcan/run --bench [--seconds N]
"""

from __future__ import annotations

import argparse
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from tests.bench.loads import load_rows, print_table

NAME = "vcan-bench"


@contextmanager
def vcan() -> Iterator[str]:
    """The name of an interface that is up; empty where the kernel has no vcan, or we may not make one."""
    made = _ip("link", "add", NAME, "type", "vcan") and _ip("link", "set", NAME, "up")
    try:
        yield NAME if made else ""
    finally:
        if made:
            _ip("link", "delete", NAME)


def _ip(*words: str) -> bool:
    try:
        return subprocess.run(["ip", *words], capture_output=True, check=False).returncode == 0  # noqa: S607
    except FileNotFoundError:
        return False


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of each load (default 20)")
    with vcan() as interface:
        if not interface:
            parser.error("this kernel has no vcan, or you may not make one")
        print_table(load_rows(parser.parse_args().seconds, interface))


if __name__ == "__main__":
    main()
