"""Spread tests over the workers of pytest-xdist: ``--dist loadfile``, but system tests go one by one.

Most of a system test is waiting. Files whose tests share a module's fixture stay together, and so do all others.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, Final

import pytest
from xdist.scheduler import LoadScopeScheduling

SYSTEM: Final = "tests/system/"

SHARED: Final = 'scope="module"'  # marks a fixture that is made once for all tests of a file


class Spreading(LoadScopeScheduling):  # type: ignore[misc]  # pytest-xdist has no types
    """Hands out system tests one by one, others file by file, in the order of collection."""

    def __init__(self, config: pytest.Config, log: Any) -> None:  # noqa: ANN401 - pytest-xdist's own
        super().__init__(config, log)
        self._root = config.rootpath

    def _split_scope(self, nodeid: str) -> str:
        return scope_of(nodeid, self._root)


def scope_of(nodeid: str, root: Path) -> str:
    file, _, _ = nodeid.partition("::")
    return nodeid if file.startswith(SYSTEM) and not _shares(root / file) else file


@cache
def _shares(file: Path) -> bool:
    return SHARED in file.read_text("utf-8")
