"""The name under which an operator commands: a chunk of every command's key."""

from __future__ import annotations

import getpass
import re
from typing import Final

LONGEST: Final = 64


def login_operator() -> str:
    """The login name, made to fit."""
    try:
        login = getpass.getuser()
    except (KeyError, OSError):  # Nobody by this number is known, as in some containers.
        login = ""
    return fitting(login)


def fitting(login: str) -> str:
    """A login name as an operator's name."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", login)[:LONGEST] or "operator"
