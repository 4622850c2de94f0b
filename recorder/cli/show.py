"""Print what a command answers: JSON for programs, lines for people."""

from __future__ import annotations

import sys
from collections.abc import Iterable

import msgspec

from schemas.printable import plain


def show(answer: object, lines: Iterable[str], *, as_json: bool) -> None:
    """Print an answer.

    Args:
        answer: an object, as a line of JSON.
        lines: the same for people. Names in a log come from anywhere, and may try to rule the terminal: what
            cannot be printed is escaped.
        as_json: choose the first.
    """
    shown = [msgspec.json.encode(answer).decode()] if as_json else map(plain, lines)
    sys.stdout.writelines(f"{line}\n" for line in shown)
