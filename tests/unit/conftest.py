"""What holds for a unit test: it starts no process and opens no connection."""

import sys
from collections.abc import Iterator

import pytest

REFUSED = {"subprocess.Popen", "os.fork", "os.posix_spawn", "socket.bind", "socket.connect"}

_is_unit_test = False


def _audit(event: str, _arguments: object) -> None:
    if _is_unit_test and event in REFUSED:
        raise AssertionError(f"{event} in a unit test: it belongs in tests/system")


sys.addaudithook(_audit)


@pytest.fixture(autouse=True)
def _no_process_and_no_socket() -> Iterator[None]:
    """An audit hook cannot be removed, so it only looks while a unit test runs."""
    global _is_unit_test  # noqa: PLW0603 - the hook is the interpreter's, not a fixture's
    _is_unit_test = True
    yield
    _is_unit_test = False
