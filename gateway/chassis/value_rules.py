"""Rules for the values of a feedback frame; ``decode`` compiles them into its decoder."""

from __future__ import annotations

import msgspec


class Within(msgspec.Struct, frozen=True):
    """The physical value, in the signal's unit, lies between these, both included."""

    minimum: float
    maximum: float


class Named(msgspec.Struct, frozen=True):
    """The value table has a name for the value."""


class Requires(msgspec.Struct, frozen=True):
    """This choice counts only where a flag of the same frame is set; any other choice needs none."""

    choice: str
    flag: str


Rule = Within | Named | Requires
