"""The metadata of a log: of which robots it is, and what its recorder received and lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Final

import msgspec
from mcap import records

from recorder.mcap.reader import Fault, read_pieces
from recorder.reading.log_file import LogFile
from recorder.record.accounting import COMPLETENESS_NAME, KeyReport, total
from recorder.record.robots import METADATA_NAME
from recorder.review.report.versions import Versions

TOPICS_MAX: Final = 5000
ROBOTS_MAX: Final = 100
"""Robots of one log. A recorder describes no more; names can be made up."""

FACTS_MAX: Final = 100
VALUES_MAX: Final = 5

Facts = dict[str, str]


class Margins(msgspec.Struct):
    """Of one file.

    Attributes:
        facts: its last metadata about each robot, by its key, or by its name where that is not known.
        completeness: by topic.
    """

    facts: dict[str, Facts]
    completeness: dict[str, KeyReport]


def read_margins(log: LogFile, versions: dict[str, Versions]) -> Margins:
    """Skip the chunks. The faults of the file are reported by the reader of the rows.

    Args:
        log: the file.
        versions: takes what it says of each robot's gateways, one after the other; by the robots' keys.
    """
    named: dict[str, tuple[Facts, Versions]] = {}
    accounts: dict[str, str] = {}
    with suppress(OSError), log.path.open("rb") as stream:
        for piece in read_pieces(stream, log.bytes, is_verifying=False):
            if isinstance(piece, records.Metadata) and piece.name == METADATA_NAME:
                for name, facts in _by_name(piece.metadata):
                    if name in named or len(named) < ROBOTS_MAX:
                        _, told = named.get(name, ({}, Versions()))
                        told.read(facts)
                        named[name] = facts, told
            elif isinstance(piece, records.Metadata) and piece.name == COMPLETENESS_NAME:
                accounts = piece.metadata
            elif isinstance(piece, Fault) and piece.cuts:
                break
    completeness = {}
    for topic, text in list(accounts.items())[:TOPICS_MAX]:
        with suppress(msgspec.MsgspecError):
            completeness[topic] = msgspec.json.decode(text, type=KeyReport)
    by_key = {_key_of(name, named, log): known for name, known in named.items()}
    for key, (_, told) in by_key.items():
        if key in versions or len(versions) < ROBOTS_MAX:
            versions.setdefault(key, Versions()).join(told)
    return Margins({key: facts for key, (facts, _) in by_key.items()}, completeness)


def of_robot(key: str, margins: Sequence[Margins]) -> tuple[dict[str, KeyReport], Facts]:
    """The account of its topics, and what is known of it, of all files."""
    reports: dict[str, list[KeyReport]] = {}
    values: dict[str, Counter[str]] = {}
    for margin in margins:
        for topic, report in margin.completeness.items():
            if topic.startswith(f"{key}/"):
                reports.setdefault(topic, []).append(report)
        for name, value in margin.facts.get(key, margin.facts.get(_name_of(key), {})).items():
            values.setdefault(name, Counter())[value] += 1
    completeness = {topic: total(of_topic) for topic, of_topic in sorted(reports.items())}
    facts = {name: ", ".join(list(found)[:VALUES_MAX]) for name, found in list(values.items())[:FACTS_MAX]}
    return completeness, facts


def versions_of(key: str, versions: Mapping[str, Versions]) -> Versions | None:
    """The gateways of a robot, as metadata describe them; None if they do not."""
    return versions.get(key, versions.get(_name_of(key)))


def _by_name(metadata: Facts) -> Iterator[tuple[str, Facts]]:
    """The names of the robots in a log, and what its metadata say of each."""
    version = {"recorder_version": metadata["recorder_version"]} if "recorder_version" in metadata else {}
    names = metadata.get("robots", "").split(",")[:ROBOTS_MAX]
    for name in filter(None, names):
        prefix = f"{name}."
        facts = {one.removeprefix(prefix): value for one, value in metadata.items() if one.startswith(prefix)}
        yield name, version | facts


def _key_of(name: str, names: Iterable[str], log: LogFile) -> str:
    """A recorder calls a robot by its name, and the second one of that name by its root, too."""
    keys = {f"{root}/{robot}" for root, robot in log.robots if robot == name} - set(names)
    return keys.pop() if len(keys) == 1 else name


def _name_of(key: str) -> str:
    return key.rpartition("/")[2]
