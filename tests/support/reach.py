"""The modules that each process loads at its start: ``make reach``.

Read from the sources: imports at the top of a module count, those in functions or for types alone do not.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]

PROCESSES: Final = {
    "cruiser gateway": ("gateway.cli.main", "gateway.cli.configuration_file", "gateway.cli.gateway"),
    "its guard": ("gateway.host.guard_main",),
    "cruiser record": ("gateway.cli.main", "gateway.cli.configuration_file", "recorder.cli.record"),
    "cruiser review why": (
        "gateway.cli.main",
        "gateway.cli.configuration_file",
        "recorder.cli.review",
        "recorder.cli.why",
    ),
}
"""Processes, and the modules that start them: the command line imports a command by name."""


def modules() -> dict[str, Path]:
    """The product's modules and packages by name."""
    found = {}
    for package in ("gateway", "recorder", "schemas"):
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports() -> dict[str, set[str]]:
    """The modules of ours that each imports at its top."""
    known = modules()
    return {name: set(_imported(ast.parse(path.read_text("utf-8")).body, known)) for name, path in known.items()}


def _imported(body: list[ast.stmt], known: dict[str, Path]) -> Iterator[str]:
    for one in body:
        if isinstance(one, ast.Import):
            yield from (alias.name for alias in one.names if alias.name in known)
        elif isinstance(one, ast.ImportFrom) and one.module:
            for alias in one.names:
                name = f"{one.module}.{alias.name}"
                yield from (which for which in (name, one.module) if which in known)
        elif isinstance(one, ast.Try):
            yield from _imported(one.body, known)


def reached(starts: tuple[str, ...], found: dict[str, set[str]]) -> set[str]:
    """All modules that are loaded with these."""
    seen: set[str] = set()
    waiting = list(starts)
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting += [*found[name], *filter(None, [name.rpartition(".")[0]])]
    return seen


def main() -> None:
    """Print the modules of each process by folder, and their number without packages."""
    known, found = modules(), imports()
    for process, starts in PROCESSES.items():
        names = sorted(name for name in reached(starts, found) if known[name].name != "__init__.py")
        lines = sum(len(known[name].read_text("utf-8").splitlines()) for name in names)
        print(f"{process}: {len(names)} modules, {lines:,} lines")  # noqa: T201 - the output
        for folder in sorted({name.rpartition(".")[0] for name in names}):
            leaves = [name.rpartition(".")[2] for name in names if name.rpartition(".")[0] == folder]
            print(f"  {folder}: {', '.join(leaves)}")  # noqa: T201 - the output


if __name__ == "__main__":
    main()
