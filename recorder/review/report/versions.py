"""The gateways of a robot, one after the other: variant, configuration and packages."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

import msgspec

from recorder.review.report.findings import InForce
from schemas.messages import GatewayInfo, Variant

STARTS_MAX: Final = 200
EACH_MAX: Final = 10
"""Variants, configurations and packages kept of one gateway."""

TEXTS_MAX: Final = 50
TEXT_MAX: Final = 100_000
"""Configurations that are kept to be compared, and their length."""

CHANGES_MAX: Final = 20
VALUE_MAX: Final = 60

UNKNOWN: Final = Variant.UNKNOWN.value
_PACKAGE: Final = "versions."


class _Told(msgspec.Struct):
    """A gateway's own description; ``heard_ns`` is its log time, None if only the metadata have it."""

    started_ns: int
    heard_ns: int | None
    variant: str
    configuration_sha256: str
    versions: dict[str, str]

    def is_like(self, other: _Told) -> bool:
        """Both say the same, as far as both know."""
        return (
            self.configuration_sha256 == other.configuration_sha256
            and self.versions == other.versions
            and (self.variant == other.variant or UNKNOWN in {self.variant, other.variant})
        )


class Versions:
    """Gathers gateways' own descriptions, and a recorder's notes of them, in any order.

    Attributes:
        left_out: number of descriptions for which there was no room.
    """

    def __init__(self) -> None:
        self._starts: dict[int, list[_Told]] = {}
        self._texts: dict[str, str] = {}
        self.left_out = 0

    def hear(self, info: GatewayInfo, log_ns: int) -> None:
        """A gateway's own answer, which was received then."""
        sha256 = info.configuration_sha256
        if len(self._texts) < TEXTS_MAX and len(info.configuration) <= TEXT_MAX:
            self._texts.setdefault(sha256, info.configuration)
        self._add(_Told(info.started_ns, log_ns, info.variant.value, sha256, dict(info.versions)))

    def read(self, facts: Mapping[str, str]) -> None:
        """Add what a recorder's metadata say of the robot."""
        with suppress(ValueError):
            started_ns = int(facts.get("started_ns", ""))
            packages = {
                name.removeprefix(_PACKAGE): one for name, one in facts.items() if name.startswith(_PACKAGE)
            }
            variant, sha256 = facts.get("variant", UNKNOWN), facts.get("configuration_sha256", "")
            if 0 <= started_ns < 2**63:
                self._add(_Told(started_ns, None, variant, sha256, packages))

    def join(self, other: Versions) -> None:
        """Add what another one has gathered of the same robot from metadata."""
        for of_start in other._starts.values():
            for told in of_start:
                self._add(told)
        self.left_out += other.left_out

    def _add(self, told: _Told) -> None:
        of_start = self._starts.get(told.started_ns)
        if of_start is None:
            if len(self._starts) >= STARTS_MAX:
                self.left_out += 1
                return
            of_start = self._starts[told.started_ns] = []
        same = next((one for one in of_start if one.is_like(told)), None)
        if same is None:
            if len(of_start) < EACH_MAX:
                of_start.append(told)
            else:
                self.left_out += 1
            return
        # It is asked again until the chassis has told which one it is.
        same.variant = told.variant if same.variant == UNKNOWN else same.variant
        if told.heard_ns is not None:
            same.heard_ns = told.heard_ns if same.heard_ns is None else min(same.heard_ns, told.heard_ns)

    def in_force(self, offset_ns: int = 0, from_ns: int = 0, to_ns: int = 2**64) -> list[InForce]:
        """The gateways, by the time since when they were in force.

        Args:
            offset_ns: to be added to the robot's times.
            from_ns: those that another one followed before are left out...
            to_ns: ...and those that came then or later.
        """
        dated = sorted(self._dated(offset_ns), key=lambda one: one[0])
        ends_ns = [since_ns for since_ns, _ in dated[1:]] + [2**64]
        kept = [one for one, end_ns in zip(dated, ends_ns, strict=False) if one[0] < to_ns and end_ns > from_ns]
        befores = [None, *(told for _, told in kept[:-1])]
        return [
            InForce(
                since_ns,
                told.variant,
                told.configuration_sha256,
                told.versions,
                [] if before is None else _changes(before, told),
                [] if before is None else self._settings(before, told),
            )
            for before, (since_ns, told) in zip(befores, kept, strict=False)
        ]

    def _dated(self, offset_ns: int) -> Iterator[tuple[int, _Told]]:
        for started_ns, of_start in self._starts.items():
            for number, told in enumerate(of_start):
                since_ns = max(0, started_ns + offset_ns)
                if told.heard_ns is not None:
                    # What is told later of one that was there before holds since then, for all that is known.
                    since_ns = told.heard_ns if number else min(since_ns, told.heard_ns)
                yield since_ns, told

    def _settings(self, before: _Told, now: _Told) -> list[str]:
        texts = (self._texts.get(one.configuration_sha256, "") for one in (before, now))
        return _bounded(changed_settings(*texts))


def _changes(before: _Told, now: _Told) -> list[str]:
    said = []
    if now.variant != before.variant and UNKNOWN not in {now.variant, before.variant}:
        said.append(f"variant {now.variant}, {before.variant} before")
    if now.configuration_sha256 != before.configuration_sha256:
        said.append(f"configuration {now.configuration_sha256[:12] or 'not told'}")
    for name in sorted(now.versions.keys() | before.versions.keys()):
        was, has = before.versions.get(name, "none"), now.versions.get(name, "none")
        if was != has:
            said.append(f"{name} {has}, {was} before")
    return _bounded(said)


def _bounded(said: list[str]) -> list[str]:
    return said[:CHANGES_MAX] + ([f"and {len(said) - CHANGES_MAX} more"] if len(said) > CHANGES_MAX else [])


def changed_settings(before: str, now: str) -> list[str]:
    """The settings in which two configurations differ, in words; none if one of the two cannot be read."""
    if not before or not now:
        return []
    try:
        was, has = (dict(_flat(tomllib.loads(text), ())) for text in (before, now))
    except (ValueError, RecursionError):
        return []
    return [
        f"{name} {_short(has.get(name, 'not set'))}, {_short(was.get(name, 'not set'))} before"
        for name in sorted(was.keys() | has.keys())
        if was.get(name) != has.get(name)
    ]


def _flat(table: Mapping[str, Any], path: Sequence[str]) -> Iterator[tuple[str, str]]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, (*path, name))
        else:
            yield ".".join((*path, name)), str(value)


def _short(value: str) -> str:
    return value if len(value) <= VALUE_MAX else f"{value[:VALUE_MAX]}..."
