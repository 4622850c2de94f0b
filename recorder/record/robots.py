"""The robots of a log: when each is asked who it is, and how the log keeps the answer. Pure."""

from __future__ import annotations

from typing import Final

from recorder.layouts.attached import RobotKeys, layouts
from recorder.record.actions import QUERIES_PER_TICK, LogAction, Query, WriteAttachment, WriteMetadata
from schemas import keys
from schemas.messages import GatewayInfo, Variant
from schemas.settings import BUS_LIMIT, ROBOT_LIMIT
from schemas.subjects import BY_TYPE

METADATA_NAME: Final = "cruiser"
"""The metadata record with the robots of a log; the last one of this name in a file is valid."""

DEVICE_NAME: Final = "foxglove"
"""The metadata record by which Foxglove files a log under its robot; the last one of this name in a file is valid.

Of its keys (https://docs.foxglove.dev/docs/primary-sites/self-hosting/manage-data, "Adding metadata to imports")
``deviceName`` alone is written: a device of that name is made where there is none. ``deviceId`` and ``projectId``
are numbers of somebody's account. ``key`` must never stand on two files that differ, and whoever cuts a log copies
it; recordings of a device are told apart by their content anyway.
"""

ASK_AGAIN_NS: Final = 2_000_000_000
"""First pause before a gateway that has not answered, or does not know its variant, is asked again; it doubles."""

ASK_AGAIN_MAX_NS: Final = 60_000_000_000
"""The longest pause between two such queries."""

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
        """True if nothing is left to ask: the DBC is there only when the variant is known."""
        return self.info is not None and self.info.variant is not Variant.UNKNOWN


class Robots:
    """The robots of a log, from their first samples on, up to ROBOT_LIMIT: anybody can make up names.

    Args:
        log: the log's name.
        recorder_version: goes into the metadata.
    """

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
        """Ask a robot who it is, if it is new. Returns its name in this log."""
        key = keys.build(root, robot, _INFO)
        known = self._robots.get(robot)
        # Two roots may hold a robot of the same name; the second is called by its root too.
        name = robot if known is None or known.key == key else f"{root}/{robot}"
        if name not in self._robots and len(self._robots) < ROBOT_LIMIT:
            self._robots[name] = _Robot(key, now_ns)
        return name

    def has_quota(self, name: str, bus: str = "") -> bool:
        """True if keys of this robot, and of this bus of it, have a quota of their own: the first few have."""
        robot = self._robots.get(name)
        if robot is None or not bus or bus in robot.buses:
            return robot is not None
        if len(robot.buses) >= BUS_LIMIT:
            return False
        robot.buses.add(bus)
        return True

    def see_restart(self, name: str, now_ns: int) -> None:
        """Ask a robot again, as its gateway has begun anew, perhaps as another version."""
        robot = self._robots.get(name)
        if robot is not None and robot.ask_at_ns is None:
            # Two gateways of one name look like a restart with every sample: no storm of queries.
            robot.ask_at_ns = max(now_ns, robot.asked_ns + ASK_AGAIN_NS)
            robot.pause_ns = ASK_AGAIN_NS

    def queries(self, now_ns: int, most: int = QUERIES_PER_TICK) -> list[Query]:
        """The queries that are due, at most so many; the others stay due."""
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
        """Ask each robot once more of which something is not known."""
        for robot in self._robots.values():
            if not robot.is_known:
                robot.ask_at_ns = now_ns

    def receive_info(self, name: str, info: GatewayInfo, wall_ns: int) -> list[LogAction]:
        """Add a robot's answer to the log; nothing if it is one of too many."""
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
        """Write the metadata records, unless the log already ends with the same."""
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
        # A log of several robots is no device's: an empty record takes back what an earlier one said.
        device = {"deviceName": next(iter(self._robots))} if len(self._robots) == 1 else {}
        if device != self._device:
            self._device = device
            actions.append(WriteMetadata(self._log, DEVICE_NAME, dict(device), lasts=True))
        return actions
