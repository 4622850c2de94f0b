"""What holds for a unit test: it starts no process and opens no connection."""

import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
import zenoh

REFUSED = {"subprocess.Popen", "os.fork", "os.posix_spawn", "socket.bind", "socket.connect", "zenoh.open"}

_is_unit_test = False


def _audit(event: str, _arguments: object) -> None:
    if _is_unit_test and event in REFUSED:
        raise AssertionError(f"{event} in a unit test: it belongs in tests/system")


sys.addaudithook(_audit)
_zenoh_open = zenoh.open


def _audited_open(*arguments: Any, **options: Any) -> zenoh.Session:  # noqa: ANN401 - as Zenoh's own
    """Open a session; the interpreter does not see Zenoh's own threads."""
    sys.audit("zenoh.open")
    return _zenoh_open(*arguments, **options)


zenoh.open = _audited_open


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Refuse sockets and processes while a unit test or its fixtures run; an audit hook cannot be removed."""
    global _is_unit_test  # noqa: PLW0603 - the hook is the interpreter's, not a fixture's
    # Here pytest asks the conftest files of all directories.
    _is_unit_test = item.path.is_relative_to(Path(__file__).parent)
    try:
        return (yield)
    finally:
        _is_unit_test = False
