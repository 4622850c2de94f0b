"""Files that ``cruiser setup`` writes, and commands that it runs, by answers and findings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import msgspec

from schemas.configuration import write_key, write_value

CONFIGURATION: Final = "/etc/cruiser/cruiser.toml"
METRICS: Final = "/etc/cruiser/metrics.toml"
KEYS: Final = "/etc/cruiser"
STATE: Final = "/var/lib/cruiser/gateway"
LOGS: Final = "/var/lib/cruiser/logs"
NETWORK: Final = "/etc/systemd/network"
UNITS: Final = "/etc/systemd/system"

BUDGET_BYTES: Final = 20_000_000_000
"""Logs may take so much, or BUDGET_SHARE of the disk where that is less."""

BUDGET_SHARE: Final = 0.7

QUEUE_FRAMES: Final = 10
RESTART_MS: Final = 100

SERVICES: Final = {
    "gateway": "robot",
    "recorder": "recorder",
    "router": "router",
    "desk": "desk",
    "metrics": "viewer",
}
"""Our services, each with the role of its certificate; its keys are in a directory of its name."""


PENDING: Final = frozenset(
    {
        "bus_unreachable",
        "bus_silent",
        "feedback_missing",
        "variant_unknown",
        "router_unreachable",
        "gateway_missing",
        "gateway_hangs",
        "service_not_active",
        "realtime",
        "unguarded",
        "blocked",
        "disk_unusable",
        "recorder_missing",
    }
)
"""Findings that may go by themselves in the first seconds after a start."""


class Answers(msgspec.Struct, frozen=True):
    """Answers of the person or the flags, and findings.

    Attributes:
        name: the robot's.
        root: first chunks of every key; empty leaves the settings' own.
        interface, channel, bitrate: the bus; 0 bit/s is one that has no bit rate, such as vcan.
        routers: Zenoh endpoints; none keeps the robot to its own machine, or to what its Zenoh file says.
        keys: services that have a certificate.
        has_network_file: systemd-networkd has a file for the interface already: a drop-in says the bit rate.
        free_bytes: of the disk of the logs, with what the logs take.
    """

    name: str
    root: str
    interface: str
    channel: str
    bitrate: int
    routers: list[str] = []
    keys: frozenset[str] = frozenset()
    has_network_file: bool = False
    free_bytes: int = 0

    @property
    def is_signed(self) -> bool:
        """The robot has keys of its own."""
        return "gateway" in self.keys

    @property
    def is_kernels(self) -> bool:
        """The bus is an interface of the kernel's."""
        return self.interface == "socketcan"

    @property
    def services(self) -> list[str]:
        """Those that are to run here. In signed mode one without a certificate reaches nobody."""
        wanted = ["gateway", "recorder"] if not self.is_signed else ["gateway"]
        return [
            name for name in ("router", "gateway", "recorder", "desk", "metrics") if name in {*wanted, *self.keys}
        ]


def configuration(answers: Answers, before: Mapping[str, Mapping[str, object]]) -> str:
    """The settings of the robot as TOML: those of before, but for what was answered."""
    tables = {name: dict(table) for name, table in before.items()}

    def put(table: str, **values: object) -> None:
        tables.setdefault(table, {}).update(values)

    put("robot", name=answers.name, **({"root": answers.root} if answers.root else {}))
    put("can", interface=answers.interface, channel=answers.channel)
    if answers.bitrate:
        put("can", bitrate=answers.bitrate)
    put("gateway", state_dir=STATE)
    put("recorder", directory=LOGS)
    if "budget_bytes" not in tables["recorder"]:
        put("recorder", budget_bytes=min(BUDGET_BYTES, int(answers.free_bytes * BUDGET_SHARE)) or BUDGET_BYTES)
    zenoh = tables.setdefault("zenoh", {})
    if answers.is_signed:
        put("authority", mode="signed", directory=f"{KEYS}/gateway")
        zenoh["config"] = _zenoh_file("gateway")
        zenoh.pop("connect", None)
    elif answers.routers:
        zenoh["connect"] = answers.routers
    lines = ["# Written by 'cruiser setup'. All settings, with their start values: docs/configuration.md"]
    for name, table in tables.items():
        if table:
            lines += [
                "",
                f"[{name}]",
                *(f"{write_key(key)} = {write_value(value)}" for key, value in table.items()),
            ]
    return "\n".join(lines) + "\n"


def system_files(answers: Answers) -> dict[str, str]:
    """Files besides the settings, by their paths: the bus, and which Zenoh file each service reads."""
    files = {f"{UNITS}/cruiser-gateway.service.d/bus.conf": _bus(answers)}
    if "metrics" in answers.keys:
        root = f"[robot]\nroot = {write_value(answers.root)}\n" if answers.root else ""
        files[METRICS] = (
            f"# Settings of cruiser-metrics.\n{root}[zenoh]\nconfig = {write_value(_zenoh_file('metrics'))}\n"
        )
    if "desk" in answers.keys:
        # Beside its settings file: its address for browsers stays as it is.
        variables = [f"CRUISER_ZENOH_CONFIG={_zenoh_file('desk')}"]
        variables += [f"CRUISER_ROBOT_ROOT={answers.root}"] if answers.root else []
        files[f"{UNITS}/cruiser-desk.service.d/zenoh.conf"] = (
            f"# The fleet, by its certificate.\n[Service]\nEnvironment={' '.join(variables)}\n"
        )
    if answers.is_signed and "recorder" in answers.keys:
        files[f"{UNITS}/cruiser-recorder.service.d/zenoh.conf"] = (
            "# The settings file names the gateway's.\n"
            f"[Service]\nEnvironment=CRUISER_ZENOH_CONFIG={_zenoh_file('recorder')}\n"
        )
    if not answers.is_kernels or not answers.bitrate:
        return files
    name, channel = f"80-cruiser-{answers.channel}", answers.channel
    can = f"[CAN]\nBitRate={answers.bitrate}\n"
    if answers.has_network_file:
        return files | {f"{NETWORK}/{name}.network.d/bitrate.conf": can}
    return files | {
        f"{NETWORK}/{name}.link": (
            f"[Match]\nOriginalName={channel}\n\n"
            f"[Link]\nNamePolicy=keep kernel\nTransmitQueueLength={QUEUE_FRAMES}\n"
        ),
        f"{NETWORK}/{name}.network": (
            f"[Match]\nName={channel}\n\n[Link]\nRequiredForOnline=no\n\n{can}RestartSec={RESTART_MS}ms\n"
        ),
    }


def _bus(answers: Answers) -> str:
    """Return the drop-in that binds the gateway's unit to the interface's device."""
    if not answers.is_kernels:
        return "# The bus is no interface of the kernel's.\n[Install]\nWantedBy=multi-user.target\n"
    device = f"sys-subsystem-net-devices-{escaped(answers.channel)}.device"
    return (
        f"# The CAN interface of the gateway, as in can.channel of {CONFIGURATION}.\n"
        f"[Unit]\nBindsTo={device}\nAfter={device}\n\n[Install]\nWantedBy={device}\n"
    )


def escaped(name: str) -> str:
    """A name as units' names have it (systemd-escape): what is neither letter nor digit by its number."""
    return "".join(
        one if one.isascii() and (one.isalnum() or one in ":_.") else f"\\x{ord(one):02x}" for one in name
    )


def _zenoh_file(service: str) -> str:
    return f"{KEYS}/{service}/{SERVICES[service]}.json5"


def start_services(answers: Answers) -> list[list[str]]:
    """Programs that let systemd know, and start what is to run here, in their order."""
    programs = [["systemctl", "daemon-reload"]]
    if answers.is_kernels and answers.bitrate:
        programs += [["systemctl", "enable", "--now", "systemd-networkd.service"], ["networkctl", "reload"]]
        programs += [["networkctl", "reconfigure", answers.channel]]
    for name in answers.services:
        unit = f"cruiser-{name}.service"
        programs += [["systemctl", "reenable", unit], ["systemctl", "restart", unit]]
    return programs
