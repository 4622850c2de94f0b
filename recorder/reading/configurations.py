"""The configuration of each run of a gateway, from its own messages and from the attachments of recorders."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Selection, read_rows
from recorder.reading.survey import Survey
from recorder.reading.topics import UNREADABLE
from schemas.configuration import TomlSource, merge
from schemas.messages import GatewayInfo
from schemas.settings import Settings

CONFIGURATION: Final = "configuration.toml"
"""The attachment ``{robot}/configuration.toml``."""

INFO: Final = "gateway/info"

ANSWERED_NS: Final = 30_000_000_000
"""A gateway that starts publishes its configuration to a running recorder within this time."""

TEXTS_MAX: Final = 64 * 1024 * 1024
"""The length of all configurations of a robot that are kept; one has two thousand characters."""

STARTED_NS: Final = 1_000_000_000
"""A run's first journal is published so soon after its gateway was started."""


class Configurations(msgspec.Struct, frozen=True):
    """Configurations of one robot, as TOML. Times are nanoseconds since 1970.

    Attributes:
        told: start times of gateways that published their configuration, each with the text; in order of time.
        attached: times at which a recorder attached a configuration, each with the text; in order of time.
    """

    told: list[tuple[int, str]]
    attached: list[tuple[int, str]]

    def at(self, began_ns: int) -> str | None:
        """The one that was in force in the run that began then; None if the log does not hold it."""
        told = [text for started_ns, text in self.told if started_ns <= began_ns + STARTED_NS]
        if told:
            return told[-1]
        before = [text for time_ns, text in self.attached if time_ns < began_ns]
        soon = [text for time_ns, text in self.attached if began_ns <= time_ns < began_ns + ANSWERED_NS]
        later = [text for time_ns, text in self.attached if time_ns >= began_ns + ANSWERED_NS]
        # A recorder writes a configuration when it is new to it, and may have come long after the gateway.
        return next(iter(soon[:1] + before[-1:] + later[:1]), None)


def configurations_of(robot: str, logs: Sequence[LogFile], found: Survey, faults: Faults) -> Configurations:
    """The configurations of a robot's runs.

    Args:
        robot: its name.
        logs: in the order of their beginnings.
        found: the survey of these logs.
        faults: takes what cannot be read.
    """
    told: dict[int, str] = {}
    room = TEXTS_MAX
    selection = Selection(lambda topic: topic.robot == robot and topic.subject == INFO)
    for row in read_rows(logs, selection, faults):
        with suppress(*UNREADABLE):
            info = row.topic.decode(row.data) if row.topic.decode is not None else None
            if isinstance(info, GatewayInfo) and info.configuration and len(info.configuration) <= room:
                room -= len(info.configuration)
                told[info.started_ns] = info.configuration
    return Configurations(sorted(told.items()), attached(robot, found))


def attached(robot: str, found: Survey) -> list[tuple[int, str]]:
    """Return the configurations of a robot that recorders attached, each with its time, in order of time."""
    texts: dict[str, list[tuple[int, str]]] = {}
    for one in found.attachments:
        texts.setdefault(one.name, []).append((one.log_time, one.data.decode("utf-8", "replace")))
    # A recorder calls only the second robot of a name by its root too.
    bare = f"{robot.rpartition('/')[2]}/{CONFIGURATION}"
    return texts.get(f"{robot}/{CONFIGURATION}", texts.get(bare, []))


def settings_from(text: str) -> Settings:
    """The settings that a configuration holds.

    Raises:
        CommandError: they are none of this version.
    """
    return merge(TomlSource(CONFIGURATION, text, is_recorded=True), {}, {})
