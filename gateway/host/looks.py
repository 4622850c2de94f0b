"""Collect facts for the doctor: the bus, without sending anything, and the computer."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec

from gateway.authority.robot_authority import Kept
from gateway.can.can_bus import Bus, BusLost
from gateway.can.open_bus import SOCKETCAN, open_bus
from gateway.chassis.layout import check
from gateway.choice.chassis import CHASSIS
from gateway.core import Core
from gateway.doctor.facts import BusReport, CanInterface, Credential, LogDisk, ServiceUnit
from gateway.host.notes import StopNote
from gateway.host.signed_mode import AuthorityNote
from gateway.provisioning.key_files import certificate_ends_s, check_tls_files
from gateway.telemetry.health import Links
from schemas.authority.key_files import directory_of, read_identity
from schemas.authority.trust import Objection
from schemas.codec import Sample, decode
from schemas.command_line import CommandError, plain
from schemas.messages import GatewayHealth, Message, RobotState
from schemas.reasons import TEXTS
from schemas.settings import TICK_NS, Settings, ZenohSettings
from schemas.subjects import BY_NAME

Runner = Callable[[Sequence[str]], str | None]
"""Run a system program. Returns its output; None if it is missing or failed."""

IFF_UP: Final = 1

LOOKS_MAX: Final = 3  # at one a second

NETWORKS: Final = Path("/sys/class/net")

CAN_KIND: Final = "280"  # ARPHRD_CAN, as the kernel's if_arp.h has it


def look_at_interface(settings: Settings, run: Runner, networks: Path = NETWORKS) -> CanInterface | None:
    """Inspect the interface of the settings. Returns None if it is not a kernel interface."""
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
    link = _link_of(run, name)
    return CanInterface(
        is_present=True,
        is_up=is_up,
        is_virtual=link.info_kind != "can",
        bitrate=link.info_data.bittiming.get("bitrate"),
        controller=link.info_data.state,
        restart_ms=link.info_data.restart_ms,
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
    """Return iproute2's description of an interface; empty if iproute2 is not installed."""
    try:
        printed = run(["ip", "-details", "-json", "link", "show", "dev", name]) or "[]"
        return next(iter(msgspec.json.decode(printed, type=list[_Link])), _Link()).linkinfo
    except msgspec.MsgspecError:
        return _LinkInfo()


def can_interfaces(networks: Path = NETWORKS) -> list[str]:
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
    """Listen for a second, with the gateway's own decoding and supervision.

    If some required frames are missing, listen for three seconds: on a busy computer frames arrive late.
    """
    try:
        with closing(opener(settings)) as bus:
            return _listen(bus, settings, stopped, monotonic_ns)
    except BusLost as error:
        return BusReport(str(error))


def _listen(
    bus: Bus, settings: Settings, stopped: Callable[[], bool], monotonic_ns: Callable[[], int]
) -> BusReport:
    motion = {CHASSIS.common.messages[name].can_id for name in CHASSIS.motion_frames}
    deaf = msgspec.structs.replace(settings.gateway, listen_only=True)
    start_ns = tick_ns = monotonic_ns()
    deaf_settings = msgspec.structs.replace(settings, gateway=deaf)
    core = Core(CHASSIS, deaf_settings, version("cruiser-gateway"), start_ns)
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
    """Report whether some of the feedback arrives, but not all that is required."""
    seen = {row.name for row in health.feedback if row.valid and not row.silent}
    return bool(seen) and not seen.issuperset(settings.chassis.required_feedback)


def _message(sample: Sample) -> Message | None:
    subject = BY_NAME.get(sample.subject)
    if subject is None or subject.type not in {GatewayHealth, RobotState}:
        return None
    message = decode(subject, sample.payload)
    return message if isinstance(message, Message) else None


UNITS: Final = (
    "cruiser-gateway.service",
    "cruiser-recorder.service",
    "cruiser-router.service",
    "cruiser-desk.service",
    "cruiser-metrics.service",
    "cruiser-upload.service",
)

PROGRAM_TIMEOUT_S: Final = 30.0

GRANT_ENDS_SOON_S: Final = 7 * 86_400

LOGS: Final = ("*.mcap", "*.mcap.part")

FAILED: Final = "d9b373ed55a64feb8242e02dbe79a49c"
SHUTTING_DOWN: Final = ("98268866d1d54a499c4e98921d93bc40", "d93fb3c9c24d451a97cea615ce59c00b")
"""Message identifiers (``journalctl --catalog``): a unit failed; the system shuts down, the journal stops."""

RECOVERED: Final = "EXT4-fs .*: recovery complete"
"""The kernel's message when it mounts a file system that was not unmounted."""


def run_program(words: Sequence[str]) -> str | None:
    try:
        done = subprocess.run(  # noqa: S603 - programs of the system, named in this tree
            list(words), capture_output=True, text=True, check=False, timeout=PROGRAM_TIMEOUT_S
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def is_synchronised(run: Runner) -> bool | None:
    """Report whether the clock is synchronised with a time server. None if systemd does not know."""
    printed = run(["timedatectl", "show", "--property=NTPSynchronized", "--value"])
    return None if not printed else printed.strip() == "yes"


def earliest_s(settings: Settings) -> float:
    """Return the installation's time or the authority's newest, seconds since 1970: both are certainly past."""
    installed_s = Path(__file__).stat().st_mtime
    if settings.authority.mode != "signed":
        return installed_s
    note = AuthorityNote.of(settings)
    with owning(note.path):
        kept = note.read()
    note.close()
    return max(installed_s, kept.floor_s if isinstance(kept, Kept) else 0.0)


def look_at_disk(directory: Path) -> LogDisk:
    shown = plain(str(directory))
    try:
        found = os.statvfs(directory)
        used = sum(one.stat().st_blocks * 512 for kind in LOGS for one in directory.glob(kind))
    except OSError as error:
        return LogDisk(shown, f"{shown}: {(error.strerror or str(error)).lower()}")
    is_read_only = bool(found.f_flag & os.ST_RDONLY)
    with owning(directory):
        may_write = os.access(directory, os.W_OK | os.X_OK, effective_ids=True)
    why_not = "" if may_write else f"{shown} cannot be written to"
    free, size = found.f_bavail * found.f_frsize, found.f_blocks * found.f_frsize
    return LogDisk(shown, why_not, is_read_only, free, size, used)


def look_at_units(run: Runner = run_program) -> list[ServiceUnit]:
    """Inspect our services that are enabled or running; none without systemd."""
    wanted = "LoadState,ActiveState,UnitFileState,Result,NRestarts"
    units = []
    for name in UNITS:
        lines = (run(["systemctl", "show", "--property", wanted, name]) or "").splitlines()
        unit = dict(line.split("=", 1) for line in lines if "=" in line)
        is_ours = unit.get("LoadState") == "loaded"
        if is_ours and (unit.get("UnitFileState", "").startswith("enabled") or unit["ActiveState"] != "inactive"):
            restarts = int(unit.get("NRestarts", "0") or 0)
            result, ended_s = unit.get("Result", "success"), None
            if restarts:
                # systemd drops the result at the next start.
                result, ended_s = _last_failure(name, run) or (result, None)
            units.append(ServiceUnit(name, unit.get("ActiveState", ""), result, restarts, ended_s))
    return units


def _last_failure(unit: str, run: Runner) -> tuple[str, float] | None:
    """Return result and time of a unit's last failure since the boot; None if the journal has none."""
    matches = [f"MESSAGE_ID={FAILED}", f"UNIT={unit}"]
    found = run(["journalctl", "--quiet", "--boot", "--lines=1", "--output=json", *matches])
    try:
        entry = json.loads(found or "")
        return str(entry["UNIT_RESULT"]), int(entry["__REALTIME_TIMESTAMP"]) / 1e6
    except (ValueError, KeyError, TypeError):
        return None


def booted_s() -> float:
    """Return the boot time of this computer, seconds since 1970."""
    return time.time() - time.clock_gettime(time.CLOCK_BOOTTIME)


def was_shut_down(run: Runner = run_program) -> bool | None:
    """Report whether this computer was shut down before it booted; None if its journal does not say."""
    # The journal may lack a short run, or the end of one; a file system that was not unmounted tells it too.
    if run(["journalctl", "--quiet", "--boot", "--dmesg", "--lines=1", f"--grep={RECOVERED}"]):
        return False
    before = ["journalctl", "--quiet", "--boot=-1", "--lines=1", "--output=json", "_PID=1"]
    if not run(before):
        # No journal of that run, or none that this user may read.
        return None
    found = run([*before[:-1], *(f"MESSAGE_ID={one}" for one in SHUTTING_DOWN)])
    return None if found is None else bool(found)


def look_at_stop_note(settings: Settings) -> str:
    """Return the note of a stop by the guard in one line; empty if this user may not read it."""
    note = StopNote.of(settings)
    return note.read() if note.path is not None and os.access(note.path, os.R_OK) else ""


def look_at_credentials(settings: Settings, files: Sequence[Path], now_s: float) -> list[Credential]:
    """Inspect the certificates of Zenoh files, with their keys, and the robot's grant."""
    found = [_certificate(file, now_s) for file in files]
    if settings.authority.mode == "signed":
        found.append(_grant(directory_of(settings.authority), now_s))
    return found


def _certificate(file: Path, now_s: float) -> Credential:
    name = f"certificate of {plain(str(file))}"
    with owning(file):
        try:
            warning = check_tls_files(file, file.stem, now_s)
        except CommandError as error:
            return Credential(name, str(error))
        return Credential(name, "", warning, certificate_ends_s(ZenohSettings(config=str(file))))


def _grant(directory: Path, now_s: float) -> Credential:
    name = f"grant in {plain(str(directory))}"
    cure = "'cruiser provision renew robot' asks for another"
    with owning(directory):
        try:
            identity = read_identity(directory, "robot")
        except CommandError as error:
            return Credential(name, str(error))
    held = identity.trust.judge(identity.chain, int(now_s))
    if isinstance(held, Objection):
        return Credential(name, f"{name}: {TEXTS[held.reason].means}; {cure}")
    left_s = held.grant.not_after - now_s
    soon = f"{name} ends in {left_s / 86_400:.1f} days; {cure}" if left_s < GRANT_ENDS_SOON_S else ""
    return Credential(name, "", soon, held.grant.not_after)


@contextmanager
def owning(path: Path | None) -> Iterator[None]:
    """Act as the owner of a file where this process is root, as its service would: keys are for their owner."""
    try:
        status = None if path is None or os.geteuid() else path.stat()
    except OSError:
        status = None
    if status is None or not status.st_uid:
        yield
        return
    os.setegid(status.st_gid)
    os.seteuid(status.st_uid)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(0)
