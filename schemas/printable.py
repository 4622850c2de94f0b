"""Text from elsewhere, made safe for one line of a terminal."""

from __future__ import annotations

from typing import Final

LINE_LENGTH: Final = 300
"""Of a text from elsewhere no more belongs into a line."""


def plain(text: str) -> str:
    """The text as it is if all of it can be printed, else with escapes: it can break neither line nor terminal."""
    return text if text.isprintable() else ascii(text)[1:-1]


def short(text: str) -> str:
    """The text, or its beginning if it is too long for a line."""
    return text if len(text) <= LINE_LENGTH else f"{text[: LINE_LENGTH - 3]}..."
