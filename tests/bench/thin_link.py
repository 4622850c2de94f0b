"""What leaves a robot in each profile, and whether it can be driven over a thin uplink that this fills.

Chassis and gateway are processes; the router, the link and an operator with the product's library are this one.
Beside the operator somebody subscribes to everything, as a recorder does.
"""

from __future__ import annotations

import os
import re
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Final
from unittest.mock import patch

import msgspec
import zenoh

from gateway.client.refusal import Refused, Stopped, Unreachable
from gateway.client.robot import Lease, Robot
from gateway.zenoh.client import open_local_router
from schemas.configuration import TomlSource, merge
from schemas.settings import Settings, ZenohSettings
from schemas.zenoh_session import close_session, open_session
from tests.bench.command_latency import DRIVE_ID, SPEED_RAW, Witness
from tests.bench.loads import Row
from tests.bench.processes import quantile, start
from tests.support.fakes.peer import free_endpoint
from tests.support.links import LINKS, LinkProfile
from tests.support.processes.paced_link import PacedLink, paced_link

SETTLED_S: Final = 3.0
WIDE: Final = LinkProfile("wide", 0.0005)
WIDE_BYTES_PER_S: Final = 1e9
LTE: Final = next(link for link in LINKS if link.name == "LTE bad")
THIN_BYTES_PER_S: Final = 62_500
SPEED_MPS: Final = 0.5
DRIVE_S: Final = 0.05
TURNS: Final = 4
HELD_UP: Final = ("feedback", "loop", "guard")
"""Words of refusals and stops that are this machine's fault."""


class ThinLinkRun(msgspec.Struct, frozen=True):
    """What one profile showed over one link.

    Attributes:
        standing_bytes_per_s, driven_bytes_per_s: up the link, all connections of the gateway; 0 where not driven.
        ages_s: of the drive commands, sorted; empty if the robot could not be driven.
        refused: why it could not.
        stop_s: from a remote stop to the first frame that slows the robot, or to the reply where it stood.
    """

    standing_bytes_per_s: float
    driven_bytes_per_s: float
    ages_s: list[float]
    refused: str
    stop_s: float


def rows(profiles: Sequence[str], seconds: float) -> list[Row]:
    """These profiles, over a wide link and over the thin one."""
    found: list[Row] = []
    for profile in profiles:
        wide = run(profile, WIDE, WIDE_BYTES_PER_S, seconds)
        thin = run(profile, LTE, THIN_BYTES_PER_S, seconds)
        found += [
            (f"{profile}: standing, driven", _rates(wide), ""),
            (f"  over {LTE.name} with {THIN_BYTES_PER_S * 8 / 1e6:g} Mbit/s", _rates(thin), ""),
            ("    age of commands, p50 p99", _ages(thin), "under 1 s"),
            ("    remote stop to first frame, or reply", f"{thin.stop_s * 1000:.0f} ms", ""),
        ]
    return found


def _rates(one: ThinLinkRun) -> str:
    driven = f"{one.driven_bytes_per_s / 1000:.1f} kB/s" if one.ages_s else "not driven"
    return f"{one.standing_bytes_per_s / 1000:.1f} kB/s, {driven}"


def _ages(one: ThinLinkRun) -> str:
    if not one.ages_s:
        return one.refused
    return " ".join(f"{quantile(one.ages_s, share):.2f}" for share in (0.5, 0.99)) + " s"


def run(profile: str, link: LinkProfile, bytes_per_s: float, seconds: float) -> ThinLinkRun:
    """Measure a profile over a link: standing, driven, and stopped.

    A chassis or a gateway that other work held up says nothing of the link: then it is measured once more.
    """
    for _ in range(TURNS):
        measured = _run(profile, link, bytes_per_s, seconds)
        if not any(words in measured.refused for words in HELD_UP):
            break
    return measured


def _run(profile: str, link: LinkProfile, bytes_per_s: float, seconds: float) -> ThinLinkRun:
    with _scene(profile, link, bytes_per_s) as (carried, settings, witness):
        time.sleep(SETTLED_S)
        begin, begin_s = carried.up_bytes, time.monotonic()
        time.sleep(seconds)
        standing = (carried.up_bytes - begin) / (time.monotonic() - begin_s)
        ages: list[float] = []
        driven, refused = 0.0, ""
        with Robot.connect("cruiser-1", settings=settings, timeout_s=30) as robot:
            try:
                with robot.lease() as lease:
                    lease.engage(deadman_s=LTE.deadman_s)
                    lease.unpark()
                    begin, begin_s = carried.up_bytes, time.monotonic()
                    _drive(robot, lease, seconds, ages)
                    driven = (carried.up_bytes - begin) / (time.monotonic() - begin_s)
                    stop_s = _stop(robot, witness)
            except (Refused, Stopped, Unreachable) as error:
                ages, refused = [], str(error).partition(". Cure")[0]
                stop_s = _stop(robot, None)
    return ThinLinkRun(standing, driven, sorted(ages), refused, stop_s)


def _drive(robot: Robot, lease: Lease, seconds: float, ages: list[float]) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        lease.drive(SPEED_MPS)
        age_s = robot.state().state.link_age_last_s
        if age_s is not None:
            ages.append(age_s)
        time.sleep(DRIVE_S)


def _stop(robot: Robot, witness: Witness | None) -> float:
    put_s = time.monotonic()
    robot.stop(30)
    if witness is None:
        return time.monotonic() - put_s
    return witness.first_us(put_s, DRIVE_ID, lambda raw: raw < 0.95 * SPEED_RAW) / 1e6


@contextmanager
def _scene(profile: str, link: LinkProfile, bytes_per_s: float) -> Iterator[tuple[PacedLink, Settings, Witness]]:
    endpoint = free_endpoint()
    with ExitStack() as stack:
        stack.callback(open_local_router(endpoint).close)
        carried = stack.enter_context(paced_link(int(endpoint.rpartition(":")[2]), link, bytes_per_s))
        state = stack.enter_context(tempfile.TemporaryDirectory())
        _, ready = start(stack, ["-m", "gateway", "sim", "--listen", "127.0.0.1:0", "--variant", "fine"], "sim: ")
        address = re.search(r"127\.0\.0\.1:\d+", ready)
        assert address is not None, ready
        own = {"CRUISER_ZENOH_MODE": "client", "CRUISER_ZENOH_PROFILES": f"lo={profile}", "XDG_STATE_HOME": state}
        bus = ["--interface", "socketcand", "--channel", address[0], "--variant", "fine"]
        with patch.dict(os.environ, own):
            words = ["-m", "gateway", "gateway", *bus, "--connect", f"tcp/127.0.0.1:{carried.port}"]
            start(stack, words, "gateway: ")
        everything = open_session(ZenohSettings(mode="client"), [endpoint], [])
        stack.callback(close_session, everything)
        subscriber = everything.declare_subscriber("fleet/cruiser-1/**", zenoh.handlers.RingChannel(1))
        stack.callback(subscriber.undeclare)
        witness = Witness(address[0])
        stack.callback(witness.close)
        text = f'[zenoh]\nmode = "client"\nconnect = ["{endpoint}"]\n'
        yield carried, merge(TomlSource("", text), {}, {}), witness
