"""Text from elsewhere, made safe for one line of a terminal."""

from __future__ import annotations


def plain(text: str) -> str:
    """The text as it is if all of it can be printed, else with escapes: it can break neither line nor terminal."""
    return text if text.isprintable() else ascii(text)[1:-1]
