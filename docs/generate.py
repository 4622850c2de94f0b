# SPDX-License-Identifier: Apache-2.0
"""Rewrite the generated parts of README.md and docs/*.md: ``make generate``.

A part stands between ``<!-- generated: NAME -->`` and ``<!-- end -->``. The text around it is written by hand.
"""

from __future__ import annotations

import argparse
import inspect
import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, Final

import msgspec
from cantools.database.can import Database
from cantools.database.can import Message as CanMessage

from gateway import LeaseLost, Refused, Robot, Stopped, Unreachable
from gateway.chassis.cruiser import gate
from gateway.chassis.cruiser.frames import DRIVE_COMMAND, STEERING_COMMAND, TARGET_ANGLE, TARGET_SPEED, load
from gateway.chassis.frame import hex_identifier
from gateway.client.link import Sighting
from gateway.client.refusal import RobotError
from gateway.client.robot import Lease
from gateway.command.rulings import STOPS, diagram
from gateway.doctor.checks import CHECKS
from gateway.metrics import MEASURES
from recorder import read_log
from recorder.reading.rows import END_OF_TIME_NS
from recorder.review.messages import LogMessage, LogMessages
from schemas import json_schema, keys
from schemas.can_word import snake_case
from schemas.command_line import CommandError
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


TABLES: Final[dict[str, Part]] = {
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


ROOT: Final = Path(__file__).parent.parent

LIBRARY: Final = (
    Robot,
    Lease,
    Sighting,
    CommandError,
    RobotError,
    Refused,
    Stopped,
    LeaseLost,
    Unreachable,
    read_log,
    LogMessages,
    LogMessage,
)


def state_diagram() -> str:
    """The arbiter's states, as a diagram that Markdown viewers draw."""
    return f"```mermaid\n{diagram()}\n```"


def stop_table() -> str:
    """Every cause to stop: how hard, and whether it is latched."""
    rows = [
        (
            f"`{reason.value}`",
            TEXTS[reason].means,
            "emergency" if stop.at_once else "normal",
            "yes" if stop.latched else "",
        )
        for reason, stop in STOPS.items()
    ]
    return table(("cause", "it means", "deceleration", "latched"), rows)


_TESTS: Final = "tests/unit/gateway/chassis/cruiser/test_gate"
_RISES: Final = (gate.SPEED_RISE_RAW[Variant.COARSE], gate.SPEED_RISE_RAW[Variant.FINE])

BUS_RULES: Final = (
    ("identifiers", "the eight above, extended", "_exhausted.py::test_no_other_identifier"),
    ("kind", "classic data frames of 8 bytes", ".py::test_every_length_but_eight_is_refused"),
    (
        "bits",
        "those above, the alive counter (52..55) and the checksum (56..63), which is right",
        "_exhausted.py::test_every_pattern_of_a_frame",
    ),
    ("other bits", "none", "_exhausted.py::test_one_and_two_wrong_bits"),
    (
        "alive counter",
        "the one after the last of that identifier, modulo 16",
        "_exhausted.py::test_every_counter_after_every_counter",
    ),
    (
        "rate",
        f"at most {gate.RATE_FRAMES} frames of an identifier in {gate.RATE_WINDOW_NS // 1_000_000} ms",
        ".py::test_the_rate_of_each_frame_is_bounded",
    ),
    (
        "burst",
        "drive, gear, steering, braking and parking, in this order, then others; each once; all or nothing",
        ".py::test_a_burst_is_whole_and_in_order",
    ),
    (
        "after a part of a burst",
        "at zero speed also drive, parking, gear, steering and braking, in this order",
        ".py::test_a_torn_burst_may_be_followed_by_the_brake_first",
    ),
    ("values", "those above", "_exhausted.py::test_every_value_of_every_signal"),
    ("enables", "all five or none", ".py::test_each_combination_of_enables"),
    (
        "without the enables",
        "neutral, zero speed, parking request",
        "_exhausted.py::test_every_combination_of_two_bursts",
    ),
    (
        "neutral",
        "with the parking request, at zero speed",
        ".py::test_what_contradicts_itself_is_refused",
    ),
    (
        "a speed",
        "in reverse or drive, without parking request",
        ".py::test_what_contradicts_itself_is_refused",
    ),
    (
        "the speed rises",
        f"a burst by {_RISES[0]} bit (coarse), {_RISES[1]} bits (fine) at most; never in a stop",
        "_exhausted.py::test_every_speed_step",
    ),
    (
        "the angle changes",
        f"a burst by {gate.ANGLE_STEP_RAW} bits at most",
        "_exhausted.py::test_every_angle_step",
    ),
    (
        "the gear changes",
        "from or to neutral, with the parking request in this burst and in the one before",
        ".py::test_what_may_follow_what",
    ),
    (
        "the parking request ends",
        "in reverse or drive, at zero speed; in a stop once after an engagement, for a brake that does not hold",
        ".py::test_what_may_follow_what",
    ),
    (
        f"after {gate.FORGET_NS // 1_000_000} ms without a burst, or silence on purpose",
        "the parking request; a stop may begin released, and with a speed",
        ".py::test_what_may_follow_what",
    ),
    (
        "a stop in place",
        "always, within the rate: zero speed, gear and angle as before, parking request, enables",
        "_exhausted.py::test_a_stop_in_place_is_always_admitted",
    ),
)
"""The conditions of the gate, each with the end of its test's name."""


def bus_frame_table() -> str:
    """Every frame that the gate admits: which bits, and which values."""
    names = {message.can_id: message.name for message in load(Variant.COARSE).commands}
    values = dict(zip(gate.MOTION, (_speeds(), _gears(), _angles(), "0", "0, 1"), strict=True))
    rows = [
        (f"`0x{hex_identifier(can_id)}`", names[can_id], _bits(used), values.get(can_id, "0, 1 each"))
        for can_id, used in gate.USED_BITS.items()
    ]
    return table(("identifier", "frame", "bits that may be set", "their values"), rows)


def bus_rule_table() -> str:
    """Every rule of the gate, with its test."""
    rows = [(what, passes, f"`{_TESTS}{test}`") for what, passes, test in BUS_RULES]
    return table(("what", "passes", "test"), rows)


def _bits(used: int) -> str:
    """The bits below the alive counter, as the manual counts them."""
    digits = f"{used & (1 << 52) - 1:b}"[::-1]
    runs = [match.span() for match in re.finditer("1+", digits)]
    return ", ".join(f"{first}" if end - first == 1 else f"{first}..{end - 1}" for first, end in runs)


def _gears() -> str:
    names = {gate.REVERSE: "reverse", gate.NEUTRAL: "neutral", gate.DRIVE: "drive"}
    return ", ".join(f"{raw} {names[raw]}" for raw in sorted(gate.GEARS))


def _angles() -> str:
    signal = load(Variant.COARSE).messages[STEERING_COMMAND].signal(TARGET_ANGLE)
    first, last = (raw * signal.scale + signal.offset for raw in (gate.ANGLE_RAW[0], gate.ANGLE_RAW[-1]))
    return f"{gate.ANGLE_RAW[0]}..{gate.ANGLE_RAW[-1]}: {first:.2f} to {last:.2f} deg"


def _speeds() -> str:
    texts = []
    for variant in (Variant.COARSE, Variant.FINE):
        signal = load(variant).messages[DRIVE_COMMAND].signal(TARGET_SPEED)
        most = gate.SPEED_RAW_MAX[variant]
        texts.append(f"{variant.value} 0..{most}: to {most * signal.scale:.3f} m/s")
    return "; ".join([*texts, f"scale unknown: {gate.SPEED_RAW_MAX[Variant.UNKNOWN]}"])


def metric_table() -> str:
    """Every metric that is made of a field of a message."""
    rows = [
        (f"`{measure.name}`", measure.label and f"`{measure.label}`", f"`{kind.__name__}.{measure.field}`")
        for kind, measures in MEASURES.items()
        for measure in measures
    ]
    return table(("metric", "label", "field"), rows)


def finding_table() -> str:
    """Every finding of ``cruiser doctor``, with its cure; a note is said to be one."""
    rows = [(f"`{check.name}`{' (note)' if check.is_note else ''}", check.means, check.cure) for check in CHECKS]
    return table(("finding", "it means", "cure"), rows)


def library() -> str:
    """Return the signatures and docstrings of all that a program imports."""
    return "\n\n".join(map(_described, LIBRARY))


def _described(one: Any) -> str:
    """Return a class with its public members, or a function."""
    name = one.__qualname__
    lines = [f"## `{name}{_signature(one)}`", _prose(one)]
    for member, value in vars(one).items() if isinstance(one, type) else ():
        inner = value.__func__ if isinstance(value, classmethod) else value
        if member.startswith("_") or not (inspect.isfunction(inner) or isinstance(inner, property)):
            continue
        label = f"{name}.{member}" + ("" if isinstance(inner, property) else _signature(inner))
        lines.append(f"**`{label}`** {_prose(inner)}")
    return "\n\n".join(line for line in lines if line)


def _signature(one: Any) -> str:
    """Return the arguments without their types, which the text names where a name does not."""
    if isinstance(one, type) and not issubclass(one, BaseException) and not hasattr(one, "__struct_fields__"):
        return ""
    if isinstance(one, type) and issubclass(one, BaseException):
        return ""
    signature = inspect.signature(one)
    shown = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in signature.parameters.values()
        if parameter.name not in {"self", "cls"}
    ]
    text = re.sub(r"<function .*? at \w+>", "...", str(inspect.Signature(shown)))
    return re.sub(r"<([\w.]+): .*?>", r"\1", text).replace(str(END_OF_TIME_NS), "END_OF_TIME_NS")


def _prose(one: Any) -> str:
    """Return a docstring as Markdown: its sections as lists, its literals in single backticks."""
    text = inspect.cleandoc(one.__doc__ or "").replace("``", "`")
    head, *sections = re.split(r"^(?=(?:Args|Attributes|Raises):$)", text, flags=re.MULTILINE)
    items: list[str] = []
    for section in sections:
        rows = re.split(r"^    (?=\S)", section.partition("\n")[2], flags=re.MULTILINE)[1:]
        named = [re.sub(r"\s+", " ", row).strip().partition(": ") for row in rows]
        title = {"Args": "", "Attributes": "", "Raises": "raises "}[section.partition(":")[0]]
        items += [f"- {title}`{name}`: {text}" for name, _, text in named]
    return "\n\n".join(filter(None, [head.strip(), "\n".join(items)]))


PARTS: Final[dict[str, Part]] = TABLES | {
    "bus-frames": bus_frame_table,
    "bus-rules": bus_rule_table,
    "findings": finding_table,
    "library": library,
    "metrics": metric_table,
    "states": state_diagram,
    "stops": stop_table,
}


def rewrite(text: str) -> str:
    """Return the document with every generated part current."""

    def replace(match: re.Match[str]) -> str:
        if match[1] not in PARTS:
            raise SystemExit(f"there is no generated part {match[1]!r}; there are {', '.join(PARTS)}")
        return f"<!-- generated: {match[1]} -->\n\n{PARTS[match[1]]()}\n\n<!-- end -->"

    return re.sub(r"<!-- generated: ([\w-]+) -->\n.*?<!-- end -->", replace, text, flags=re.DOTALL)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a document is not current")
    parser.add_argument("--root", type=Path, default=ROOT, help="the project's directory")
    arguments = parser.parse_args()
    stale = 0
    for path in [arguments.root / "README.md", *sorted(arguments.root.glob("docs/*.md"))]:
        text = path.read_text(encoding="utf-8")
        current = rewrite(text)
        if current != text:
            stale += 1
            if not arguments.check:
                path.write_text(current, encoding="utf-8")
            sys.stderr.write(f"{'stale' if arguments.check else 'wrote'} {path}\n")
    return int(bool(stale)) if arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
