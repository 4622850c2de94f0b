"""Rows of tables as text: steps with ";" between them. One that begins with "=" claims things, "," between them.

A step is a word and its arguments; "name:value" is a field; "|" stands for a semicolon in a text. A claim with
"un" before it has to be false.
"""

from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import pytest

from gateway.chassis.port import ChassisState
from schemas.messages import ControllerState, GearPosition, Mode, ParkingStatus, Variant

Doing = Mapping[str, Callable[..., object]]
_ENUMS = {
    "mode": Mode,
    "gear": GearPosition,
    "brake": ParkingStatus,
    "variant": Variant,
    "controller": ControllerState,
}


def value_of(name: str, text: str) -> Any:  # noqa: ANN401 - of any field
    """A number, a truth, null, a member of an enumeration, or text; frame names have "+" between them."""
    if text == "null":
        return None
    if name in _ENUMS:
        return _ENUMS[name](text)
    if name in {"missing", "faulty", "absurd"}:
        return tuple(text.split("+"))
    if text in {"nan", "inf", "-inf"}:
        return float(text)
    try:
        return msgspec.json.decode(text)
    except msgspec.DecodeError:
        return text.replace("_", " ") if name == "of" else text


def fields_of(words: tuple[str, ...]) -> dict[str, Any]:
    return {name: value_of(name, text) for name, _, text in (word.partition(":") for word in words) if text}


def seen(chassis: ChassisState, words: tuple[str, ...]) -> ChassisState:
    """The chassis state with these fields changed; "all" is each of its speeds."""
    fields = fields_of(words)
    if "all" in fields:
        speed_mps = fields.pop("all")
        moves = {"speed_mps": speed_mps, "wheel_speed_mps": speed_mps, "fastest_wheel_mps": speed_mps}
        fields = moves | fields
    return msgspec.structs.replace(chassis, **fields)


def near(value: float | None, wanted: str, within: float = 1e-6) -> bool:
    """The value is about this, or unknown."""
    return value is None if wanted == "none" else value == pytest.approx(float(wanted), abs=within)


def rows(table: Mapping[str, str]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("row", list(table.values()), ids=list(table))


class Acted:
    """A rig on which rows are acted out."""

    def steps(self) -> Doing:
        """The action of each word."""
        raise NotImplementedError

    def claims(self) -> Doing:
        """Claims that hold now, by name."""
        raise NotImplementedError

    def shown(self) -> object:
        """The state that explains a false claim."""
        return vars(self)

    def other(self, step: str) -> None:
        """Do a step that is in no table."""
        raise AssertionError(step)

    def play(self, text: str) -> None:
        for step in map(str.strip, text.split(";")):
            steps, (word, *words) = self.steps(), step.split()
            if word == "=":
                for claim in step[1:].split(","):
                    self.claim(*claim.split())
            elif word in steps:
                steps[word](*words)
            else:
                self.other(step)

    def claim(self, *claim: str) -> None:
        assert self.holds(*claim), (claim, self.shown())

    def holds(self, name: str, *of: str) -> bool:
        claims = self.claims()
        return bool(claims[name](*of)) if name in claims else not claims[name.removeprefix("un")](*of)
