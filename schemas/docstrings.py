"""The texts of docstrings, which documents and JSON Schemas repeat."""

from __future__ import annotations

import inspect
import re


def attribute_texts(kind: type) -> dict[str, str]:
    """Return the text of each field in the docstrings of a class and of its bases."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        _, _, section = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")
        for match in re.finditer(r"^ {4}(\w+): (.*(?:\n {5,}.*)*)", section, re.MULTILINE):
            texts[match[1]] = " ".join(match[2].split())
    return texts


def summary(kind: type) -> str:
    """Return the docstring of a class up to its fields."""
    return plain_text(inspect.cleandoc(kind.__doc__ or "").partition("\n\nAttributes:")[0])


def plain_text(text: str) -> str:
    """Return a docstring's text in one line, without the marks of code."""
    return " ".join(text.replace("``", "").split())
