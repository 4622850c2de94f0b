"""The settings as a table, read from their classes: name, environment variable, bounds in words, start value.

``configuration`` checks given values against it, and the table in ``docs/configuration.md`` is printed from it.
"""

from __future__ import annotations

from typing import Any, Final

import msgspec
from msgspec import inspect

from schemas.docstrings import attribute_texts
from schemas.settings import Settings

VARIABLE_PREFIX: Final = "CRUISER_"
CONFIG_VARIABLE: Final = "CRUISER_CONFIG"
"""Names the TOML file; the one variable with the prefix that is no setting."""

GIVEN: Final = "given"
"""The field that is no setting: which settings of its table a source gave."""

Kind = inspect.Type


class Setting(msgspec.Struct, frozen=True):
    """One setting.

    Attributes:
        section: the table of the TOML file.
        name: the key in that table.
        annotation: the type with its bounds, for msgspec.
        start: the value in force when no source gives one.
        about: its description, for people.
    """

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
        """The type, taken apart. That takes 0.1 ms, so it is done for the few that somebody asks about."""
        return inspect.type_info(self.annotation)

    @property
    def variable(self) -> str:
        """The environment variable: ``CRUISER_CAN_CHANNEL``."""
        return f"{VARIABLE_PREFIX}{self.section}_{self.name}".upper()

    @property
    def wants(self) -> str:
        """Return a description of the valid values."""
        return _words(self.kind)

    @property
    def choices(self) -> tuple[str, ...]:
        """The right values, if there are only these; else empty."""
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


SETTINGS: Final = _table()
"""Every setting by its dotted key, in the order of the classes."""

SECTIONS: Final = tuple(field.name for field in msgspec.structs.fields(Settings))
