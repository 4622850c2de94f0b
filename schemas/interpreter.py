"""Our own modules as processes of their own."""

import sys
from typing import Final

SAFE_PATH_VARIABLE: Final = "PYTHONSAFEPATH"
"""The same as ``-P``, for an interpreter that a library starts."""


def module_command(module: str, *words: str) -> tuple[str, ...]:
    """Return the command line that runs a module of this installation.

    With ``-P``: a Python file in the working directory is never taken for a module. People keep logs there that
    others have sent them.
    """
    return sys.executable, "-P", "-m", module, *words
