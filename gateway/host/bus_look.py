"""Looks at a CAN bus without sending anything: the interface, who commands it, what chassis is on it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from gateway.can.can_bus import Bus, BusLost
from gateway.can.open_bus import SOCKETCAN, open_bus
from gateway.chassis.cruiser.frames import MOTION_FRAMES
from gateway.chassis.cruiser.layout import load
from gateway.chassis.decode import check
from gateway.core import Core
from gateway.doctor.facts import BusReport, CanInterface
from gateway.telemetry.health import Links
from schemas.codec import Sample, decode
from schemas.messages import GatewayHealth, Message, RobotState, Variant
from schemas.settings import TICK_NS, Settings
from schemas.subjects import BY_NAME

Runner = Callable[[Sequence[str]], str | None]
"""Runs a program of the system. Returns what it printed; None if it is not there or failed."""

IFF_UP: Final = 1

LOOKS_MAX: Final = 3
"""Seconds, of one look each."""

NETWORKS: Final = Path("/sys/class/net")

CAN_KIND: Final = "280"
"""ARPHRD_CAN, as the kernel's if_arp.h has it."""


def look_at_interface(settings: Settings, run: Runner, networks: Path = NETWORKS) -> CanInterface | None:
    """Look at the interface of the settings. None where it is none of the kernel's."""
    name = settings.can.channel
    if settings.can.interface != SOCKETCAN:
        return None
    place = networks / name
    if "/" in name or not place.is_dir():
        return CanInterface()
    try:
        is_up = bool(int((place / "flags").read_text("ascii"), 16) & IFF_UP)
        queue_frames = int((place / "tx_queue_len").read_text("ascii"))
    except (OSError, ValueError):
        return CanInterface()
    about = _link_of(run, name)
    return CanInterface(
        is_present=True,
        is_up=is_up,
        is_virtual=about.info_kind != "can",
        bitrate=about.info_data.bittiming.get("bitrate"),
        controller=about.info_data.state,
        restart_ms=about.info_data.restart_ms,
        queue_frames=queue_frames,
    )


class _LinkData(msgspec.Struct, frozen=True):
    state: str = ""
    restart_ms: int | None = None
    bittiming: dict[str, int] = {}


class _LinkInfo(msgspec.Struct, frozen=True):
    info_kind: str = "can"
    info_data: _LinkData = _LinkData()


class _Link(msgspec.Struct, frozen=True):
    linkinfo: _LinkInfo = _LinkInfo()


def _link_of(run: Runner, name: str) -> _LinkInfo:
    """Return iproute2's description of an interface; empty where it is not installed."""
    try:
        printed = run(["ip", "-details", "-json", "link", "show", "dev", name]) or "[]"
        return next(iter(msgspec.json.decode(printed, type=list[_Link])), _Link()).linkinfo
    except msgspec.MsgspecError:
        return _LinkInfo()


def can_interfaces(networks: Path = NETWORKS) -> list[str]:
    """Return the names of the kernel's CAN interfaces."""
    try:
        return sorted(one.name for one in networks.iterdir() if _kind(one) == CAN_KIND)
    except OSError:
        return []


def _kind(place: Path) -> str:
    try:
        return (place / "type").read_text("ascii").strip()
    except OSError:
        return ""


def listen(
    settings: Settings,
    stopped: Callable[[], bool] = lambda: False,
    opener: Callable[[Settings], Bus] = lambda settings: open_bus(settings.can),
    monotonic_ns: Callable[[], int] = time.monotonic_ns,
) -> BusReport:
    """Listen for a second, through the gateway's own telemetry, which supervises and decodes.

    Where the chassis is heard and a frame that is needed is not, it is listened for three: on a busy computer
    frames come late.

    Raises:
        CommandError: the settings name an interface that python-can does not have.
    """
    try:
        bus = opener(settings)
    except BusLost as error:
        return BusReport(str(error))
    try:
        return _listen(bus, settings, stopped, monotonic_ns)
    except BusLost as error:
        return BusReport(str(error))
    finally:
        bus.close()


def _listen(
    bus: Bus, settings: Settings, stopped: Callable[[], bool], monotonic_ns: Callable[[], int]
) -> BusReport:
    layout = load(Variant.COARSE)
    motion = {layout.messages[name].can_id for name in MOTION_FRAMES}
    deaf = msgspec.structs.replace(settings.gateway, listen_only=True)
    start_ns = tick_ns = monotonic_ns()
    core = Core(msgspec.structs.replace(settings, gateway=deaf), version("cruiser-gateway"), start_ns)
    core.update_links(Links(bus_up=True), start_ns)
    looks: list[GatewayHealth] = []
    state: RobotState | None = None
    is_commanded = False
    while not (stopped() or len(looks) == LOOKS_MAX or (looks and not _is_incomplete(looks[-1], settings))):
        tick_ns += TICK_NS
        while (now_ns := monotonic_ns()) < tick_ns:
            frame = bus.receive((tick_ns - now_ns) / 1e9)
            if frame is not None:
                is_commanded = is_commanded or (frame.can_id in motion and check(frame) is None)
                core.receive_frame(frame, monotonic_ns())
        for sample in core.tick(now_ns, time.time_ns(), 0, b"").samples:
            match _message(sample):
                case GatewayHealth() as health:
                    looks.append(health)
                case RobotState() as state:
                    pass
    return BusReport("", looks[-1] if looks else None, state, is_commanded)


def _is_incomplete(health: GatewayHealth, settings: Settings) -> bool:
    """Report whether some of the feedback comes, and some that is needed does not."""
    heard = {row.name for row in health.feedback if row.valid and not row.silent}
    return bool(heard) and not heard.issuperset(settings.chassis.required_feedback)


def _message(sample: Sample) -> Message | None:
    subject = BY_NAME.get(sample.subject)
    if subject is None or subject.type not in {GatewayHealth, RobotState}:
        return None
    message = decode(subject, sample.payload)
    return message if isinstance(message, Message) else None
