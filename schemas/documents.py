"""The generated parts of README.md and docs/*.md: ``python -m schemas.documents`` rewrites them.

A part stands between ``<!-- generated: NAME -->`` and ``<!-- end -->``; the text around it is written by hand.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from schemas import json_schema, keys, messages
from schemas.dbc_files import DBC_FILES, dbc_text, signal_comments
from schemas.messages import UNIT_KEYWORD, Message
from schemas.setting_table import SETTINGS
from schemas.snake_case import snake_case
from schemas.subjects import BY_DBC_MESSAGE, LIVELINESS_CHUNK, SUBJECTS, Pattern, Subject
from schemas.toml_text import write_value

ROOT: Final = Path(__file__).parent.parent

_PART: Final = re.compile(r"<!-- generated: ([\w-]+) -->\n(.*?)<!-- end -->", re.DOTALL)
_UNBOUNDED: Final = 2**63 - 1
_DETAILS: Final = re.compile(r" (from )?[\d.-]+$| (from )?[\d.-]+(?= or)| or null")
"""What a type's words hold besides the type."""

FIELDS_LISTED: Final = 7
"""A message with more fields than this has them in docs/messages.md alone."""

_COMMON_FIELDS: Final = tuple(field.name for field in msgspec.structs.fields(Message))


class UnknownPartError(Exception):
    """A document asks for a part that is not generated."""


def rewrite(text: str) -> str:
    """The document with every generated part current; one without markers is returned as it is.

    Raises:
        UnknownPartError: a marker names no part.
    """

    def replace(match: re.Match[str]) -> str:
        name = match[1]
        if name not in PARTS:
            raise UnknownPartError(f"there is no generated part {name!r}; there are {', '.join(PARTS)}")
        return f"<!-- generated: {name} -->\n\n{PARTS[name]()}\n\n<!-- end -->"

    return _PART.sub(replace, text)


def key_table() -> str:
    """Every key: what it is, how often, quality of service, payload fields."""
    rows = [
        (
            f"`{subject.name}`",
            subject.about,
            subject.rate,
            _qos(subject),
            f"{subject.type.__name__}: {_field_list(subject)}",
        )
        for subject in SUBJECTS
    ]
    token = (f"`{LIVELINESS_CHUNK}`, a liveliness token", "connected; never proof of health", "", "", "none")
    common = " and ".join(f"`{name}`" for name in _COMMON_FIELDS)
    notes = (
        f"Every key begins with `{{root}}/{{robot}}/`; the robot is `{keys.ROBOT_PATTERN}`. Every payload is a "
        f"MessagePack map, which also has {common}; the Zenoh encoding is `{SUBJECTS[0].encoding}`, and so on. A "
        "field with a unit is a number. Bounds, enumerations, and which fields may be null: docs/messages.md."
    )
    return f"{_table(('key', 'what', 'rate', 'QoS', 'payload'), [*rows, token])}\n\n{notes}"


def settings_table() -> str:
    """Every setting: key, environment variable, right values, start value, meaning."""
    rows = [
        (
            f"`{setting.key}`",
            f"`{setting.variable}`",
            # A pattern is full of what Markdown takes for emphasis.
            re.sub(r"(?<=of the form )(.*)", r"`\1`", setting.wants),
            f"`{write_value(setting.start)}`",
            setting.about,
        )
        for setting in SETTINGS.values()
    ]
    return _table(("setting", "environment variable", "value", "start value", "meaning"), rows)


def message_tables() -> str:
    """Every message with its fields, then what stands within messages, then the enumerations."""
    signals = _signal_comments()
    everywhere = {field: text for texts in signals.values() for field, text in texts.items()}
    blocks = ["## Messages", "### In every message", _field_table(_common_properties(), {})]
    definitions: dict[str, Any] = {}
    for subject in SUBJECTS:
        schema = json_schema.schema(subject)
        definitions |= schema.get("$defs", {})
        own = {name: part for name, part in schema["properties"].items() if name not in _COMMON_FIELDS}
        blocks += [
            f"### {subject.type.__name__}",
            f"{subject.about[0].upper()}{subject.about[1:]}. {schema['description']}"
            if subject.dbc_message
            else schema["description"],
            f"Key `{{root}}/{{robot}}/{subject.name}`, {subject.rate}, encoding `{subject.encoding}`.",
            _field_table(own, signals.get(subject.dbc_message, everywhere)),
        ]
    structs = {name: part for name, part in sorted(definitions.items()) if "properties" in part}
    blocks.append("## Records within messages")
    for name, part in structs.items():
        blocks += [f"### {name}", part["description"], _field_table(part["properties"], {})]
    blocks.append("## Enumerations")
    for name in sorted(definitions.keys() - structs.keys()):
        blocks += [f"### {name}", definitions[name]["description"], _values(name)]
    return "\n\n".join(blocks)


def _common_properties() -> dict[str, Any]:
    properties = json_schema.schema(SUBJECTS[0])["properties"]
    return {name: properties[name] for name in _COMMON_FIELDS}


def _signal_comments() -> dict[str, dict[str, str]]:
    """What the DBC says of each field: frame name, then field, then comment.

    A sentence that only one variant's file has is about that variant's scale, not about the field.
    """
    coarse, fine = (
        {key: _sentences(comment) for key, comment in signal_comments(dbc_text(variant)).items()}
        for variant in DBC_FILES
    )
    comments: dict[str, dict[str, str]] = {}
    for (frame, signal), sentences in coarse.items():
        subject = BY_DBC_MESSAGE.get(frame)
        if subject is None:
            continue
        text = " ".join(sentence for sentence in sentences if sentence in fine[frame, signal])
        snake = snake_case(signal)
        fields = [field.name for field in msgspec.structs.fields(subject.type)]
        named = [field for field in fields if field == snake or field.startswith(f"{snake}_")]
        comments.setdefault(frame, {}).update(dict.fromkeys(named, text))
    return comments


def _sentences(comment: str) -> list[str]:
    """The sentences of a comment, without the place in the manual that they begin with."""
    text = re.sub(r"^manual V2\.0[^:]*: ", "", comment)
    return re.split(r"(?<=\.) (?=[A-Za-z])", text[0].upper() + text[1:])


def _values(name: str) -> str:
    """The values in the order of the class, which is the order of meaning."""
    return "Values: " + ", ".join(f"`{member.value}`" for member in getattr(messages, name)) + "."


def _field_table(properties: dict[str, Any], comments: dict[str, str]) -> str:
    rows = [
        (
            f"`{name}`",
            _type_words(part),
            part.get(UNIT_KEYWORD, ""),
            part.get("description") or comments.get(name, ""),
        )
        for name, part in properties.items()
    ]
    return _table(("field", "type", "unit", "meaning"), rows)


def _field_list(subject: Subject) -> str:
    """The fields in one line: each with its unit, else with its type in a word; many fields are only counted."""
    properties = json_schema.schema(subject)["properties"]
    fields = {name: part for name, part in properties.items() if name not in _COMMON_FIELDS}
    if len(fields) > FIELDS_LISTED:
        return f"{len(fields)} fields, in [docs/messages.md](docs/messages.md)"
    return ", ".join(
        f"`{name}` {part.get(UNIT_KEYWORD) or re.sub(_DETAILS, '', _type_words(part))}"
        for name, part in fields.items()
    )


def _type_words(part: dict[str, Any]) -> str:
    """A JSON Schema type in words."""
    match part:
        case {"$ref": str(reference)}:
            return reference.rpartition("/")[2]
        case {"anyOf": [inner, {"type": "null"}]}:
            return f"{_type_words(inner)} or null"
        case {"contentEncoding": _}:
            return "bytes"
        case {"type": "array", "items": item}:
            return f"list of {_type_words(item)}"
        case {"type": "object", "additionalProperties": value}:
            return f"map of string to {_type_words(value)}"
        case {"type": str(name)}:
            return name + _range(part)
        case _:
            raise ValueError(f"no words for {part}")


def _range(part: dict[str, Any]) -> str:
    low, high = part.get("minimum"), part.get("maximum")
    if low is None:
        return ""
    return f" from {low}" if high is None or high >= _UNBOUNDED else f" {low}..{high}"


def _qos(subject: Subject) -> str:
    if subject.pattern is Pattern.QUERIED:
        return "that of the query"
    qos = subject.qos
    words = [qos.priority.value.lower().replace("_", " "), "drop"]
    if qos.express:
        words.append("express")
    return ", ".join(words)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


PARTS: Final = {"keys": key_table, "settings": settings_table, "messages": message_tables}


def main(words: Sequence[str] | None = None) -> int:
    """Rewrites the documents, or with ``--check`` only says which ones are not current."""
    parser = argparse.ArgumentParser(description="Rewrite the generated parts of README.md and docs/*.md.")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a document is not current")
    parser.add_argument("--root", type=Path, default=ROOT, help="the project's directory")
    arguments = parser.parse_args(words)
    root: Path = arguments.root
    stale = 0
    for path in [root / "README.md", *sorted(root.glob("docs/*.md"))]:
        if not path.exists():
            continue
        text = path.read_text(encoding="utf-8")
        try:
            current = rewrite(text)
        except UnknownPartError as error:
            sys.stderr.write(f"{path}: {error}\n")
            return 1
        if current != text:
            stale += 1
            if not arguments.check:
                path.write_text(current, encoding="utf-8")
            sys.stderr.write(f"{'stale' if arguments.check else 'wrote'} {path}\n")
    return int(bool(stale)) if arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
