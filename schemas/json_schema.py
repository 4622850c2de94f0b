"""The JSON Schema of every subject: ``python -m schemas.json_schema`` writes them to ``schemas/json/``.

They describe the MessagePack map as it decodes. A field's unit is under the keyword ``unit``. MessagePack's bytes
have no JSON type: such a field says what it is not, and its ``contentEncoding`` holds wherever the message is
turned into JSON text.
"""

from __future__ import annotations

import argparse
import inspect
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from schemas.messages import UNIT_KEYWORD
from schemas.subjects import SUBJECTS, Subject

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
DIRECTORY: Final = Path(__file__).parent / "json"
FILE_SUFFIX: Final = ".schema.json"

Schema = dict[str, Any]

_DEFS: Final = "#/$defs/"
_BYTES: Final[Schema] = {
    "description": "MessagePack bin; base64 text where the message is written as JSON.",
    "contentEncoding": "base64",
    "not": {"type": ["array", "boolean", "null", "number", "object"]},
}


def file_name(subject: Subject) -> str:
    """The file of a subject's schema: ``cruiser.Gear-1.schema.json``."""
    return f"{subject.schema_name}-{subject.type.version}{FILE_SUFFIX}"


def schema(subject: Subject) -> Schema:
    """A subject's JSON Schema."""
    definitions = msgspec.json.schema(subject.type)["$defs"]
    structs = {kind.__name__: kind for kind in _structs(subject.type)}
    described = {name: _definition(part, structs.get(name)) for name, part in sorted(definitions.items())}
    root = described.pop(subject.type.__name__)
    head = {"$schema": DIALECT, "$id": file_name(subject), "title": subject.schema_name}
    return (
        head
        | {key: value for key, value in root.items() if key != "title"}
        | ({"$defs": described} if described else {})
    )


def schema_text(subject: Subject) -> str:
    """A subject's JSON Schema as text, always the same for the same message class."""
    return json.dumps(schema(subject), indent=2, ensure_ascii=False) + "\n"


def schema_texts() -> dict[str, str]:
    """The text of every subject's JSON Schema by schema name."""
    return {subject.schema_name: schema_text(subject) for subject in SUBJECTS}


def attribute_texts(kind: type) -> dict[str, str]:
    """What the docstrings of a class and of its bases say of each field."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        _, _, section = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")
        for match in re.finditer(r"^ {4}(\w+): (.*(?:\n {5,}.*)*)", section, re.MULTILINE):
            texts[match[1]] = " ".join(match[2].split())
    return texts


def summary(kind: type) -> str:
    """What the docstring of a class says before it comes to the fields."""
    return _plain(inspect.cleandoc(kind.__doc__ or "").partition("\n\nAttributes:")[0])


def _structs(kind: Any) -> list[type]:  # noqa: ANN401 - msgspec's own type descriptions
    """The message class and every class within its fields."""
    found: list[type] = []

    def visit(info: Any) -> None:  # noqa: ANN401
        match info:
            case msgspec.inspect.Metadata():
                visit(info.type)
            case msgspec.inspect.StructType():
                found.append(info.cls)
                for field in info.fields:
                    visit(field.type)
            case msgspec.inspect.EnumType():
                found.append(info.cls)
            case msgspec.inspect.ListType():
                visit(info.item_type)
            case _:
                return

    visit(msgspec.inspect.type_info(kind))
    return found


def _definition(part: Mapping[str, Any], kind: type | None) -> Schema:
    """A struct or an enumeration, described by its docstring."""
    described = dict(part)
    if kind is None:
        return described
    described["description"] = summary(kind)
    if "properties" in part:
        texts = attribute_texts(kind)
        described["properties"] = {
            name: _property(value, texts.get(name, "")) for name, value in part["properties"].items()
        }
    return described


def _property(part: Mapping[str, Any], about: str) -> Schema:
    """A field: its unit and description stand at the top, whatever lists or nulls are wrapped around its type."""
    bare, unit, inner_about = _unwrapped(part)
    head: Schema = {}
    if about or inner_about:
        head["description"] = _plain(" ".join(filter(None, (_sentence(about), inner_about))))
    if unit:
        head[UNIT_KEYWORD] = unit
    return head | bare


def _unwrapped(part: Mapping[str, Any]) -> tuple[Schema, str, str]:
    """The type without unit and description, and these two."""
    bare = dict(part)
    unit, about = bare.pop(UNIT_KEYWORD, ""), bare.pop("description", "")
    if bare.get("contentEncoding") == "base64":
        return {key: value for key, value in _BYTES.items() if key != "description"}, "", _BYTES["description"]
    if "items" in bare:
        bare["items"], unit, about = _unwrapped(bare["items"])
    elif "anyOf" in bare:
        options = [_unwrapped(option) for option in bare["anyOf"]]
        bare["anyOf"] = [option for option, _, _ in options]
        unit = next(filter(None, (found for _, found, _ in options)), "")
        about = next(filter(None, (found for _, _, found in options)), "")
    return bare, unit, about


def _sentence(text: str) -> str:
    """A docstring's half sentence as a whole one."""
    return text[:1].upper() + text[1:] if text else ""


def _plain(text: str) -> str:
    return " ".join(text.replace("``", "").split())


def files() -> dict[str, str]:
    """The text of every file by its name."""
    return {file_name(subject): schema_text(subject) for subject in SUBJECTS}


def stale(present: Mapping[str, str]) -> list[str]:
    """The names of the files that are missing, out of date, or of a subject that is no more."""
    wanted = files()
    return sorted(name for name in present.keys() | wanted.keys() if present.get(name) != wanted.get(name))


def main(words: Sequence[str] | None = None) -> int:
    """Writes the files, or with ``--check`` only says which ones are not current."""
    parser = argparse.ArgumentParser(description="Write the JSON Schema of every subject.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file is not current")
    parser.add_argument("--directory", type=Path, default=DIRECTORY, help="where the files are")
    arguments = parser.parse_args(words)
    directory: Path = arguments.directory
    names = stale({path.name: path.read_text(encoding="utf-8") for path in directory.glob(f"*{FILE_SUFFIX}")})
    if not arguments.check:
        directory.mkdir(parents=True, exist_ok=True)
        wanted = files()
        for name in names:
            if name in wanted:
                (directory / name).write_text(wanted[name], encoding="utf-8")
            else:
                (directory / name).unlink()
    for name in names:
        sys.stderr.write(f"{'stale' if arguments.check else 'wrote'} {directory / name}\n")
    return int(bool(names)) if arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
