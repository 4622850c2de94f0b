"""Processes of a user who is not root, also where root runs the tests."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Final

NOBODY: Final = 65534
READS_ALL: Final = ("--inh-caps", "+dac_read_search", "--ambient-caps", "+dac_read_search")


def become_nobody() -> list[str]:
    """A prefix that runs a command as a user who is not root; empty if we are none.

    Where such a user cannot reach this interpreter, as in root's home, the command keeps the right to read.
    """
    if os.getuid() != 0:
        return []
    become = ["setpriv", "--reuid", str(NOBODY), "--regid", str(NOBODY), "--clear-groups"]
    for words in (become, [*become, *READS_ALL]):
        try:
            # By way of env, because setpriv itself still reaches what root does.
            subprocess.run([*words, "env", sys.executable, "-c", ""], check=True, capture_output=True)
        except subprocess.CalledProcessError:
            continue
        return words
    raise AssertionError(f"nobody but root can run {sys.executable}")
