"""Print an answer: JSON for programs, lines for people.

Apart from ``asking``, so that ``cruiser upload`` loads no question.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

import msgspec

from schemas.command_line import plain


def show(answer: object, lines: Iterable[str], *, as_json: bool) -> None:
    """Print an answer. Names in a log may hold terminal commands: what cannot be printed is escaped."""
    shown = [json_line(answer)] if as_json else map(plain, lines)
    sys.stdout.writelines(f"{line}\n" for line in shown)


def json_line(answer: object) -> str:
    """An answer as JSON. Bytes of a file's name that are not text are escaped."""
    try:
        return msgspec.json.encode(answer).decode()
    except UnicodeEncodeError:
        return msgspec.json.encode(_escaped(msgspec.to_builtins(answer))).decode()


def _escaped(value: Any) -> Any:  # noqa: ANN401 - whatever JSON has
    match value:
        case str():
            return value.encode(errors="backslashreplace").decode()
        case dict():
            return {_escaped(key): _escaped(one) for key, one in value.items()}
        case list():
            return list(map(_escaped, value))
        case _:
            return value
