# SPDX-License-Identifier: Apache-2.0
"""The generated parts of the documents that are made from the tables of ``schemas``."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Sequence
from enum import Enum
from typing import Any, Final

import msgspec
from cantools.database.can import Database
from cantools.database.can import Message as CanMessage

from schemas import json_schema, keys
from schemas.can_word import snake_case
from schemas.configuration import SETTINGS, summary, write_value
from schemas.cruiser import DBC_FILES, dbc_text
from schemas.messages import UNIT_KEYWORD, Message, Variant
from schemas.reasons import TEXTS
from schemas.requests import Leased
from schemas.settings import FULL, PROFILES, PUBLISHED, rate_in_words
from schemas.subjects import (
    BY_DBC_MESSAGE,
    BY_VERB,
    COMMAND_CHUNK,
    COMMAND_QOS,
    COMMANDS,
    LIVELINESS_CHUNK,
    RECORDER_CHUNK,
    RECORDER_COMMANDS,
    RECORDER_SUBJECTS,
    SUBJECTS,
    Asking,
    Pattern,
    Qos,
    Subject,
    Verb,
)

Part = Callable[[], str]  # makes the text of a part

_UNBOUNDED: Final = 2**53 - 1  # from here on an upper bound is only what a number can hold, and says nothing

_DETAILS: Final = re.compile(r" (from )?[\d.-]+\Z| (from )?[\d.-]+(?= or)| or null")
"""The parts of a type's description besides the type: bounds and null."""

_COMMON_FIELDS: Final = tuple(field.name for field in msgspec.structs.fields(Message))


def key_table() -> str:
    """Every key: what it is, how often, quality of service, payload."""
    rows = [_key_row(subject) for subject in SUBJECTS]
    token = (f"`{LIVELINESS_CHUNK}`, a liveliness token", "connected; never proof of health", "", "", "none")
    common = " and ".join(f"`{name}`" for name in _COMMON_FIELDS)
    notes = (
        f"Every key begins with `{{root}}/{{robot}}/`; the robot is `{keys.ROBOT_PATTERN}`. Every payload is a "
        f"MessagePack map, which also has {common}; the Zenoh encoding is `{SUBJECTS[0].encoding}`, and so on."
    )
    return f"{table(('key', 'what', 'rate', 'QoS', 'payload'), [*rows, token])}\n\n{notes}"


def recorder_key_table() -> str:
    rows = [_key_row(subject) for subject in RECORDER_SUBJECTS]
    prefix = f"`{{root}}/{RECORDER_CHUNK}/{{recorder}}"
    notes = f"Every key begins with {prefix}/`; {prefix}` itself is a liveliness token."
    return f"{table(('key', 'what', 'rate', 'QoS', 'payload'), rows)}\n\n{notes}"


def _key_row(subject: Subject) -> tuple[str, ...]:
    return (
        f"`{subject.name}`",
        subject.about,
        subject.rate,
        "that of the query" if subject.pattern is Pattern.QUERIED else _qos(subject.qos),
        f"[{subject.type.__name__}](messages.md#{subject.type.__name__.lower()})",
    )


def settings_table() -> str:
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
    return table(("setting", "environment variable", "value", "start value", "meaning"), rows)


def profile_table() -> str:
    """The rates at which each subject leaves a robot, by profile."""
    profiles = [profile for profile in PROFILES if profile != FULL]
    rows = [
        (
            f"`{subject.name}`",
            subject.rate,
            _qos(subject.qos).partition(",")[0],
            *(rate_in_words(profile, subject.name) for profile in profiles),
        )
        for subject in PUBLISHED
    ]
    return table(("key", f"`{FULL}`", "priority", *(f"`{profile}`" for profile in profiles)), rows)


def message_tables() -> str:
    """Every message with its fields, then what stands within messages, then the enumerations."""
    signals = _signal_comments()
    everywhere = {field: text for texts in signals.values() for field, text in texts.items()}
    blocks = ["## Messages", "### In every message", field_table(_common_properties(), {})]
    prefixes = dict.fromkeys(SUBJECTS, "{root}/{robot}")
    prefixes |= dict.fromkeys(RECORDER_SUBJECTS, f"{{root}}/{RECORDER_CHUNK}/{{recorder}}")
    for kind in dict.fromkeys(subject.type for subject in prefixes):
        subjects = [subject for subject in prefixes if subject.type is kind]
        first = subjects[0]
        schema = json_schema.schema(first.schema_name)
        own = {name: part for name, part in schema["properties"].items() if name not in _COMMON_FIELDS}
        places = " and ".join(f"`{prefixes[one]}/{one.name}`, {one.rate}," for one in subjects)
        blocks += [
            f"### {kind.__name__}",
            f"{first.about[0].upper()}{first.about[1:]}. {schema['description']}"
            if first.dbc_message
            else schema["description"],
            f"Key {places} encoding `{first.encoding}`.",
            field_table(own, signals.get(first.dbc_message, everywhere)),
        ]
    names = [subject.schema_name for subject in prefixes]
    return "\n\n".join([*blocks, *_records(names), *_enumerations(names)])


def command_table() -> str:
    rows = [
        (
            f"`{command.verb}`",
            command.asking.value,
            _request_fields(command),
            *_schemas(command),
            command.about,
        )
        for command in COMMANDS
    ]
    notes = (
        f"Every key is `{{root}}/{{robot}}/{COMMAND_CHUNK}/{{operator}}/{{verb}}`; the operator is "
        f"`{keys.OPERATOR_PATTERN}`. QoS: {_qos(COMMAND_QOS)}. A request is a MessagePack map; a field in "
        f"brackets may be left out, and a field that the verb does not have is refused. {_encodings(COMMANDS[0])}"
    )
    return f"{table(('verb', 'sent as', 'request', 'its schema', 'reply', 'what it does'), rows)}\n\n{notes}"


def _schemas(command: Verb[Any]) -> tuple[str, str]:
    request, reply = (
        f"`{encoding.rpartition('.')[2]}`" for encoding in (command.encoding, command.reply_encoding)
    )
    return request, "none" if command.asking is Asking.PUT else reply


def _encodings(first: Verb[Any]) -> str:
    return (
        f"The Zenoh encoding of a request is made of its schema, `{first.encoding}`, and so is that of a reply, "
        f"`{first.reply_encoding}`."
    )


def request_tables() -> str:
    lease = {"lease": json_schema.schema(BY_VERB["renew"].schema_name)["properties"]["lease"]}
    blocks = ["## Requests", "### In every request that wants the lease", field_table(lease, {})]
    for command in COMMANDS:
        schema = json_schema.schema(command.schema_name)
        needs = " Wants the lease, and an engaged robot." if command.engaged_only else " Wants the lease."
        wants = needs if issubclass(command.request, Leased) else ""
        blocks += [f"### {command.verb}", schema["description"] + wants]
        own = {name: part for name, part in schema["properties"].items() if name not in lease}
        if own:
            blocks.append(field_table(own, {}))
    blocks += ["## Replies", *_replies(COMMANDS)]
    return "\n\n".join([*blocks, *_enumerations(command.schema_name for command in COMMANDS)])


def _replies(commands: Iterable[Verb[Any]]) -> list[str]:
    blocks: list[str] = []
    for name in dict.fromkeys(command.reply_schema_name for command in commands):
        schema = json_schema.schema(name)
        blocks += [f"### {json_schema.KINDS[name].__name__}", schema["description"]]
        blocks.append(field_table(schema["properties"], {}))
    return blocks


def recorder_command_tables() -> str:
    """Every verb of a recorder, then its requests and replies."""
    rows = [(f"`{one.verb}`", _request_fields(one), *_schemas(one), one.about) for one in RECORDER_COMMANDS]
    blocks = [
        table(("verb", "request", "its schema", "reply", "what it does"), rows),
        (
            f"Every key is `{{root}}/{RECORDER_CHUNK}/{{recorder}}/{COMMAND_CHUNK}/{{operator}}/{{verb}}`. "
            f"{_encodings(RECORDER_COMMANDS[0])}"
        ),
    ]
    for one in RECORDER_COMMANDS:
        schema = json_schema.schema(one.schema_name)
        if schema["properties"]:
            blocks += [f"### {one.verb}", schema["description"], field_table(schema["properties"], {})]
    return "\n\n".join([*blocks, *_replies(RECORDER_COMMANDS)])


def reason_table() -> str:
    rows = [(f"`{reason.value}`", text.means, text.cure) for reason, text in TEXTS.items()]
    return table(("reason", "it means", "what would cure it"), rows)


def _records(names: Iterable[str]) -> list[str]:
    definitions: dict[str, Any] = {}
    for name in names:
        definitions |= json_schema.schema(name).get("$defs", {})
    blocks = ["## Records within messages"]
    for name, part in sorted(definitions.items()):
        if "properties" in part:
            blocks += [f"### {name}", part["description"], field_table(part["properties"], {})]
    return blocks


def _enumerations(names: Iterable[str]) -> list[str]:
    """The enumerations of the fields of these classes; values in the order of the class, which has a meaning."""
    kinds = {kind for name in names for kind in json_schema.classes(json_schema.KINDS[name])}
    blocks = ["## Enumerations"]
    for kind in sorted(kinds, key=lambda kind: kind.__name__):
        if issubclass(kind, Enum):
            values = ", ".join(f"`{member.value}`" for member in kind)
            blocks += [f"### {kind.__name__}", summary(kind), f"Values: {values}."]
    return blocks


def _common_properties() -> dict[str, Any]:
    properties = json_schema.schema(SUBJECTS[0].schema_name)["properties"]
    return {name: properties[name] for name in _COMMON_FIELDS}


def _signal_comments() -> dict[str, dict[str, str]]:
    """Return the DBC's comment on each field: frame name, then field, then comment.

    A sentence that only one variant's file has describes that variant's scale, not the field, and is left out.
    """
    coarse, fine = (
        {
            (message.name, signal.name): _sentences(str(signal.comment or ""))
            for message in _messages(variant)
            for signal in message.signals
        }
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


def _messages(variant: Variant) -> list[CanMessage]:
    database = Database()
    database.add_dbc_string(dbc_text(variant))
    return database.messages


def _sentences(comment: str) -> list[str]:
    """The sentences of a comment, without the place in the manual that they begin with."""
    text = re.sub(r"^manual V2\.0[^:]*: ", "", comment)
    return re.split(r"(?<=\.) (?=[A-Za-z])", text[0].upper() + text[1:])


def field_table(properties: dict[str, Any], comments: dict[str, str]) -> str:
    """A row for each field of a JSON Schema; ``comments`` say what the schema does not."""
    rows = [
        (
            f"`{name}`",
            _type_words(part) + _left_out(part),
            part.get(UNIT_KEYWORD, ""),
            part.get("description") or comments.get(name, ""),
        )
        for name, part in properties.items()
    ]
    return table(("field", "type", "unit", "meaning"), rows)


def _left_out(part: dict[str, Any]) -> str:
    """Return the words for a field's default, or for a field that may be left out; empty if it is required."""
    if "default" not in part:
        return ""
    return "; may be left out" if part["default"] is None else f"; `{_written(part['default'])}` if left out"


def _written(value: object) -> str:
    return json.dumps(value).strip('"')


def _request_fields(command: Verb[Any]) -> str:
    """The fields of a request in one line, those in brackets that may be left out."""
    schema = json_schema.schema(command.schema_name)
    required = schema["required"]
    return (
        ", ".join(
            _in_a_word(name, part) if name in required else f"[{_in_a_word(name, part)}]"
            for name, part in schema["properties"].items()
        )
        or "nothing"
    )


def _in_a_word(name: str, part: dict[str, Any]) -> str:
    return f"`{name}` {part.get(UNIT_KEYWORD) or re.sub(_DETAILS, '', _type_words(part))}"


def _type_words(part: dict[str, Any]) -> str:
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


def _qos(qos: Qos) -> str:
    words = [qos.priority.value.lower().replace("_", " "), "drop"]
    if qos.express:
        words.append("express")
    if qos.history == 1:
        words.append("late joiners get the last")
    elif qos.history:
        words.append(f"late joiners get the last {qos.history}")
    if qos.kept_bytes:
        words.append(f"the newest {qos.kept_bytes // 1_000_000} MB are kept for queries")
    return ", ".join(words)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


PARTS: Final[dict[str, Part]] = {
    "keys": key_table,
    "settings": settings_table,
    "profiles": profile_table,
    "messages": message_tables,
    "commands": command_table,
    "requests": request_tables,
    "reasons": reason_table,
    "recorder-keys": recorder_key_table,
    "recorder-commands": recorder_command_tables,
}
