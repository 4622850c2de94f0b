"""Pieces of the page. All that comes from a log is escaped here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from typing import Any, Final

import msgspec

from recorder.review.report.words import Line
from schemas.printable import plain

_OPENED: Final = 15
"""A longer table is folded."""


class Html(msgspec.Struct, frozen=True):
    """Markup of this module, of which all that comes from a log is escaped."""

    markup: str


Row = tuple[str | int | Html | None, ...]
"""The cells of a table's row: texts, numbers, and None for a number that is not known."""


def text(value: object) -> str:
    """Anything as text of the page: no tag, no attribute, no character that rules the line."""
    return escape(plain(str(value)))


def safe_json(value: Any) -> str:  # noqa: ANN401 - whatever JSON can hold
    """JSON that can stand in a script element: nothing in it ends that, or begins a comment."""
    encoded = msgspec.json.encode(value).decode()
    for character in "<>&\u2028\u2029":
        encoded = encoded.replace(character, f"\\u{ord(character):04x}")
    return encoded


def card(title: str, inner: Iterable[str], level: int = 3) -> Iterator[str]:
    """A box with a heading."""
    yield f'<div class="card"><h{level}>{text(title)}</h{level}>'
    yield from inner
    yield "</div>"


def definitions(lines: Sequence[Line]) -> Iterator[str]:
    """Names, and what is said of each."""
    yield "<dl>"
    for name, said in lines:
        yield f"<dt>{text(name)}</dt><dd>{text(said)}</dd>"
    yield "</dl>"


def folded(title: str, table: Iterable[str], rows: Sequence[Row] | None = None) -> Iterator[str]:
    """The table, below a title to be opened if these rows of it are many; without rows in any case."""
    if rows is not None and len(rows) <= _OPENED:
        yield from table
        return
    yield f"<details><summary>{text(title)}</summary>"
    yield from table
    yield "</details>"


def table_of(
    caption: str, head: Sequence[str], rows: Sequence[Row], looks: Sequence[tuple[str, str]] | None = None
) -> Iterator[str]:
    """A table; a column is of numbers if the first row has one there. Rows may have a class, and attributes."""
    heads = "".join(
        f'<th scope="col"{_look(one)}>{text(name)}</th>' for name, one in zip(head, rows[0], strict=True)
    )
    yield f'<div class="scroll"><table><caption>{text(caption)}</caption><thead><tr>{heads}</tr></thead><tbody>'
    for (kind, more), cells in zip(looks or [("", "")] * len(rows), rows, strict=True):
        written = "".join(f"<td{_look(one)}>{_written(one)}</td>" for one in cells)
        yield f'<tr class="{text(kind)}"{more}>{written}</tr>'
    yield "</tbody></table></div>"


def _written(cell: str | int | Html | None) -> str:
    if isinstance(cell, Html):
        return cell.markup
    return "-" if cell is None else text(cell)


def _look(cell: str | int | Html | None) -> str:
    return "" if isinstance(cell, str | Html) else " class=number"


def counted(count: int, noun: str) -> str:
    """``1 file``, ``2 files``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
