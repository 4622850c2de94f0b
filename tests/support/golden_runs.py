"""Makers of golden logs: a chassis, a gateway's core, its guard and a recorder in simulated time.

``python -m tests.support.golden_runs NAME`` makes a golden log that is not there yet.
"""

from __future__ import annotations

import hashlib
import json
import lzma
import sys
from collections.abc import Callable, Iterable
from fnmatch import fnmatch
from typing import Final

import msgspec

from recorder.record.robot_log import LogPlan
from schemas import codec, keys
from schemas.configuration import to_toml
from schemas.cruiser import DBC_FILES, dbc_text
from schemas.decisions import EventKind
from schemas.messages import GatewayInfo, Variant
from schemas.subjects import BY_NAME
from tests.support.authority import Fleet
from tests.support.golden_logs import AUTHORITY, DIRECTORY
from tests.support.messages import MS, ROOT, SECOND, FakeSample
from tests.support.rigs.recorder import PLAN, RecorderRig
from tests.support.signed_run import driven, log_of
from tests.system.scenarios.rig import WALL_NS, Gateway
from tests.system.scenarios.scenario import Play, scenario

DECIDED: Final = ("safety/*", "gateway/*")
SEEN: Final = (*DECIDED, "state", "chassis/body", "chassis/drive", "chassis/wheel_pulse")
FEW: Final = (*DECIDED, "chassis/drive")
RUN: Final = (*DECIDED, "journal", "chassis/body")
BUS: Final = (*RUN, "can/*")

Said = tuple[int, str, FakeSample | None]
"""When it is received, since the start; whose it is; a sample, or the robot's liveliness token that is gone."""

Files = dict[str, bytes]


def info(gateway: Gateway, variant: Variant, now_ns: int) -> bytes:
    configuration = to_toml(gateway._settings)
    time_ns = WALL_NS + now_ns
    return codec.encode(
        GatewayInfo(
            time_ns=time_ns, sequence=0, robot="cruiser-1", bus="can0", listen_only=False, started_ns=time_ns,
            variant=variant, versions={}, configuration=configuration,
            configuration_sha256=hashlib.sha256(configuration.encode()).hexdigest(),
            dbc_name=DBC_FILES[variant], dbc=dbc_text(variant), schemas={},
        )
    )  # fmt: skip


def said(seed: int, until_s: float, subjects: Iterable[str], robot: str = "cruiser-1") -> list[Said]:
    """All that the gateways of a scenario publish of these subjects until then."""
    plan = msgspec.structs.replace(scenario(seed), limit_s=until_s, rests_s=until_s)
    variant = Variant.FINE if plan.build.fine else Variant.COARSE
    found: list[Said] = []
    gateways: list[Gateway] = []
    taken = 0

    def add(subject: str, payload: bytes, now_ns: int) -> None:
        if any(fnmatch(subject, pattern) for pattern in subjects):
            row = BY_NAME[subject]
            key = keys.build(ROOT, robot, row, "can0" if "{bus}" in subject else "")
            found.append((now_ns, robot, FakeSample(key, row.encoding, payload)))

    def watch(play: Play) -> None:
        nonlocal taken
        now_ns = play.rig.now_ns
        if play.gateway not in gateways:
            gateways.append(play.gateway)
            taken = 0
            add("gateway/info", info(play.gateway, variant, now_ns), now_ns)
        for sample in play.gateway.samples[taken:]:
            add(sample.subject, sample.payload, now_ns)
        taken = len(play.gateway.samples)
        if play.rig.dead and not any(sample is None for _, _, sample in found):
            found.append((now_ns, robot, None))

    Play(plan, keeps=True, watch=watch).run()
    return found


class Recording(RecorderRig):
    """A recorder beside a simulated gateway, by the gateway's clock."""

    @property
    def wall_ns(self) -> int:
        return WALL_NS + self.now_ns


def recorded(
    samples: Iterable[Said], *, alarms: frozenset[EventKind] = frozenset(), rolls_s: float = 0.0
) -> Files:
    """The files that a recorder writes of these samples, incidents too; ``rolls_s`` ends a file."""
    around_ns = 2 * SECOND
    log = LogPlan("others", 262_144, SECOND // 2, "0.1.0", 0, 0, 0, alarms, around_ns, around_ns)
    rig = Recording(msgspec.structs.replace(PLAN, log=log, sample_max_bytes=1_000_000, ring_bytes=64_000_000))
    for now_ns, robot, sample in sorted(samples, key=lambda one: one[0]):
        while rig.now_ns + 10 * MS <= now_ns:
            rig.run(10 * MS)
            if rolls_s and (rig.now_ns - 10 * MS) < rolls_s * SECOND <= rig.now_ns:
                rig.writer.apply(rig.recorder.roll("asked", rig.now_ns))
        if sample is None:
            rig.recorder.lose_token(keys.liveliness(ROOT, robot), rig.now_ns)
        else:
            rig.receive(sample)
    rig.run(SECOND)
    rig.close()
    return {file.name: file.disk.getvalue() for files in rig.writer.files.values() for file in files}


def whole(name: str, samples: Iterable[Said]) -> Files:
    """The log of these samples, by a name of its own, without the incident of a gateway that died."""
    (data,) = (data for file, data in recorded(samples).items() if ".incident" not in file)
    return {f"{name}.mcap": data}


def hole(samples: Iterable[Said], from_s: float, to_s: float) -> list[Said]:
    """The samples, without those of a time in which the link was away."""
    return [one for one in samples if not from_s * SECOND <= one[0] < to_s * SECOND]


def incident() -> Files:
    """The file that a stop makes, beside the log."""
    files = recorded(said(40, 8, RUN), alarms=frozenset({EventKind.STOP}))
    (data,) = (data for file, data in files.items() if ".incident" in file)
    return {"incident.mcap": data}


def torn() -> Files:
    """The file of a recorder that was killed amid a write."""
    (data,) = recorded(said(40, 6, RUN)).values()
    return {"damaged-tail.mcap.part": data[: len(data) * 6 // 10]}


def corrupt() -> Files:
    """A whole file of which a disk has changed some bytes of a chunk."""
    (data,) = recorded(said(40, 6, RUN)).values()
    middle = len(data) // 2
    return {"damaged-chunk.mcap": data[:middle] + bytes(64) + data[middle + 64 :]}


def signed() -> Files:
    """A run in signed mode, and the authority that vouches for it."""
    fleet = Fleet()
    run, _ = driven(fleet)
    authority = {"active": fleet.authority.key.hex(), "standby": fleet.standby.key.hex()}
    return {"signed.mcap": log_of(run.samples), AUTHORITY: json.dumps(authority).encode()}


MAKERS: Final[dict[str, Callable[[], Files]]] = {
    "scenario-stops": lambda: whole("scenario-stops", said(38, 13, SEEN)),
    "scenario-latches": lambda: whole("scenario-latches", said(25, 12, SEEN)),
    "scenario-rerun": lambda: whole("scenario-rerun", said(43, 8, RUN)),
    "scenario-frames": lambda: whole("scenario-frames", said(38, 5, BUS)),
    "guard-stop": lambda: whole("guard-stop", said(530, 8.5, (*RUN, "chassis/drive"))),
    "two-robots": lambda: recorded([*said(34, 14, FEW), *said(40, 10, FEW, "cruiser-2")]),
    "rotated": lambda: recorded(said(43, 8, RUN), rolls_s=4.0),
    "hole": lambda: whole("hole", hole(said(27, 7, RUN), 3.0, 3.8)),
    "incident": incident,
    "damaged-tail": torn,
    "damaged-chunk": corrupt,
    "signed": signed,
}


def make(name: str) -> None:
    """Make the files of a log; a stored one never changes."""
    (DIRECTORY / name).mkdir()
    for file, data in MAKERS[name]().items():
        (DIRECTORY / name / f"{file}.xz").write_bytes(lzma.compress(data, preset=9 | lzma.PRESET_EXTREME))


if __name__ == "__main__":
    for each in sys.argv[1:]:
        make(each)
