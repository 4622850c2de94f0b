"""Everything that users rely on, as text: a diff in tests/data/interface is a change that users see.

``python -m tests.support.interface`` writes the files again; read the diff before you commit it.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from prometheus_client.parser import text_string_to_metric_families

from gateway.cli.main import COMMANDS, main
from recorder.encoding.protobuf import LOGGED, descriptor_set, schema_name
from recorder.review.catalog.directory import SCHEMA
from recorder.review.columns import columns_of
from schemas.command_line import ExitCode
from tests.support.metrics import full_exposition
from tests.support.reading import topic

DIRECTORY: Final = Path(__file__).parents[1] / "data" / "interface"
ROOTS: Final = [Path(__file__).parents[2] / name for name in ("gateway", "recorder", "schemas")]


def commands() -> Iterator[str]:
    """Every command and action with its arguments in the order of the help; and the exit codes."""
    yield f"exit codes: {', '.join(f'{code.value} {code.name.lower()}' for code in ExitCode)}"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(argparse.ArgumentParser, "parse_args", _raise_parser)
        for name in COMMANDS:
            try:
                main([name])
            except _Declared as declared:
                yield from _arguments(declared.parser)


class _Declared(BaseException):
    """Raised once a command has declared its arguments; no command catches it."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        super().__init__()
        self.parser = parser


def _raise_parser(parser: argparse.ArgumentParser, *_words: object) -> None:
    raise _Declared(parser)


def _arguments(parser: argparse.ArgumentParser) -> Iterator[str]:
    yield f"\n{parser.prog}"
    within: list[argparse.ArgumentParser] = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            within += action.choices.values()
        elif not isinstance(action, argparse._HelpAction):
            yield f"  {_argument(action)}"
    for one in within:
        # A question of `review` declares its arguments when it is asked.
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(argparse.ArgumentParser, "parse_known_args", lambda *_given: (None, []))
            patch.setattr(argparse.ArgumentParser, "parse_known_intermixed_args", lambda *_given: (None, []))
            one.parse_known_args([])
        yield from _arguments(one)


def _argument(action: argparse.Action) -> str:
    name = "/".join(action.option_strings) or str(action.metavar or action.dest)
    says: dict[str, Any] = {
        "metavar": action.metavar if action.option_strings else None,
        "nargs": action.nargs,
        "choices": action.choices and ",".join(sorted(f"{one}" for one in action.choices)),
        "default": None if action.default in (None, False, argparse.SUPPRESS) else action.default,
        "sets": action.dest if "." in action.dest else None,
        "required": action.required or None if action.option_strings else None,
    }
    return " ".join([name, *(f"{key}={value}" for key, value in says.items() if value is not None)])


def environment() -> Iterator[str]:
    pattern = re.compile(r"\"((?:CRUISER|XDG)_[A-Z_]+|HOME|STATE_DIRECTORY|NOTIFY_SOCKET)\"")
    texts = [path.read_text(encoding="utf-8") for root in ROOTS for path in root.rglob("*.py")]
    yield from sorted({name for text in texts for name in pattern.findall(text)})


def metrics() -> Iterator[str]:
    for family in sorted(text_string_to_metric_families(full_exposition()), key=lambda family: family.name):
        labels = sorted({label for sample in family.samples for label in sample.labels})
        yield " ".join([family.samples[0].name, family.type, *labels])


def columns() -> Iterator[str]:
    """Columns of the catalog and of each exported table, with the field numbers of a log's protobuf."""
    yield "catalog.parquet"
    for column in SCHEMA:
        yield f"  {column.name} {column.type}{'' if column.nullable else ' not null'}"
    enumerations: dict[str, Any] = {}
    for kind in sorted(LOGGED, key=schema_name):
        found = columns_of(topic(schema_name(kind), kind))
        numbers = [f" = {field.number}" for field in found.fields or ()]
        yield f"\n{schema_name(kind)}"
        for column, number in zip(found.schema, [""] * (len(found.schema) - len(numbers)) + numbers, strict=True):
            unit = (column.metadata or {}).get(b"unit", b"").decode()
            yield f"  {column.name} {column.type}{unit and f' [{unit}]'}{number}"
        for file in FileDescriptorSet.FromString(descriptor_set(kind)).file:
            enumerations |= {one.name: one for one in file.enum_type}
    for name, enumeration in sorted(enumerations.items()):
        yield f"\n{name}"
        yield from (f"  {value.name} = {value.number}" for value in enumeration.value)


FILES: Final[dict[str, Callable[[], Iterator[str]]]] = {
    "columns.txt": columns,
    "commands.txt": commands,
    "environment.txt": environment,
    "metrics.txt": metrics,
}


def text_of(name: str) -> str:
    return "".join(f"{line}\n" for line in FILES[name]())


if __name__ == "__main__":
    for each in FILES:
        (DIRECTORY / each).write_text(text_of(each), encoding="utf-8")
