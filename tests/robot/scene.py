"""Common actions and checks for a robot in a box."""

import json
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from gateway.chassis.cruiser.early_stop import FOUND
from recorder.disk.log_names import INCIDENT_SUFFIX, PART_SUFFIX, SUFFIX
from tests.robot.box import Box
from tests.robot.outside import Life, Outside
from tests.support.reading import Read

STEADY_MPS: Final = 0.4  # what the operator asks for is 0.5 m/s

STEADY_S: Final = 4.0
DRIVES_S: Final = 150.0
STAYS_S: Final = 10.0
RECOVERED_S: Final = 60
RESTARTED_S: Final = 90
LOGS: Final = "/var/lib/cruiser/logs"

PROCESSES: Final = {"gateway": "cruiser gateway", "guard": "guard_main", "recorder": "cruiser record"}
"""By a part of their command lines."""

TOLD_S: Final = 2.0
"""At most from an interface that is up to zero speed told. Measured: docs/performance.md."""

POWER_CUT: Final = {"latched": FOUND, "not_shut_down": "lost its power"}
"""What ``cruiser doctor`` finds after a power cut in mid-drive."""

LOST_S: Final = 1.5
"""Most of the log that a power cut may cost: recorder.flush_s, 0.5 s, and what one busy processor adds."""


def install(box: Box) -> None:
    shutil.copy(os.environ["ROBOT_PACKAGE"], box.share / "cruiser.deb")
    box.run("dpkg -i /run/box/cruiser.deb", timeout_s=240)


def start(box: Box) -> None:
    box.boot()
    box.wait_up()
    box.wait_status()


def drive(box: Box, outside: Outside) -> None:
    start(box)
    begin_drive(box, outside)


def begin_drive(box: Box, outside: Outside) -> None:
    """Have the operator drive; return while the robot moves steadily."""
    seen = box.share / "steady"
    seen.unlink(missing_ok=True)
    box.run("systemctl start box-operator")
    try:
        outside.wait_steady(STEADY_MPS, STEADY_S, DRIVES_S)
        seen.touch()
    except TimeoutError:
        raise AssertionError(box.run("journalctl -b -u box-operator -u cruiser-gateway | tail -60")) from None


def drive_and_signal(box: Box, outside: Outside, signal: str) -> float:
    """Have the operator drive, then send the gateway a signal. Returns the time before it, by time.monotonic().

    The shell sends it itself: systemctl takes the only processor so long that the deadman may end the drive first.
    """
    gateway = box.run("systemctl show --property=MainPID --value cruiser-gateway").strip()
    begin_drive(box, outside)
    begun_s = time.monotonic()
    box.run(f"kill -{signal} {gateway}")
    return begun_s


def check_stays(outside: Outside, since_s: float, seconds: float = STAYS_S) -> None:
    """Check that nothing moved or was commanded to move since then, nor in the next seconds."""
    time.sleep(max(0.0, since_s + seconds - time.monotonic()))
    assert not outside.moves_since(since_s)
    assert not outside.drives_since(since_s)


def check_latched(box: Box) -> None:
    said = box.run("cruiser why cruiser-1", check=False)
    say("cruiser why", " | ".join(said.split("\n")[:4]))
    assert "cruiser reset" in said, box.run("journalctl -b -u box-operator -u cruiser-gateway | tail -60")


def check_doctor(box: Box, when: str, expected: Mapping[str, str], *, or_else: str = "") -> None:
    """Check doctor's findings: the expected words by check, and besides notes only ``or_else``."""
    found = json.loads(box.run("cruiser doctor --json", check=False))["findings"]
    for one in found:
        say(
            f"doctor, {when}",
            f"{'note: ' if one['is_note'] else ''}{one['check']}: {one['text']} -> {one['cure']}",
        )
    assert all(one["cure"] and "\n" not in one["text"] + one["cure"] for one in found)
    for check, words in expected.items():
        assert any(one["check"] == check and words in one["text"] for one in found), (check, words, found)
    assert {one["check"] for one in found if not one["is_note"]} <= {*expected, or_else}, found


def kill_service(box: Box, service: str) -> None:
    box.run(f"systemctl kill --signal=KILL --kill-whom=main {service}")
    wait_restarted(box, service)


def wait_restarted(box: Box, service: str) -> None:
    box.run(
        f"for i in $(seq {RESTARTED_S}); do "
        f"[ $(systemctl show --property=NRestarts --value {service}) = 0 ] || exit 0; sleep 1; done; "
        f"systemctl status {service}; journalctl -b -u {service} | tail -30; exit 1",
        timeout_s=2 * RESTARTED_S,
    )


def ask_fleet(box: Box, when: str, *, logs: bool = False) -> None:
    begun_s = time.monotonic()
    answers = box.run(
        f"/opt/cruiser/bin/python /usr/local/lib/box/fleet_inside.py {'LOGS' if logs else ''} "
        "|| { journalctl -b -u cruiser-desk -u cruiser-metrics | tail -30; exit 1; }"
    )
    say(f"desk and exporter, {when}", f"{answers.strip()}, after {time.monotonic() - begun_s:.0f} s")


def wait_log(box: Box) -> str:
    """Wait until the recorder has written some of a log. Returns the path of the finished log."""
    find = f"find {LOGS} -name '*{PART_SUFFIX}' ! -name '*{INCIDENT_SUFFIX}{PART_SUFFIX}' -size +100k"
    part = box.run(
        f"for i in $(seq {RECOVERED_S}); do {find} | grep . && exit 0; sleep 1; done; ls -l {LOGS}; exit 1"
    ).strip()
    return part.removesuffix(PART_SUFFIX) + SUFFIX


def check_log(box: Box, last: Life, lost_s: float = LOST_S, *, log: str = "") -> None:
    """Check that the earlier log is finished, and misses less than ``lost_s`` before ``last``.

    Without ``log`` the recorder has to report the recovery.
    """
    is_whole = f"[ -e {log} ]" if log else "journalctl -b -u cruiser-recorder | grep -q 'log recovered as'"
    box.run(
        f"for i in $(seq {RECOVERED_S}); do {is_whole} && exit 0; sleep 1; done; "
        f"journalctl -b -u cruiser-recorder | tail -30; ls -l {LOGS}; df {LOGS}; cruiser record status; exit 1"
    )
    logs = box.fetch(LOGS)
    whole = [path for path in logs.rglob(f"*{SUFFIX}") if not path.name.endswith(INCIDENT_SUFFIX + SUFFIX)]
    times_ns = [message[2] for path in whole for message in Read(path).messages]
    missing_s = (last.wall_ns - max(time_ns for time_ns in times_ns if time_ns <= last.wall_ns)) / 1e9
    say(
        "log",
        f"{len(whole)} whole, {len(times_ns)} messages; missing before the last sign of life: {missing_s:.2f} s",
    )
    assert missing_s < lost_s


def say_memory(box: Box) -> None:
    lines = box.run("ps -eo rss=,args= | grep python").splitlines()
    for name, words in PROCESSES.items():
        kilobytes = next(int(line.split()[0]) for line in lines if words in line)
        say("memory", f"{name}: {kilobytes / 1024:.0f} MiB resident")


def say(what: str, text: str) -> None:
    """Write a figure into the file of results."""
    with Path(os.environ["ROBOT_FIGURES"]).open("a", encoding="utf-8") as figures:
        figures.write(f"{what}: {text}\n")
