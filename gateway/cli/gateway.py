"""``cruiser gateway``: connect a chassis to Zenoh."""

from __future__ import annotations

import argparse
import hashlib
import logging
import os
import secrets
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.can.can_bus import Bus, BusLost
from gateway.can.open_bus import BusClaim, ReconnectingBus, describe, open_bus
from gateway.choice.chassis import CHASSIS
from gateway.cli.shut_out import why_away, why_shut_out
from gateway.command.restart import Carried
from gateway.core import Core
from gateway.guard.stopper import Stopper
from gateway.host.guard_main import stop_alone
from gateway.host.guard_process import FormerGuard, GuardLink, start_guard
from gateway.host.notes import LatchNote, MileageNote, NoteClearer, RunNote, StopNote
from gateway.host.process import ServiceManager, has_realtime, logging_aside, request_realtime
from gateway.loop import LoopPorts, warn_of_bars
from gateway.loop import run as run_loop
from gateway.zenoh.inbox import CommandInbox, Joined, LateInbox, LateNode, open_inbox
from gateway.zenoh.node import ZenohNode, ZenohPlace, client_place, open_node
from schemas.arguments import add_bus_arguments, add_variant_argument, add_zenoh_arguments, ending_after, seconds
from schemas.codec import encode
from schemas.command_line import CommandError, ExitCode, installed_version, plain
from schemas.configuration import to_toml
from schemas.json_schema import robot_schema_texts
from schemas.messages import GatewayInfo, Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import Settings
from schemas.zenoh_session import SessionError, said_of

if TYPE_CHECKING:
    from gateway.host.signed_mode import Renewal, SignedMode

log = logging.getLogger(__name__)

EXAMPLE = """\
  cruiser gateway --interface socketcan --channel can0 --robot cruiser-7
  cruiser gateway --interface socketcand --channel 127.0.0.1:29536   (the virtual chassis of 'cruiser sim')"""

RUN_BITS = 53  # every language's numbers hold as many
HELD_BY_MOTOR = "only the motor holds the robot, its parking brake does not: chock its wheels"

VERSIONS_TOLD = ("cruiser-gateway", "eclipse-zenoh", "python-can", "msgspec")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    # It runs for hours, and who looks into its log wants to see links come and go.
    parser.set_defaults(log_level="info")
    add_bus_arguments(parser)
    add_variant_argument(parser)
    parser.add_argument(
        "--listen", dest="zenoh.listen", metavar="ENDPOINT", action="append", help="Zenoh endpoint to listen on"
    )
    add_zenoh_arguments(parser)
    parser.add_argument(
        "--listen-only",
        dest="gateway.listen_only",
        action=argparse.BooleanOptionalAction,
        help="telemetry only: send nothing on the bus",
    )
    parser.add_argument(
        "--wait-for-bus",
        dest="gateway.wait_for_bus",
        action=argparse.BooleanOptionalAction,
        help="start even if the bus is missing",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="duration")


@contextmanager
def _run_noted(core: Core, settings: Settings) -> Iterator[None]:
    """Record for the next gateway whether this one ended properly."""
    note = RunNote.of(settings)
    if note.begin():
        core.note_crash(time.monotonic_ns())
    yield
    note.end()
    if core.is_held_by_motor:
        # The guard goes on, and the chassis executes its last command: zero speed, in gear.
        raise CommandError(HELD_BY_MOTOR, ExitCode.PARTIAL)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Run the gateway until it is stopped, or until its keys were renewed and its service manager restarts it.

    A restart clears no latch.
    """
    ends = ending_after(stopped, arguments.seconds, time.monotonic)
    # Before anything is read: what is replaced meanwhile is new.
    renewal = _renewal(settings)
    started_ns, run_number = time.monotonic_ns(), secrets.randbits(RUN_BITS)
    core = Core(CHASSIS, settings, installed_version("cruiser-gateway"), started_ns, run_number)
    with ExitStack() as closing:
        latch_note = _recall_latched(core, settings)
        closing.callback(latch_note.close)
        mileage_note = MileageNote.of(settings)
        # First, since it takes a second, and ended last.
        guard = start_guard(settings)
        closing.callback(guard.close)
        signed = _signed_mode(settings, core, closing)
        node, inbox, place = _join(settings, signed)
        closing.callback(node.close)
        if inbox is not None:
            closing.callback(inbox.close)
        _look_at_own_files(settings, signed, place)
        _warn_of_bars(core, settings, place)
        info = _info(settings, core, place)
        # The bus comes last: frames that wait while the rest starts would come in one burst, too late.
        bus = ReconnectingBus(lambda: _open_bus(settings), _first_bus(settings))
        closing.callback(bus.close)
        mode = "listen-only" if inbox is None else "commands through the arbiter"
        is_shared = inbox is not None and closing.enter_context(BusClaim(settings.can)).is_shared
        sys.stderr.write(f"gateway: {settings.robot.name} {place}, bus {describe(settings.can)}, {mode}\n")
        if is_shared:
            log.warning("%s", _shared(settings))
        if node.warning and core.command is None:
            log.warning("%s", node.warning)
        elif node.warning:
            core.warn(node.warning, time.monotonic_ns())
        # Before the note is read: of what the guard says meanwhile, nothing is missed.
        former_guard = FormerGuard(StopNote.of(settings), settings.gateway.realtime_priority)
        note = NoteClearer(_recall_guard_stop(core, settings))
        closing.callback(note.close)
        closing.callback(former_guard.close)
        if inbox is not None and guard.why_not:
            log.warning("%s", _unguarded(settings, guard.why_not))
        if place.connect and not place.is_client and not node.peers():
            log.warning("no Zenoh node answers at %s yet; retrying", plain(", ".join(place.connect)))
        request_realtime(settings.gateway.realtime_priority)
        if inbox is not None and not has_realtime():
            log.warning("%s", _without_realtime(settings))
        ports = LoopPorts(
            bus,
            node,
            inbox,
            guard,
            note,
            former_guard,
            has_realtime,
            signed,
            lambda: _notes(signed, renewal, node),
            _manager(closing),
            latch_note.follow,
            mileage_note.follow,
        )
        with _run_noted(core, settings):
            try:
                with logging_aside():
                    run_loop(ports, core, info, ends if renewal is None else renewal.ending(ends, core))
            except Exception:
                _stop_unguarded(core, bus, guard, settings)
                raise
    return int(ExitCode.OK)


def _join(
    settings: Settings, signed: SignedMode | None
) -> tuple[ZenohNode | LateNode, CommandInbox | LateInbox | None, ZenohPlace]:
    """Open the gateway's sessions. A client without an accepting router joins later."""
    try:
        (node, inbox), place = _open_sessions(settings, signed)
    except SessionError as error:
        cause = why_away(error)
        if not cause or not _is_client(settings):
            raise
        late = None if settings.gateway.listen_only else LateInbox()
        join = partial(_join_late, settings, signed)
        return LateNode(join, late, cause), late, client_place(settings)
    if inbox is not None:
        node.disregard(inbox.node)
    return node, inbox, place


def _join_late(settings: Settings, signed: SignedMode | None) -> Joined:
    try:
        return _open_sessions(settings, signed)[0]
    except SessionError as error:
        raise CommandError(why_away(error) or str(error), error.code) from error


def _is_client(settings: Settings) -> bool:
    return said_of(settings.zenoh).mode == "client"


def _open_sessions(settings: Settings, signed: SignedMode | None) -> tuple[Joined, ZenohPlace]:
    config = settings.zenoh.config
    if config and _is_client(settings) and (fault := why_shut_out(config)):
        raise SessionError("cannot open Zenoh", fault, config)
    if signed is None:
        node, place = open_node(settings)
    else:
        node, place = open_node(settings, signed.authority.signer, signed.authority.name_proof)
    try:
        inbox = None if settings.gateway.listen_only else _open_inbox(settings, place, signed)
    except CommandError:
        node.close()
        raise
    return (node, inbox), place


def _open_inbox(settings: Settings, place: ZenohPlace, signed: SignedMode | None) -> CommandInbox:
    if signed is None:
        return open_inbox(settings, place)
    return open_inbox(settings, place, signed.authority.admission.may_be_holders, signed.sieve())


def _manager(closing: ExitStack) -> Callable[[str], None] | None:
    manager = ServiceManager.of(os.environ)
    if manager is None:
        return None
    closing.callback(manager.close)
    return manager.alive


def _look_at_own_files(settings: Settings, signed: SignedMode | None, place: ZenohPlace) -> None:
    """Bar engaging if the robot's own file or endpoints accept any client."""
    if signed is not None:
        from gateway.host.self_test import Reached, own_fault  # noqa: PLC0415 - open mode does without

        reached = Reached(place.connect, [*place.listen, *place.command_listen])
        signed.authority.self_test = own_fault(settings, reached)


def _notes(signed: SignedMode | None, renewal: Renewal | None, node: ZenohNode | LateNode) -> tuple[str, ...]:
    own = ("" if renewal is None else renewal.note, "" if signed is None else signed.note(time.time()))
    return (*filter(None, own), *node.notes())


def _signed_mode(settings: Settings, core: Core, closing: ExitStack) -> SignedMode | None:
    """Return the authority of a robot in signed mode. Without its keys only telemetry runs."""
    if settings.authority.mode != "signed":
        return None
    # What proves and verifies takes a quarter of the process's memory: open mode does without. It is loaded here,
    # at the start, for no import may hold up the loop.
    from gateway.host.signed_mode import SignedMode  # noqa: PLC0415
    from gateway.provisioning.key_files import check_tls_files  # noqa: PLC0415

    try:
        signed = SignedMode(settings, core)
        closing.callback(signed.close)
        # A client is not on the network before its files are in order.
        if settings.zenoh.config and not _is_client(settings):
            check_tls_files(Path(settings.zenoh.config), "robot", time.time())
    except CommandError as error:
        core.bar({Reason.SELF_TEST: str(error)}, time.monotonic_ns())
        return None
    return signed


def _renewal(settings: Settings) -> Renewal | None:
    if settings.authority.mode != "signed":
        return None
    from gateway.host.signed_mode import Renewal  # noqa: PLC0415 - open mode does without

    return Renewal(settings, is_managed=ServiceManager.of(os.environ) is not None)


def _warn_of_bars(core: Core, settings: Settings, place: ZenohPlace) -> None:
    """Log why the robot cannot be engaged. Open mode arms only if other machines cannot reach the gateway."""
    if core.command is not None and settings.authority.mode == "open" and place.outside:
        core.bar({Reason.UNAUTHENTICATED: f"by {', '.join(place.outside)}"}, time.monotonic_ns())
    warn_of_bars(core.bars)


def _stop_unguarded(core: Core, bus: ReconnectingBus, guard: GuardLink, settings: Settings) -> None:
    """Stop the robot after the loop failed, if no guard does."""
    told = None if core.command is None else core.command.arbiter.output.actuation
    if core.command is None or told is None or guard.look().is_watching:
        return
    view = CHASSIS.view()
    stopper = Stopper(CHASSIS, view, settings.command)
    counters = bytes(core.command.maker.counters.values())
    stopper.begin(told, core.command.arbiter.output.variant, counters, time.monotonic_ns())
    outcome = stop_alone(bus, stopper, view, lambda: guard.look().is_sending)
    text = f"the loop has failed and there is no guard: the gateway stopped the robot itself; {outcome}"
    log.error("%s", text)
    with suppress(OSError):
        StopNote.of(settings).add(f"gateway: {text}")


def _recall_latched(core: Core, settings: Settings) -> LatchNote:
    """Restore the latches from before this start. Returns their note."""
    note = LatchNote.of(settings)
    if latched := {one.value: text for one, text in note.read().items()}:
        core.take_over(Carried(latched), time.monotonic_ns())
    return note


def _recall_guard_stop(core: Core, settings: Settings) -> StopNote:
    """Latch a stop by the guard from before this start. Returns its note."""
    note = StopNote.of(settings)
    why_not = note.why_not()
    if core.command is not None and why_not:
        log.warning("latches, including a stop by the guard, will not survive a restart: %s", why_not)
    words = note.read()
    if words:
        core.latch_guard_stop(words, time.monotonic_ns())
    return note


def _without_realtime(settings: Settings) -> str:
    text = TEXTS[Reason.NO_REALTIME]
    limit_mps = settings.command.speed_limit_without_realtime_mps
    limit = f"{limit_mps:g} m/s (command.speed_limit_without_realtime_mps)"
    return f"{text.means}: {limit}; {text.cure}"


def _shared(settings: Settings) -> str:
    return (
        f"another gateway on this machine commands {describe(settings.can)} too: two gateways on one chassis stop "
        "each other; end one, or start it with --listen-only"
    )


def _unguarded(settings: Settings, why: str) -> str:
    consequence = (
        "engaging is allowed anyway (gateway.accept_unguarded), up to "
        f"{settings.command.speed_limit_without_realtime_mps:g} m/s"
        if settings.gateway.accept_unguarded
        else "engaging is refused (gateway.accept_unguarded = true would accept it)"
    )
    return f"no guard watches this gateway: {why}; {consequence}"


def _open_bus(settings: Settings) -> Bus:
    return open_bus(settings.can, () if settings.can.raw_frames else CHASSIS.common.identifiers)


def _first_bus(settings: Settings) -> Bus | None:
    try:
        return _open_bus(settings)
    except BusLost as error:
        if settings.gateway.wait_for_bus:
            return None
        raise CommandError(
            f"{error} (with --wait-for-bus the gateway starts without it)", ExitCode.UNREACHABLE
        ) from error


def _info(settings: Settings, core: Core, place: ZenohPlace) -> Callable[[], bytes]:
    """Return a function for the payload of gateway/info, whose parts other than the variant never change."""
    configuration = to_toml(settings)
    versions = {name: installed_version(name) for name in VERSIONS_TOLD} | {"python": sys.version.split()[0]}
    schemas = robot_schema_texts()
    started_ns = time.time_ns()

    def payload(variant: Variant) -> bytes:
        return encode(
            GatewayInfo(
                time_ns=started_ns,
                sequence=0,
                robot=settings.robot.name,
                bus=settings.can.bus,
                listen_only=settings.gateway.listen_only,
                started_ns=started_ns,
                variant=variant,
                versions=versions,
                configuration=configuration,
                configuration_sha256=hashlib.sha256(configuration.encode()).hexdigest(),
                dbc_name=CHASSIS.dbc_files.get(variant, ""),
                dbc=CHASSIS.dbc_text(variant) if variant in CHASSIS.dbc_files else "",
                schemas=schemas,
                listen=place.listen,
                command_listen=place.command_listen,
            )
        )

    payloads = {variant: payload(variant) for variant in Variant}
    return lambda: payloads[core.variant]
