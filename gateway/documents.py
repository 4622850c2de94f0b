"""All generated parts of README.md and docs/*.md: ``python -m gateway.documents`` rewrites them.

Most are made from the tables of ``schemas``, by ``schemas.documents``. Those of this module are made from the
arbiter's own tables, which ``schemas`` knows nothing of.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final

from gateway.command.causes import STOPS
from gateway.command.states import diagram
from schemas import documents
from schemas.documents import Part
from schemas.reasons import TEXTS


def state_diagram() -> str:
    """The arbiter's states, as a diagram that Markdown viewers draw."""
    return f"```mermaid\n{diagram()}\n```"


def stop_table() -> str:
    """Every cause to stop: how hard, and whether it is latched."""
    rows = [
        (
            f"`{reason.value}`",
            TEXTS[reason].means,
            "emergency" if stop.at_once else "normal",
            "yes" if stop.latched else "",
        )
        for reason, stop in STOPS.items()
    ]
    return documents.table(("cause", "it means", "deceleration", "latched"), rows)


PARTS: Final[dict[str, Part]] = {"states": state_diagram, "stops": stop_table}


def main(words: Sequence[str] | None = None) -> int:
    """Rewrites the documents, or with ``--check`` only says which ones are not current."""
    return documents.main(words, documents.PARTS | PARTS)


if __name__ == "__main__":
    sys.exit(main())
