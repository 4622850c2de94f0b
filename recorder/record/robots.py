"""What is known of each robot in a log: when to ask for it, and how the log keeps it. Pure."""

from __future__ import annotations

from typing import Final

from recorder.layouts.attached import layouts
from recorder.layouts.charts import Robot
from recorder.record.effects import AskInfo, Effect, WriteAttachment, WriteMetadata
from schemas import keys
from schemas.messages import GatewayInfo, Variant
from schemas.recorder_settings import BUS_LIMIT, ROBOT_LIMIT
from schemas.subjects import BY_TYPE

METADATA_NAME: Final = "cruiser"
"""The metadata record that says whose log it is; the last of this name in a file holds."""

ASK_AGAIN_NS: Final = 2_000_000_000
"""First pause before a gateway that has not answered, or does not know its variant, is asked again..."""

ASK_AGAIN_MAX_NS: Final = 60_000_000_000
"""...which doubles up to this."""

ASK_PER_TICK: Final = 8
"""Queries in one tick at most, however many robots turn up at once."""

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
        """Whether nothing is left to ask: the DBC is there only when the variant is known."""
        return self.info is not None and self.info.variant is not Variant.UNKNOWN


class Robots:
    """The robots of a log, up to ROBOT_LIMIT: anybody on the network can make up names.

    Args:
        recorder_version: goes into the metadata.
    """

    def __init__(self, recorder_version: str) -> None:
        self._version = recorder_version
        self._robots: dict[str, _Robot] = {}
        self._written: dict[str, str] = {}

    def __len__(self) -> int:
        return len(self._robots)

    def __contains__(self, name: str) -> bool:
        return name in self._robots

    def see(self, root: str, robot: str, now_ns: int) -> str:
        """A sample of this robot came in: ask who it is, if it is new. Returns its name in this log."""
        key = keys.build(root, robot, _INFO)
        known = self._robots.get(robot)
        # Two roots may hold a robot of the same name; the second is called by its root too.
        name = robot if known is None or known.key == key else f"{root}/{robot}"
        if name not in self._robots and len(self._robots) < ROBOT_LIMIT:
            self._robots[name] = _Robot(key, now_ns)
        return name

    def has_room(self, name: str, bus: str = "") -> bool:
        """Whether the log keeps room for this robot's keys, and for those of this bus of it: for the first few."""
        robot = self._robots.get(name)
        if robot is None or not bus or bus in robot.buses:
            return robot is not None
        if len(robot.buses) >= BUS_LIMIT:
            return False
        robot.buses.add(bus)
        return True

    def see_restart(self, name: str, now_ns: int) -> None:
        """The robot's gateway has begun anew, perhaps as another version: ask again."""
        robot = self._robots.get(name)
        if robot is not None and robot.ask_at_ns is None:
            # Two gateways of one name look like a restart with every sample: no storm of queries.
            robot.ask_at_ns = max(now_ns, robot.asked_ns + ASK_AGAIN_NS)
            robot.pause_ns = ASK_AGAIN_NS

    def ask(self, now_ns: int) -> list[Effect]:
        """The queries that are due."""
        effects: list[Effect] = []
        for robot in self._robots.values():
            if robot.ask_at_ns is None or now_ns < robot.ask_at_ns:
                continue
            effects.append(AskInfo(robot.key))
            robot.asked_ns = now_ns
            robot.ask_at_ns = now_ns + robot.pause_ns
            robot.pause_ns = min(2 * robot.pause_ns, ASK_AGAIN_MAX_NS)
            if len(effects) == ASK_PER_TICK:
                break
        return effects

    def ask_last(self) -> list[Effect]:
        """A last query to each robot of which something is not known."""
        return [AskInfo(robot.key) for robot in self._robots.values() if not robot.is_known]

    def take_info(self, name: str, info: GatewayInfo, wall_ns: int) -> list[Effect]:
        """What a robot's answer adds to the log; nothing if it is one of too many."""
        robot = self._robots.get(name)
        if robot is None:
            return []
        before, robot.info = robot.info, info
        if robot.is_known:
            robot.ask_at_ns = None
        effects: list[Effect] = []
        if info.configuration and (before is None or before.configuration != info.configuration):
            configuration = info.configuration.encode()
            effects.append(
                WriteAttachment(f"{name}/configuration.toml", "application/toml", configuration, wall_ns)
            )
        if info.dbc and (before is None or before.dbc != info.dbc):
            effects.append(WriteAttachment(f"{name}/{info.dbc_name}", "text/plain", info.dbc.encode(), wall_ns))
        if before is None or before.bus != info.bus:
            effects += [
                WriteAttachment(f"{name}/{layout.name}", layout.media_type, layout.data, wall_ns)
                for layout in layouts(Robot(robot.key.removesuffix(f"/{_INFO.name}"), info.bus))
            ]
        return effects + self.describe()

    def describe(self) -> list[Effect]:
        """The metadata record, unless the log already ends with the same."""
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
        if entries == self._written:
            return []
        self._written = entries
        return [WriteMetadata(METADATA_NAME, dict(entries), lasts=True)]
