"""The import rules: who knows whom, and where clocks, threads and sockets may appear."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

IO_MODULES = {
    "asyncio",
    "multiprocessing",
    "os",
    "select",
    "selectors",
    "signal",
    "socket",
    "subprocess",
    "sys",
    "threading",
    "time",
}

PURE_SIM = (
    "address",
    "disturbances",
    "faults",
    "feedback",
    "model",
    "motion",
    "parameters",
    "socketcand_protocol",
    "stand_in",
)
PURE_REMOTE = (
    "drive_stream",
    "drive_view",
    "fleet",
    "held_keys",
    "keyboard",
    "reasons_text",
    "refusal",
    "reply",
    "view",
)
PURE_RECORDER = (
    "can_columns",
    "channels",
    "chunk",
    "completeness",
    "effects",
    "fast_path",
    "foxglove_log",
    "gaps",
    "health",
    "inbox",
    "incidents",
    "log_queue",
    "mcap_scan",
    "notices",
    "orders",
    "prologue",
    "protobuf_schema",
    "recording",
    "recovery",
    "retention",
    "robot_log",
    "robots",
    "routes",
    "sample",
    "session",
    "tally",
    "transcode",
)

PURE = [
    *sorted((ROOT / "gateway" / "chassis").glob("*.py")),
    *sorted((ROOT / "gateway" / "command").glob("*.py")),
    *sorted((ROOT / "gateway" / "telemetry").glob("*.py")),
    *(ROOT / "gateway" / f"{name}.py" for name in ("core", "journal", "observation", "rerun", "what_if")),
    *(ROOT / "gateway" / "guard" / f"{name}.py" for name in ("beat", "guardian", "sight", "stopper")),
    ROOT / "gateway" / "cli" / "candump.py",
    *(ROOT / "gateway" / "sim" / f"{name}.py" for name in PURE_SIM),
    *(ROOT / "gateway" / "remote" / f"{name}.py" for name in PURE_REMOTE),
    *(ROOT / "recorder" / f"{name}.py" for name in PURE_RECORDER),
    *sorted((ROOT / "recorder" / "backfill").glob("*.py")),
    *(
        path
        for path in sorted((ROOT / "schemas").glob("*.py"))
        # These two also write the files that they generate.
        if path.name not in {"documents.py", "json_schema.py"}
    ),
]


def imported_modules(path: Path) -> set[str]:
    """The top-level names of every module that a file imports, wherever in the file it does."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.partition(".")[0])
    return names


def test_the_import_contracts_hold() -> None:
    """The contracts of .importlinter are kept."""
    linter = Path(sys.executable).with_name("lint-imports")
    outcome = subprocess.run([linter, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stdout


@pytest.mark.parametrize("path", PURE, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_core_has_no_clock_no_thread_and_no_io(path: Path) -> None:
    """Time is an argument; the outside is in the ports and the run loops."""
    assert imported_modules(path) & IO_MODULES == set()


def test_an_import_of_the_clock_would_be_seen(tmp_path: Path) -> None:
    """The test above can fail: an import inside a function counts."""
    module = tmp_path / "module.py"
    module.write_text("def f():\n    from time import sleep\n    import os.path\n", encoding="utf-8")
    assert imported_modules(module) & IO_MODULES == {"time", "os"}


def test_only_ports_import_can_and_zenoh() -> None:
    """python-can and Zenoh have one room each side."""
    offenders = [
        str(path.relative_to(ROOT))
        for package in ("gateway", "recorder", "schemas")
        for path in sorted((ROOT / package).rglob("*.py"))
        if imported_modules(path) & {"can", "zenoh"} and path.parent.name != "ports"
    ]
    assert offenders == []
