"""The robots of a log: their infos, the statements of their authorities, and missing samples. Pure.

- Each robot's ``gateway/info`` is queried and recorded.
- The newest statements of the authorities are metadata of each file, so that each file can be verified alone: a
  robot repeats them once a minute, and a file may be shorter. With the authority's keys the recorder knows which
  are signed, and unsigned ones cannot displace them.
- Samples that a gateway still stores and this log lacks: found by gaps in the sequence, and queried one piece at a
  time and key, so that a thin link carries live data first.
"""

from __future__ import annotations

from collections import OrderedDict
from itertools import islice
from typing import TYPE_CHECKING, Final

from recorder.layouts.attached import RobotKeys, layouts
from recorder.record.actions import QUERIES_PER_TICK, LogAction, Query, WriteAttachment, WriteMetadata
from schemas import keys
from schemas.decisions import Journal
from schemas.messages import GatewayInfo, Variant
from schemas.settings import BUS_LIMIT, ROBOT_LIMIT
from schemas.subjects import BY_TYPE, KEPT_PIECE, SUBJECTS, TEXT_MAX_BYTES, Subject

if TYPE_CHECKING:
    from recorder.record.signed_mode import StatementProofs

METADATA_NAME: Final = "cruiser"  # metadata record with the robots of a log; the last one in a file is valid
DEVICE_NAME: Final = "foxglove"
"""Metadata record by which Foxglove files a log under its robot; the last one in a file is valid.

Of its keys (https://docs.foxglove.dev/docs/primary-sites/self-hosting/manage-data, "Adding metadata to imports")
only ``deviceName`` is written: Foxglove creates the device if needed. ``deviceId`` and ``projectId`` belong to an
account, and ``key`` must be unique to a file, which a cut of the log would break.
"""

ASK_AGAIN_NS: Final = 2_000_000_000
"""First pause before a gateway without an answer or a variant is queried again; it doubles."""

ASK_AGAIN_MAX_NS: Final = 60_000_000_000  # the longest pause between two such queries

_INFO: Final = BY_TYPE[GatewayInfo]


class _Robot:
    def __init__(self, key: str, now_ns: int) -> None:
        self.key = key
        self.info: GatewayInfo | None = None
        self.ask_at_ns: int | None = now_ns
        self.asked_ns = now_ns
        self.pause_ns = ASK_AGAIN_NS
        self.buses: set[str] = set()

    @property
    def is_known(self) -> bool:
        """True if the info is complete: the DBC is there only when the variant is known."""
        return self.info is not None and self.info.variant is not Variant.UNKNOWN


class Robots:
    """The robots of a log, from their first samples on, at most ROBOT_LIMIT: names are untrusted."""

    def __init__(self, log: str, recorder_version: str) -> None:
        self._log = log
        self._version = recorder_version
        self._robots: dict[str, _Robot] = {}
        self._written: dict[str, str] = {}
        self._device: dict[str, str] = {}

    def __len__(self) -> int:
        return len(self._robots)

    def __contains__(self, name: str) -> bool:
        return name in self._robots

    def see(self, root: str, robot: str, now_ns: int) -> str:
        """Query the info of a new robot. Returns the robot's name in this log."""
        key = keys.build(root, robot, _INFO)
        known = self._robots.get(robot)
        # Two roots may hold a robot of the same name; the second is called by its root too.
        name = robot if known is None or known.key == key else f"{root}/{robot}"
        if name not in self._robots and len(self._robots) < ROBOT_LIMIT:
            self._robots[name] = _Robot(key, now_ns)
        return name

    def has_quota(self, name: str, bus: str = "") -> bool:
        """True if the robot, and this bus of it, are among the first few: their keys have their own quota."""
        robot = self._robots.get(name)
        if robot is None or not bus or bus in robot.buses:
            return robot is not None
        if len(robot.buses) >= BUS_LIMIT:
            return False
        robot.buses.add(bus)
        return True

    def see_restart(self, name: str, now_ns: int) -> None:
        """Query a robot again: its gateway restarted, perhaps with another version."""
        robot = self._robots.get(name)
        if robot is not None and robot.ask_at_ns is None:
            # Two gateways of one name look like a restart with every sample: avoid a storm of queries.
            robot.ask_at_ns = max(now_ns, robot.asked_ns + ASK_AGAIN_NS)
            robot.pause_ns = ASK_AGAIN_NS

    def queries(self, now_ns: int, most: int = QUERIES_PER_TICK) -> list[Query]:
        queries: list[Query] = []
        for robot in self._robots.values():
            if robot.ask_at_ns is None or now_ns < robot.ask_at_ns:
                continue
            if len(queries) >= most:
                break
            queries.append(Query(robot.key))
            robot.asked_ns = now_ns
            robot.ask_at_ns = now_ns + robot.pause_ns
            robot.pause_ns = min(2 * robot.pause_ns, ASK_AGAIN_MAX_NS)
        return queries

    def ask_last(self, now_ns: int) -> None:
        """Query each robot with an incomplete info once more."""
        for robot in self._robots.values():
            if not robot.is_known:
                robot.ask_at_ns = now_ns

    def receive_info(self, name: str, info: GatewayInfo, wall_ns: int) -> list[LogAction]:
        """Add a robot's info to the log, unless the robot is beyond the limit."""
        robot = self._robots.get(name)
        if robot is None:
            return []
        before, robot.info = robot.info, info
        if robot.is_known:
            robot.ask_at_ns = None
        attached: list[tuple[str, str, bytes]] = []
        if info.configuration and (before is None or before.configuration != info.configuration):
            attached.append(("configuration.toml", "application/toml", info.configuration.encode()))
        if info.dbc and (before is None or before.dbc != info.dbc):
            attached.append((info.dbc_name, "text/plain", info.dbc.encode()))
        if before is None or before.bus != info.bus:
            base = robot.key.removesuffix(f"/{_INFO.name}")
            attached += [(one.name, one.media_type, one.data) for one in layouts(RobotKeys(base, info.bus))]
        actions: list[LogAction] = [
            WriteAttachment(self._log, f"{name}/{file}", media_type, data, wall_ns)
            for file, media_type, data in attached
        ]
        return actions + self.describe()

    def describe(self) -> list[LogAction]:
        """Write the metadata records that have changed."""
        entries = {"recorder_version": self._version, "robots": ",".join(sorted(self._robots))}
        for name, robot in sorted(self._robots.items()):
            info = robot.info
            if info is not None:
                entries[f"{name}.variant"] = info.variant.value
                entries[f"{name}.bus"] = info.bus
                entries[f"{name}.started_ns"] = str(info.started_ns)
                entries[f"{name}.configuration_sha256"] = info.configuration_sha256
                for package, version in sorted(info.versions.items()):
                    entries[f"{name}.versions.{package}"] = version
        actions: list[LogAction] = []
        if entries != self._written:
            self._written = entries
            actions.append(WriteMetadata(self._log, METADATA_NAME, dict(entries), lasts=True))
        # A log of several robots belongs to no device: an empty record revokes an earlier one.
        device = {"deviceName": next(iter(self._robots))} if len(self._robots) == 1 else {}
        if device != self._device:
            self._device = device
            actions.append(WriteMetadata(self._log, DEVICE_NAME, dict(device), lasts=True))
        return actions


STATEMENTS_NAME: Final = "cruiser.statements"
"""Metadata record of texts by ``{root}/{robot} {time} {number}``, the time in nanoseconds since 1970."""

STATEMENTS_MAX_BYTES: Final = 131_072
"""Limit of the statements signed by the authority, and of all others; the least recently repeated go first."""


class Statements:
    """The statements that the robots of a log have shown."""

    def __init__(self, log: str, proofs: StatementProofs | None = None) -> None:
        self._log = log
        self._proofs = proofs
        self._proven = _Room()
        self._unproven = _Room()
        self._is_new = False

    def tick(self) -> None:
        if self._proofs is not None:
            self._proofs.tick()

    def receive(self, robot: str, text: str, time_ns: int) -> None:
        """Store a robot's statement with the time of its first appearance, unless it is too long.

        Args:
            robot: the beginning of its keys, root and name.
            time_ns: by the robot's clock, since 1970.
        """
        if len(text.encode()) > TEXT_MAX_BYTES:
            # The message is unsigned: one alone must not displace all others.
            return
        place = robot, text
        if self._proven.repeat(place):
            return
        if self._proofs is not None and self._proofs.has(text):
            self._proven.add(place, self._unproven.remove(place, time_ns))
        elif self._unproven.repeat(place):
            return
        else:
            self._unproven.add(place, time_ns)
        self._is_new = True

    def describe(self) -> list[LogAction]:
        """Write the statements if they have changed."""
        if not self._is_new:
            return []
        self._is_new = False
        said = [*self._proven.said.items(), *self._unproven.said.items()]
        entries = {f"{robot} {time_ns} {number}": text for number, ((robot, text), time_ns) in enumerate(said)}
        return [WriteMetadata(self._log, STATEMENTS_NAME, entries, lasts=True)]


class _Room:
    """Statements with the time of their first appearance, the most recently repeated last."""

    def __init__(self) -> None:
        self.said: OrderedDict[tuple[str, str], int] = OrderedDict()
        self._bytes = 0

    def repeat(self, place: tuple[str, str]) -> bool:
        """Note that a statement was repeated. False if it is not stored."""
        if place not in self.said:
            return False
        self.said.move_to_end(place)
        return True

    def add(self, place: tuple[str, str], time_ns: int) -> None:
        self.said[place] = time_ns
        self._bytes += len(place[1].encode())
        while self._bytes > STATEMENTS_MAX_BYTES:
            self.remove(next(iter(self.said)), 0)

    def remove(self, place: tuple[str, str], otherwise_ns: int) -> int:
        """Remove a statement. Returns the time of its first appearance, or ``otherwise_ns``."""
        if place not in self.said:
            return otherwise_ns
        self._bytes -= len(place[1].encode())
        return self.said.pop(place)


ANSWER_NS: Final = 1_000_000_000  # a piece that is incomplete after this time is queried again
TRIES: Final = 5  # queries for one piece in a row; then it is given up

AGAIN_NS: Final = 2_000_000_000
"""Shortest time between two queries for all samples of a key: two gateways of one name look like a restart with
every sample."""

RANGES_MAX: Final = 32  # gaps of one key that wait; the oldest beyond it are given up
HELD: Final = 16_384  # samples of one key that are recognised as duplicates: as many as a gateway stores, in 2 MB

KEPT_SUBJECTS: Final = tuple(subject for subject in SUBJECTS if subject.qos.kept_bytes)


class _Range:
    """Missing sequences from ``start`` up to but not including ``end``; None is open-ended."""

    def __init__(self, start: int, end: int | None, *, counted: bool) -> None:
        self.start = start
        self.end = end
        self.counted = counted  # the key's counters count them as missed
        self.asked_to = start
        self.asked_ns: int | None = None
        self.tries = 0

    @property
    def is_over(self) -> bool:
        """Nothing in the range is missing any more."""
        return self.end is not None and self.start >= self.end

    def is_due(self, now_ns: int) -> bool:
        """The queried piece has arrived, or has timed out."""
        return self.asked_ns is None or self.start >= self.asked_to or now_ns - self.asked_ns >= ANSWER_NS


class _Key:
    def __init__(self, key: str, subject: Subject, now_ns: int) -> None:
        self.key = key
        # A journal without its beginning cannot be rerun.
        self.whole_only = subject.type is Journal
        # Hashes of the recorded samples, by place: a repeated sample would look like a restart.
        self._held: dict[int, int] = {}
        self.asked_ns: int | None = None
        self.begin(now_ns)

    def begin(self, now_ns: int) -> None:
        """Treat the gateway as new: all its samples are missing."""
        self.begun_ns = now_ns
        self.ask_at_ns = now_ns if self.asked_ns is None else max(now_ns, self.asked_ns + AGAIN_NS)
        self.expected = 0
        self.ranges = [_Range(0, None, counted=False)]

    def receive(self, sequence: int) -> None:
        """Note a live sample."""
        last = self.ranges[-1] if self.ranges else None
        if last is not None and last.end is None:
            last.end = sequence
        elif sequence > self.expected:
            self.ranges.append(_Range(self.expected, sequence, counted=True))
            del self.ranges[:-RANGES_MAX]
        self.expected = sequence + 1

    def hold(self, sequence: int, payload: bytes) -> bool:
        """Note that the log has a sample. False if it had it before."""
        place, digest = sequence % HELD, hash(payload)
        is_new = self._held.get(place) != digest
        self._held[place] = digest
        return is_new

    def query(self, now_ns: int) -> Query | None:
        """The query that is due."""
        while self.ranges and self.ranges[0].is_over:
            del self.ranges[0]
        if not self.ranges or now_ns < self.ask_at_ns or not self.ranges[0].is_due(now_ns):
            return None
        one = self.ranges[0]
        one.tries = one.tries + 1 if one.asked_ns is not None and one.start < one.asked_to else 0
        if one.tries >= TRIES:
            del self.ranges[0]
            return None
        self.asked_ns = one.asked_ns = now_ns
        one.asked_to = one.start + KEPT_PIECE
        return Query(self.key, one.start)


class Backlog:
    """The keys of a log whose recent samples the gateways store."""

    def __init__(self) -> None:
        self._keys: dict[str, _Key] = {}

    def see(self, root: str, robot: str, now_ns: int) -> None:
        """Query the earlier samples of a new robot."""
        if len(self._keys) >= ROBOT_LIMIT * len(KEPT_SUBJECTS):
            return
        for subject in KEPT_SUBJECTS:
            key = keys.build(root, robot, subject)
            if key not in self._keys:
                self._keys[key] = _Key(key, subject, now_ns)

    def receive(self, key: str, sequence: int, payload: bytes, now_ns: int, *, is_restart: bool) -> None:
        """Note a live sample. ``is_restart``: its sequence steps back."""
        one = self._keys.get(key)
        if one is None:
            return
        if is_restart:
            self._begin_again(one, key, now_ns)
        one.receive(sequence)
        one.hold(sequence, payload)

    def receive_reply(self, key: str, sequence: int, payload: bytes) -> tuple[bool, bool]:
        """Note a sample from a reply. Returns whether it was missing, and whether it was counted as missed."""
        one = self._keys.get(key)
        wanted = one.ranges[0] if one is not None and one.ranges else None
        if one is None or wanted is None or sequence < wanted.start:
            return False, False
        if sequence > wanted.start and not wanted.tries:
            # Perhaps an earlier reply was lost: query the whole range once more.
            return False, False
        if wanted.end is not None and sequence >= wanted.end:
            return False, False
        if sequence > wanted.start and one.whole_only:
            one.ranges.pop(0)
            return False, False
        wanted.start = sequence + 1
        wanted.tries = 0
        one.expected = max(one.expected, wanted.start)
        return one.hold(sequence, payload), wanted.counted

    def queries(self, now_ns: int, most: int = QUERIES_PER_TICK) -> list[Query]:
        due = (query for one in self._keys.values() if (query := one.query(now_ns)) is not None)
        return list(islice(due, most))

    def ask_last(self) -> None:
        """Query the end too: no later sample shows that the last ones are missing."""
        for one in self._keys.values():
            missing = [part for part in one.ranges if not part.is_over]
            one.ranges = missing or [_Range(one.expected, None, counted=False)]

    def _begin_again(self, one: _Key, key: str, now_ns: int) -> None:
        """Restart all subjects of a gateway: rarely published ones would not show the restart themselves."""
        one.begin(now_ns)
        parts = keys.parse(key)
        if parts is None:
            return
        for subject in KEPT_SUBJECTS:
            other = self._keys.get(keys.build(parts.root, parts.robot, subject))
            if other is not None and now_ns - other.begun_ns > TRIES * ANSWER_NS:
                other.begin(now_ns)
