"""TOML beyond what ``tomllib`` does: writing it, and finding the line on which a key stands."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any, Final

Path = tuple[str, ...]

_DEPTH: Final = 3
"""A setting's path is section, name and at most one key within; nothing deeper is ever looked for."""

_MAX_STATEMENT_LINES: Final = 1000
"""A statement that is longer than this is not taken apart: each further line costs another try."""

_BARE_KEY: Final = re.compile(r"[A-Za-z0-9_-]+")


def lines_of_keys(text: str) -> dict[Path, int]:
    """The line, from 1, on which each key or table of a right TOML text first stands.

    Each statement of TOML is a right TOML text of its own, so tomllib itself takes the text apart: lines are
    joined until they parse. That holds for quoted and dotted keys, inline tables and values of several lines.
    """
    found: dict[Path, int] = {}
    table: Path = ()
    lines = text.replace("\r\n", "\n").split("\n")
    start = 0
    while start < len(lines):
        end, statement = _statement(lines, start)
        if statement is None:
            break
        if lines[start].lstrip().startswith("["):
            table = _header(statement)
            for depth in range(1, len(table) + 1):
                found.setdefault(table[:depth], start + 1)
        else:
            for path in _paths(statement, _DEPTH - len(table)):
                found.setdefault(table + path, start + 1)
        start = end
    return found


def _statement(lines: list[str], start: int) -> tuple[int, dict[str, Any] | None]:
    """The statement that begins on this line, and the line after it."""
    for end in range(start + 1, min(len(lines), start + _MAX_STATEMENT_LINES) + 1):
        try:
            return end, tomllib.loads("\n".join(lines[start:end]))
        except (ValueError, RecursionError):
            continue
    return len(lines), None


def _header(statement: Mapping[str, Any]) -> Path:
    """The path of ``[table]`` or ``[[table]]``, no deeper than a setting's."""
    path: Path = ()
    inner: Any = statement
    while inner and len(path) < _DEPTH:
        if isinstance(inner, list):
            inner = inner[0]
        else:
            name = next(iter(inner))
            path = (*path, name)
            inner = inner[name]
    return path


def _paths(table: Mapping[str, Any], depth: int) -> list[Path]:
    if depth <= 0:
        return []
    paths: list[Path] = []
    for name, value in table.items():
        paths.append((name,))
        if isinstance(value, dict):
            paths += [(name, *inner) for inner in _paths(value, depth - 1)]
    return paths


def write_value(value: object) -> str:
    """A value as TOML; a mapping becomes an inline table.

    Raises:
        TypeError: TOML has no such value.
    """
    match value:
        case bool():
            return "true" if value else "false"
        case int():
            return str(value)
        case float():
            return repr(value)  # Python and TOML write inf, nan and 1e+16 alike.
        case str():
            return write_string(value)
        case list() | tuple():
            return "[" + ", ".join(write_value(item) for item in value) + "]"
        case dict():
            items = ", ".join(f"{write_key(name)} = {write_value(item)}" for name, item in value.items())
            return f"{{ {items} }}" if items else "{}"
        case _:
            raise TypeError(f"TOML has no {type(value).__name__}")


def write_key(name: str) -> str:
    """A key, quoted only if it must be."""
    return name if _BARE_KEY.fullmatch(name) else write_string(name)


def write_string(text: str) -> str:
    """A basic string: as in JSON, but for DEL, which TOML wants escaped too. All else stands as it is."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", r"\u007F")
