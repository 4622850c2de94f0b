"""Merge settings from a TOML file, the environment and flags, in rising precedence. Pure.

Each fault is one line that names the key, its place, and the nearest right key or the bounds.
"""

from __future__ import annotations

import inspect as python_inspect
import json
import logging
import re
import tomllib
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import PurePath
from typing import Any, Final

import msgspec
from msgspec import inspect

from schemas.command_line import GONE_SETTINGS, CommandError, UsageError, plain
from schemas.settings import NEEDED_FEEDBACK, AuthoritySettings, Settings


def attribute_texts(kind: type) -> dict[str, str]:
    """Return the texts of fields in the docstrings of a class and its bases."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        _, _, section = python_inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")
        for match in re.finditer(r"^ {4}(\w+): (.*(?:\n {5,}.*)*)", section, re.MULTILINE):
            texts[match[1]] = " ".join(match[2].split())
    return texts


def summary(kind: type) -> str:
    """Return the docstring of a class up to its fields."""
    return plain_text(python_inspect.cleandoc(kind.__doc__ or "").partition("\n\nAttributes:")[0])


def plain_text(text: str) -> str:
    """Return a docstring's text in one line, without the marks of code."""
    return " ".join(text.replace("``", "").split())


_BARE_KEY: Final = re.compile(r"[A-Za-z0-9_-]+")

_HEADER: Final = re.compile(r"\s*\[\[?([^\]]*)\]")


def line_of(text: str, table: str, key: str = "") -> int:
    """The line, from 1, of a key in a table, or else of the table, or else 0."""
    found, here = 0, ""
    for number, line in enumerate(text.split("\n"), start=1):
        if header := _HEADER.match(line):
            here = name = _unquoted(header[1])
        else:
            name = ".".join(filter(None, (here, _unquoted(line.partition("=")[0]))))
        if name == table:
            found = found or number
        elif name == f"{table}.{key}":
            return number
    return found


def _unquoted(key: str) -> str:
    return ".".join(part.strip().strip("\"'") for part in key.split("."))


def write_value(value: object) -> str:
    """A value as TOML; a mapping becomes an inline table."""
    match value:
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value)  # Python and TOML write inf, nan and 1e+16 alike.
        case str():
            return write_string(value)
        case list() | tuple():
            return "[" + ", ".join(write_value(item) for item in value) + "]"
        case dict():
            items = ", ".join(f"{write_key(name)} = {write_value(item)}" for name, item in value.items())
            return f"{{ {items} }}" if items else "{}"
        case _:
            raise TypeError(f"TOML has no {type(value).__name__}")


def write_key(name: str) -> str:
    """A key, quoted only if it must be."""
    return name if _BARE_KEY.fullmatch(name) else write_string(name)


def write_string(text: str) -> str:
    """A basic string: as in JSON, but TOML requires DEL to be escaped too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", r"\u007F")


VARIABLE_PREFIX: Final = "CRUISER_"
CONFIG_VARIABLE: Final = "CRUISER_CONFIG"  # names the TOML file; the only such variable that is not a setting
GIVEN: Final = "given"  # the field that is not a setting: names of the settings that a source set

Kind = inspect.Type


class Setting(msgspec.Struct, frozen=True):
    """One setting."""

    section: str
    name: str
    annotation: Any
    start: Any
    about: str

    @property
    def key(self) -> str:
        """The dotted key: ``can.channel``."""
        return f"{self.section}.{self.name}"

    @property
    def kind(self) -> Kind:
        """The inspected type, computed on demand since it takes 0.1 ms."""
        return inspect.type_info(self.annotation)

    @property
    def variable(self) -> str:
        """The environment variable: ``CRUISER_CAN_CHANNEL``."""
        return f"{VARIABLE_PREFIX}{self.section}_{self.name}".upper()

    @property
    def wants(self) -> str:
        return _words(self.kind)

    @property
    def choices(self) -> tuple[str, ...]:
        """The allowed values of an enumeration; else empty."""
        kind = self.kind
        return tuple(str(value) for value in kind.values) if isinstance(kind, inspect.LiteralType) else ()


_WORDS: Final = {
    inspect.BoolType: "true or false",
    inspect.ListType: "a list of texts",
    inspect.DictType: "a table of texts, numbers, true or false",
    inspect.IntType: "a whole number",
    inspect.FloatType: "a number",
    inspect.StrType: "text",
}


def _words(kind: Kind) -> str:
    match kind:
        case (
            inspect.IntType(ge=int(low), le=int(high))
            | inspect.FloatType(ge=float() | int() as low, le=float() | int() as high)
        ):
            bounds = f" from {low} to {high}"
        case inspect.LiteralType():
            return "one of " + ", ".join(str(value) for value in kind.values)
        case inspect.ListType(item_type=inspect.LiteralType(values=values)):
            return "a list of some of " + ", ".join(str(value) for value in values)
        case (
            inspect.ListType(item_type=inspect.StrType(pattern=str(pattern)))
            | inspect.StrType(pattern=str(pattern))
        ):
            bounds = " of the form " + pattern.removeprefix("^").removesuffix(r"\Z")
        case inspect.StrType(min_length=int()):
            bounds = " that is not empty"
        case _:
            bounds = ""
    return _WORDS[type(kind)] + bounds


def _table() -> dict[str, Setting]:
    start = Settings()
    table = {}
    for section in msgspec.structs.fields(Settings):
        abouts = attribute_texts(section.type)
        for field in msgspec.structs.fields(section.type):
            if field.name == GIVEN:
                continue
            setting = Setting(
                section=section.name,
                name=field.name,
                annotation=field.type,
                start=getattr(getattr(start, section.name), field.name),
                about=abouts.get(field.name, ""),
            )
            table[setting.key] = setting
    return table


SETTINGS: Final = _table()  # every setting by its dotted key, in the order of the classes

SECTIONS: Final = tuple(field.name for field in msgspec.structs.fields(Settings))


_FLAG_WORDS: Final = {
    **dict.fromkeys(("true", "yes", "on", "1"), True),
    **dict.fromkeys(("false", "no", "off", "0"), False),
}
_SHOWN_LENGTH: Final = 60  # most characters of a value in an error

NO_GATEWAYS: Final = frozenset({"desk", "upload"})
"""Tables that a gateway does not publish with its settings: a store's options may contain secrets, and earlier
versions refuse logs with unknown tables."""


class TomlSource(msgspec.Struct, frozen=True):
    """The text of a TOML file, and the file's name for messages.

    Attributes:
        is_recorded: the text is from a log, maybe of an earlier version.
    """

    file: str
    text: str
    is_recorded: bool = False


class Given(msgspec.Struct, frozen=True):
    """A value that a source gives for a setting.

    Attributes:
        where: its place, for messages: ``robot.toml:3``, ``environment CRUISER_CAN_BUS``, ``flag can.bus``.
    """

    setting: Setting
    value: object
    where: str


def merge(toml: TomlSource | None, environ: Mapping[str, str], flags: Mapping[str, object]) -> Settings:
    """The settings in force. Later sources win: file, environment, flags.

    Args:
        flags: values by dotted key; a text is parsed as in the environment, other values are used as they are.
    """
    values: dict[str, object] = {}
    sources = (
        _from_toml(toml) if toml is not None else iter(()),
        _from_environment(environ),
        _from_flags(flags),
    )
    for source in sources:
        for given in source:
            values[given.setting.key] = _checked(given)
    sections: dict[str, dict[str, object]] = {section: {} for section in SECTIONS}
    for key, value in values.items():
        setting = SETTINGS[key]
        sections[setting.section][setting.name] = value
    # A Zenoh configuration file is a further source with the lowest precedence, which only a port reads.
    sections["zenoh"][GIVEN] = list(sections["zenoh"])
    settings = msgspec.convert(sections, Settings)
    command = settings.command
    if command.emergency_deceleration_mps2 < command.deceleration_mps2:
        raise UsageError(
            f"command.emergency_deceleration_mps2 is {command.emergency_deceleration_mps2:g}, and "
            f"command.deceleration_mps2 {command.deceleration_mps2:g}: the emergency deceleration may not be lower"
        )
    left_out = [name for name in NEEDED_FEEDBACK if name not in settings.chassis.required_feedback]
    if left_out:
        key = "chassis.required_feedback"
        named = f"{key} (or {SETTINGS[key].variable})"
        raise UsageError(f"{named} leaves out {', '.join(left_out)}, which every robot needs")
    return settings


def to_toml(settings: Settings) -> str:
    lines: list[str] = []
    for section in SECTIONS:
        if section in NO_GATEWAYS:
            continue
        lines += ["", f"[{section}]"] if lines else [f"[{section}]"]
        table = getattr(settings, section)
        lines += [
            f"{write_key(setting.name)} = {write_value(getattr(table, setting.name))}"
            for setting in SETTINGS.values()
            if setting.section == section
        ]
    return "\n".join(lines) + "\n"


def _from_toml(toml: TomlSource) -> Iterator[Given]:

    def where(section: str, name: str = "") -> str:
        line = line_of(toml.text, section, name)
        return f"{plain(toml.file)}:{line}" if line else plain(toml.file)

    for section, table in _parse(toml).items():
        if section not in SECTIONS:
            near = _nearest(section, SECTIONS)
            raise UsageError(f"{where(section)}: there is no table {plain(section)!r}{near}")
        if not isinstance(table, dict):
            raise UsageError(f"{where(section)}: {section} is a table of settings, as in [{section}]")
        for name, value in table.items():
            key = f"{section}.{name}"
            if key not in SETTINGS:
                if key not in GONE_SETTINGS:
                    raise UsageError(
                        f"{where(section, name)}: there is no setting {plain(key)!r}{_nearest_key(key)}"
                    )
                if not toml.is_recorded:
                    text = f"{key} was removed and has no effect: {GONE_SETTINGS[key]}"
                    logging.getLogger(__name__).warning("%s: %s", where(section, name), text)
                continue
            # The line is found for wrong values only: finding lines takes longer than reading the file.
            try:
                _checked(Given(SETTINGS[key], value, ""))
            except CommandError:
                _checked(Given(SETTINGS[key], value, where(section, name)))
            yield Given(SETTINGS[key], value, "")


RECORDED_MAX: Final = 64 * 1024  # longest text of settings that is read from a log
RECORDED_DOTS: Final = 1_000  # most dots in a line of it: tomllib's time grows with the square of a key's parts


def _parse(toml: TomlSource) -> dict[str, Any]:
    if toml.is_recorded:
        lines = toml.text.splitlines()
        if len(toml.text) > RECORDED_MAX or any(one.count(".") > RECORDED_DOTS for one in lines):
            raise UsageError(f"{plain(toml.file)}: not TOML that can be read: no settings are that long")
    try:
        return tomllib.loads(toml.text)
    except tomllib.TOMLDecodeError as error:
        detail = str(error)
        position = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)\Z", detail)
        what = plain(detail[: position.start()] if position else detail)
        if position and position[1]:
            raise UsageError(
                f"{plain(toml.file)}:{position[1]}: not TOML, column {position[2]}: {what}"
            ) from error
        line = toml.text.rstrip("\n").count("\n") + 1
        raise UsageError(f"{plain(toml.file)}:{line}: not TOML, at the end of the file: {what}") from error
    except (ValueError, RecursionError) as error:  # raised by tomllib for very many digits or brackets
        raise UsageError(f"{plain(toml.file)}: not TOML that can be read: {plain(str(error))}") from error


def _from_environment(environ: Mapping[str, str]) -> Iterator[Given]:
    by_variable = {setting.variable: setting for setting in SETTINGS.values()}
    for variable in sorted(environ):
        if not variable.startswith(VARIABLE_PREFIX) or variable == CONFIG_VARIABLE:
            continue
        where = f"environment {plain(variable)}"
        if variable not in by_variable:
            near = _nearest(variable.upper(), (*by_variable, CONFIG_VARIABLE))
            raise UsageError(f"{where}: there is no such setting{near}")
        setting = by_variable[variable]
        yield Given(setting, _typed(setting, environ[variable]), where)


def _from_flags(flags: Mapping[str, object]) -> Iterator[Given]:
    for key, value in flags.items():
        where = f"flag {plain(key)}"
        if key not in SETTINGS:
            raise UsageError(f"{where}: there is no such setting{_nearest_key(key)}")
        yield Given(SETTINGS[key], _typed(SETTINGS[key], value), where)


def _typed(setting: Setting, given: object) -> object:
    """Parse a text from a variable or a flag as the setting's type; returns the text itself if it is wrong.

    A list is comma separated; a table is NAME=VALUE, comma separated, or a list of these from a repeated flag.
    """
    match setting.kind, given:
        case inspect.ListType(), str(text):
            return _items(text)
        case inspect.DictType(), str(text):
            return _pairs(_items(text), given)
        case inspect.DictType(), list(items) if all(isinstance(item, str) for item in items):
            return _pairs(items, given)
        case inspect.BoolType(), str(text):
            return _FLAG_WORDS.get(text.strip().lower(), text)
        case inspect.IntType() | inspect.FloatType(), str(text):
            return _number(text, whole=isinstance(setting.kind, inspect.IntType))
        case _:
            return given


def _items(text: str) -> list[str]:
    return [item.strip() for item in text.split(",") if item.strip()]


def _number(text: str, *, whole: bool) -> int | float | str:
    try:
        return int(text) if whole else float(text)
    except ValueError:
        return text


def _pairs(items: list[str], given: object) -> object:
    """Parse NAME=VALUE items; a value is a TOML number or boolean, else a text."""
    pairs: dict[str, object] = {}
    for item in items:
        name, equals, text = item.partition("=")
        if not equals:
            return given
        number = _number(text, whole=True)
        if isinstance(number, str):
            number = _number(text, whole=False)
        pairs[name.strip()] = {"true": True, "false": False}.get(text.strip().lower(), number)
    return pairs


def _checked(given: Given) -> object:
    setting, value = given.setting, given.value
    problem = _bad_text(value)
    if problem:
        raise UsageError(f"{given.where}: {setting.key} {problem}")
    try:
        return msgspec.convert(value, setting.annotation)
    except (msgspec.ValidationError, RecursionError, OverflowError) as error:
        raise _wrong_value(given) from error


def directory_of(settings: AuthoritySettings, environment: Mapping[str, str], home: PurePath) -> PurePath:
    """The directory of keys and settings; auto is ``$XDG_CONFIG_HOME/cruiser``, or ``~/.config/cruiser``."""
    if settings.directory != "auto":
        return PurePath(settings.directory)
    configured = environment.get("XDG_CONFIG_HOME", "")
    return (PurePath(configured) if configured else home / ".config") / "cruiser"


def _bad_text(value: object) -> str:
    """Return why a text in a value cannot be a file name or UTF-8; empty if it can."""
    match value:
        case str():
            if "\0" in value:
                return "contains a NUL character"
            return "is not valid UTF-8" if any("\ud800" <= character <= "\udfff" for character in value) else ""
        case list():
            return next(filter(None, map(_bad_text, value)), "")
        case dict():
            return next(filter(None, map(_bad_text, [*value, *value.values()])), "")
        case _:
            return ""


def _wrong_value(given: Given) -> UsageError:
    setting = given.setting
    near = _nearest(str(given.value), setting.choices) if setting.choices else ""
    return UsageError(f"{given.where}: {setting.key} must be {setting.wants}, not {_shown(given.value)}{near}")


def _shown(value: object) -> str:
    if isinstance(value, dict | list):
        return "a table" if isinstance(value, dict) else "a list"
    try:
        text = write_value(value)
    except (TypeError, ValueError):  # a date, or a number with more digits than Python prints
        return f"a {type(value).__name__}"
    text = plain(text)
    return text if len(text) <= _SHOWN_LENGTH else f"{text[:_SHOWN_LENGTH]}..."


def _nearest_key(key: str) -> str:
    """A hint at the nearest right key: in the same table, else the same name in another, else of all keys."""
    section, _, name = key.partition(".")
    siblings = [setting.key for setting in SETTINGS.values() if setting.section == section]
    near = get_close_matches(key, siblings, n=1, cutoff=0.75)
    near = near or [setting.key for setting in SETTINGS.values() if setting.name == name]
    return _hint(near[0]) if near else _nearest(key, tuple(SETTINGS))


def _nearest(word: str, words: tuple[str, ...]) -> str:
    near = get_close_matches(word, words, n=1)
    return _hint(near[0]) if near else ""


def _hint(word: str) -> str:
    return f"; did you mean {word!r}?"
