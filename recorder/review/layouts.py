"""The robots of a log, as its topics name them, for the layouts that it is opened with."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from recorder.layouts.attached import RobotKeys
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.survey import survey
from recorder.reading.topics import Topic
from schemas import keys
from schemas.subjects import RECORDER_CHUNK


def robots_of(logs: Sequence[LogFile], faults: Faults) -> list[RobotKeys]:
    """The robots of logs, by their keys.

    Args:
        logs: as ``find_logs`` gives them. No chunk is read of those that are whole.
        faults: takes what cannot be read.
    """
    return robots_in(survey(logs, faults).topics.values())


def robots_in(topics: Iterable[Topic]) -> list[RobotKeys]:
    """The robots that these topics are of; of several CAN buses the first by name."""
    buses: dict[str, set[str]] = {}
    for topic in topics:
        parts = keys.parse(topic.name)
        if parts is not None and parts.robot and RECORDER_CHUNK not in topic.name.split("/"):
            buses.setdefault(f"{parts.root}/{parts.robot}", set()).add(parts.bus)
    return [RobotKeys(key, min(found - {""}, default="")) for key, found in sorted(buses.items())]
