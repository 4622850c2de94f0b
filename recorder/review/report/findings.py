"""The content of a report, as data. Times are nanoseconds since 1970, by the robot's own clock."""

from __future__ import annotations

import msgspec

from recorder.record.accounting import KeyReport
from recorder.review.drives import Outage, RecordedDrive, Silence
from recorder.review.report.charts import Place, Point, Span


class Moment(msgspec.Struct, frozen=True):
    """Something that a person should know.

    Attributes:
        last_ns: when the last of ``count`` alike ones was, or how long it lasted; else as ``time_ns``.
        kind: stop, latch, takeover, ..., gateway, gap: those of ``cruiser review events``.
        reason: of a stop its cause.
        operator: the operator behind it; empty if there is none.
        holder: the lease's holder then, as far as the log shows; empty if nobody.
        x_m, y_m: where, as far as the path is known.
        is_stop: a stop begins with it.
    """

    time_ns: int
    last_ns: int
    kind: str
    severity: str
    count: int
    reason: str
    operator: str
    holder: str
    text: str
    x_m: float | None
    y_m: float | None
    is_stop: bool = False


class Why(msgspec.Struct, frozen=True):
    """The reason of a stop, as ``cruiser review why --at`` words it.

    Attributes:
        headline: in one sentence.
        links: the chain that leads to it: time since the stop, time of day, step and sentence of each.
    """

    headline: str
    links: list[tuple[str, str, str, str]]


class InForce(msgspec.Struct, frozen=True):
    """A gateway, as it was in force until the next one was.

    Attributes:
        since_ns: since when: since it was started, as far as it is the first of this start.
        configuration_sha256: of its configuration.
        versions: of its packages.
        settings: changed settings, as far as the log holds both configurations; in words.
    """

    since_ns: int
    variant: str
    configuration_sha256: str
    versions: dict[str, str]
    settings: list[str]


class Driver(msgspec.Struct, frozen=True):
    """An operator who drove the robot, for how long, and how far it went."""

    name: str
    seconds: float
    distance_m: float


class Refusal(msgspec.Struct, frozen=True):
    """Requests that were refused: those of one verb, operator and reason."""

    request: str
    operator: str
    reason: str
    count: int
    first_ns: int
    last_ns: int


class Unwritten(msgspec.Struct, frozen=True):
    """Messages of a topic that reached the recorder and are not in the log, for one reason."""

    topic: str
    reason: str
    count: int


class RobotSummary(msgspec.Struct, frozen=True):
    """A robot in figures.

    Attributes:
        name: as it is called in this report.
        key: the beginning of its keys.
        distance_m: the length of its path, by speed and time; at least that where ``gap_s`` is not 0.
        moving_s: the time that it moved, of ``known_s`` of which its speed is known.
        top_mps: its highest speed, negative in reverse; at ``top_ns``.
        stops: number of stops, by cause.
        ends: number of times that a drive was ended by request, by reason.
        worst: the worst moment; None if nothing is worse than news.
        outages: when the gateway fell silent or was replaced; ``more_outages`` are left out.
        ends_commanding: the recording ends while the chassis was under command.
        events: their number, by kind.
        drivers: its operators.
        accepted: requests that were; ``refused`` those that were not.
        refusals: these, with ``other_refusals`` of further kinds.
        gaps: number of gaps in its known motion; ``gap_s`` in all.
        silences: other gaps of the log.
        health: the gateway's counts while this log was written: lost frames, faults, losses.
        lost_samples: of the recorder's account; None if it gives none.
        lost_frames: likewise, of the bus and of the gateway's raw frames.
        completeness: the recorder's own account of each topic.
        unwritten: messages that reached the recorder and are not in the log.
        facts: variant, bus, versions and hash of the configuration, as the logs' metadata have them.
        in_force: all gateways that the logs mention, one after the other, with their configurations;
            ``more_in_force`` are left out.
    """

    name: str
    key: str
    start_ns: int
    end_ns: int
    distance_m: float
    moving_s: float
    known_s: float
    top_mps: float
    top_ns: int
    stops: dict[str, int]
    ends: dict[str, int]
    worst: Moment | None
    outages: list[Outage]
    more_outages: int
    ends_commanding: bool
    events: dict[str, int]
    drivers: list[Driver]
    accepted: int
    refused: int
    refusals: list[Refusal]
    other_refusals: int
    gaps: int
    gap_s: float
    silences: list[Silence]
    health: dict[str, int]
    lost_samples: int | None
    lost_frames: int | None
    completeness: dict[str, KeyReport]
    unwritten: list[Unwritten]
    facts: dict[str, str]
    in_force: list[InForce]
    more_in_force: int


class Drawn(msgspec.Struct, frozen=True):
    """A drive over time, or a robot that has none.

    Attributes:
        start_ns, end_ns: the first and the last time that is drawn.
        drive: the drive; None if the robot has none.
        lines: by name: times and values, None where a line is broken.
        bands: by name: what was so from when to when.
        places: the path.
        moments: the events.
        outages: beginning and end of each silence of the gateway, before another one began.
    """

    start_ns: int
    end_ns: int
    drive: RecordedDrive | None
    lines: dict[str, list[Point | None]]
    bands: dict[str, list[Span]]
    places: list[Place]
    moments: list[Moment]
    outages: list[tuple[int, int]]


class RobotReport(msgspec.Struct, frozen=True):
    """A robot.

    Attributes:
        moments: the events; ``more_moments`` are left out.
        drives: its drives; ``more_drives`` are left out.
        drawn: the newest of these, and a robot without a drive as it stood.
    """

    summary: RobotSummary
    moments: list[Moment]
    more_moments: int
    drives: list[RecordedDrive]
    more_drives: int
    drawn: list[Drawn]


class ReportedFile(msgspec.Struct, frozen=True):
    """A file that the report is about.

    Attributes:
        is_accounted: it ends with the recorder's account of what it received and lost.
        is_being_written: a recorder has it open: that account is still to come.
    """

    name: str
    bytes: int
    start_ns: int
    end_ns: int
    is_accounted: bool
    is_being_written: bool


class Report(msgspec.Struct, frozen=True):
    """All that a report says.

    Attributes:
        files: the logs.
        from_ns, to_ns: the log times that were asked about; 0 and None if all were.
        robots: one by one; ``more_robots`` are left out.
        faults: parts that could not be read, the first of ``fault_count``.
        version: of the program that made it.
    """

    files: list[ReportedFile]
    from_ns: int
    to_ns: int | None
    robots: list[RobotReport]
    more_robots: int
    faults: list[str]
    fault_count: int
    version: str

    @property
    def drawn(self) -> list[tuple[RobotSummary, Drawn]]:
        """All that is drawn, in the order of the page."""
        return [(robot.summary, one) for robot in self.robots for one in robot.drawn]
