"""The gateways of a robot, one after the other: variant, configuration and packages."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from itertools import pairwise
from typing import Any, Final

import msgspec

from recorder.review.report.findings import InForce
from schemas.messages import GatewayInfo, Variant

MOST: Final = 200
"""Gateways, and configurations, that are kept."""

TEXT_MAX: Final = 100_000
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
        is_same = (self.started_ns, self.configuration_sha256) == (other.started_ns, other.configuration_sha256)
        is_of_variant = self.variant == other.variant or UNKNOWN in {self.variant, other.variant}
        return is_same and self.versions == other.versions and is_of_variant


class Versions:
    """Gathers gateways' own descriptions, and a recorder's notes of them, in any order.

    Attributes:
        left_out: number of descriptions for which there was no room.
    """

    def __init__(self) -> None:
        self._told: list[_Told] = []
        self._texts: dict[str, str] = {}
        self.left_out = 0

    def hear(self, info: GatewayInfo, log_ns: int) -> None:
        """A gateway's own answer, which was received then."""
        sha256 = info.configuration_sha256
        if len(self._texts) < MOST and len(info.configuration) <= TEXT_MAX:
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

    def _add(self, told: _Told) -> None:
        same = next((one for one in self._told if one.is_like(told)), None)
        if same is not None:
            same.variant = told.variant if same.variant == UNKNOWN else same.variant
            if told.heard_ns is not None:
                same.heard_ns = told.heard_ns if same.heard_ns is None else min(same.heard_ns, told.heard_ns)
        elif len(self._told) < MOST:
            self._told.append(told)
        else:
            self.left_out += 1

    def in_force(self, offset_ns: int = 0, from_ns: int = 0, to_ns: int = 2**64) -> list[InForce]:
        """Return the gateways, by the time since when they were in force.

        Args:
            offset_ns: to be added to the robot's times.
            from_ns: those that another one followed before are left out...
            to_ns: ...and those that came then or later.
        """
        dated = sorted(self._dated(offset_ns), key=lambda one: one[0])
        ends_ns = [since_ns for since_ns, _ in dated[1:]] + [2**64]
        kept = [one for one, end_ns in zip(dated, ends_ns, strict=False) if one[0] < to_ns and end_ns > from_ns]
        changed = [[], *(self._settings(before, now) for (_, before), (_, now) in pairwise(kept))]
        return [
            InForce(since_ns, told.variant, told.configuration_sha256, told.versions, settings)
            for (since_ns, told), settings in zip(kept, changed, strict=False)
        ]

    def _dated(self, offset_ns: int) -> Iterator[tuple[int, _Told]]:
        starts = set()
        for told in self._told:
            since_ns = max(0, told.started_ns + offset_ns)
            if told.heard_ns is not None:
                # What is told later of one that was there before holds since then, for all that is known.
                since_ns = told.heard_ns if told.started_ns in starts else min(since_ns, told.heard_ns)
            starts.add(told.started_ns)
            yield since_ns, told

    def _settings(self, before: _Told, now: _Told) -> list[str]:
        return changed_settings(*(self._texts.get(one.configuration_sha256, "") for one in (before, now)))


def changed_settings(before: str, now: str) -> list[str]:
    """The settings in which two configurations differ, in words; none if one of the two cannot be read."""
    if not before or not now or before == now:
        return []
    try:
        was, has = (dict(_flat(tomllib.loads(text), ())) for text in (before, now))
    except (ValueError, RecursionError):
        return []
    said = [
        f"{name} {has.get(name, 'not set')[:VALUE_MAX]}, {was.get(name, 'not set')[:VALUE_MAX]} before"
        for name in sorted(was.keys() | has.keys())
        if was.get(name) != has.get(name)
    ]
    return said[:CHANGES_MAX] + ([f"and {len(said) - CHANGES_MAX} more"] if len(said) > CHANGES_MAX else [])


def _flat(table: Mapping[str, Any], path: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, (*path, name))
        else:
            yield ".".join((*path, name)), str(value)
