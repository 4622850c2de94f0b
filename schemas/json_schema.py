"""The JSON Schema of every message, request and reply: ``python -m schemas.json_schema`` writes ``schemas/json/``.

They describe the decoded MessagePack map. A field's unit is under the keyword ``unit``. MessagePack's bytes have
no JSON type: their schema excludes all other types, and ``contentEncoding`` describes them in JSON text.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from schemas.configuration import attribute_texts, plain_text, summary
from schemas.decisions import Reply, StatementReply
from schemas.messages import UNIT_KEYWORD, Message
from schemas.recording import RecorderReply
from schemas.requests import Request
from schemas.subjects import ALL_SUBJECTS, ALL_VERBS, COMMANDS, STATEMENT_REPLY, SUBJECTS

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
DIRECTORY: Final = Path(__file__).parent / "json"
FILE_SUFFIX: Final = ".schema.json"

Schema = dict[str, Any]
Kind = type[Message] | type[Request] | type[Reply] | type[RecorderReply]

_BYTES_ABOUT: Final = "MessagePack bin; base64 text where the message is written as JSON."
_BYTES: Final[Schema] = {
    "contentEncoding": "base64",
    "not": {"type": ["array", "boolean", "null", "number", "object"]},
}


KINDS: Final[dict[str, Kind]] = (
    {subject.schema_name: subject.type for subject in ALL_SUBJECTS}
    | {verb.schema_name: verb.request for verb in ALL_VERBS}
    | {verb.reply_schema_name: verb.reply for verb in ALL_VERBS}
    | {STATEMENT_REPLY: StatementReply}
)
"""Every class that is sent over Zenoh, by its schema's name."""


def file_name(name: str) -> str:
    """The file of a schema: ``cruiser.Gear-1.schema.json``."""
    return f"{name}-{KINDS[name].version}{FILE_SUFFIX}"


def schema(name: str) -> Schema:
    kind = KINDS[name]
    definitions = msgspec.json.schema(kind)["$defs"]
    within = {inner.__name__: inner for inner in classes(kind)}
    described = {key: _definition(part, within.get(key)) for key, part in sorted(definitions.items())}
    root = described.pop(kind.__name__)
    if not issubclass(kind, Request):
        root = _with_every_field(root)
    head = {"$schema": DIALECT, "$id": file_name(name), "title": name}
    return (
        head
        | {key: value for key, value in root.items() if key != "title"}
        | ({"$defs": described} if described else {})
    )


def schema_text(name: str) -> str:
    """A JSON Schema as text, always the same for the same class."""
    return json.dumps(schema(name), indent=2, ensure_ascii=False) + "\n"


def robot_schema_texts() -> dict[str, str]:
    """The JSON Schemas of a robot's messages, requests and replies, as text by schema name."""
    names = {subject.schema_name: None for subject in SUBJECTS}
    for command in COMMANDS:
        names |= {command.schema_name: None, command.reply_schema_name: None}
    return {name: schema_text(name) for name in names}


def classes(kind: type[msgspec.Struct]) -> list[type]:
    found: list[type] = []

    def visit(info: msgspec.inspect.Type) -> None:
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


def _with_every_field(root: Schema) -> Schema:
    """Make every field required, without its default: the gateway sends all of them."""
    properties = {
        name: {key: value for key, value in part.items() if key != "default"}
        for name, part in root["properties"].items()
    }
    return root | {"properties": properties, "required": list(properties)}


def _property(part: Mapping[str, Any], about: str) -> Schema:
    """A field, with its unit and description at the top instead of within lists or options."""
    bare, unit, inner_about = _unwrapped(part)
    head: Schema = {}
    if about or inner_about:
        head["description"] = plain_text(" ".join(filter(None, (_sentence(about), inner_about))))
    if unit:
        head[UNIT_KEYWORD] = unit
    return head | bare


def _unwrapped(part: Mapping[str, Any]) -> tuple[Schema, str, str]:
    """The type without unit and description, and these two."""
    bare = dict(part)
    unit, about = bare.pop(UNIT_KEYWORD, ""), bare.pop("description", "")
    if bare.get("contentEncoding") == "base64":
        return dict(_BYTES), "", _BYTES_ABOUT
    if "items" in bare:
        bare["items"], unit, about = _unwrapped(bare["items"])
    elif "anyOf" in bare:
        options = [_unwrapped(option) for option in bare["anyOf"]]
        bare["anyOf"] = [option for option, _, _ in options]
        unit = next(filter(None, (found for _, found, _ in options)), "")
        about = next(filter(None, (found for _, _, found in options)), "")
    return bare, unit, about


def _sentence(text: str) -> str:
    """Begin a docstring's text with a capital letter."""
    return text[:1].upper() + text[1:] if text else ""


def files() -> dict[str, str]:
    return {file_name(name): schema_text(name) for name in KINDS}


def stale(present: Mapping[str, str]) -> list[str]:
    """The names of files that are missing, out of date, or of a removed class."""
    wanted = files()
    return sorted(name for name in present.keys() | wanted.keys() if present.get(name) != wanted.get(name))


def main(words: Sequence[str] | None = None) -> int:
    """Write the files, or with ``--check`` only list those that are not current."""
    parser = argparse.ArgumentParser(description="Write the JSON Schema of every message, request and reply.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file is not current")
    arguments = parser.parse_args(words)
    names = stale({path.name: path.read_text(encoding="utf-8") for path in DIRECTORY.glob(f"*{FILE_SUFFIX}")})
    wanted = files()
    for name in names:
        sys.stderr.write(f"{'stale' if arguments.check else 'wrote'} {DIRECTORY / name}\n")
        if arguments.check:
            continue
        if name in wanted:
            (DIRECTORY / name).write_text(wanted[name], encoding="utf-8")
        else:
            (DIRECTORY / name).unlink()
    return int(bool(names)) if arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
