"""The layouts of the DBC files as a file: ``python -m gateway.chassis.cruiser.layout_file`` writes it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import msgspec

from gateway.chassis.cruiser.layout import LAYOUTS, ReadLayout, digest
from gateway.chassis.dbc import read_layout
from schemas.dbc_files import CHASSIS_NODE, DBC_FILES, dbc_text

FILE: Final = Path(__file__).with_name(LAYOUTS)


def layouts_text() -> str:
    """Return what the file has to say.

    Raises:
        ValueError: a DBC says something that is not implemented.
    """
    layouts = {
        variant: ReadLayout(digest(variant), read_layout(variant, dbc_text(variant), CHASSIS_NODE))
        for variant in DBC_FILES
    }
    return msgspec.json.format(msgspec.json.encode(layouts), indent=1).decode() + "\n"


def main() -> int:
    """Write the file. Returns the exit code."""
    FILE.write_text(layouts_text(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
