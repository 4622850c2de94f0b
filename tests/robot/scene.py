"""What the tests do with a robot in a box, and what they judge each time."""

import os
import time
from pathlib import Path
from typing import Final

from recorder.disk.log_directory import INCIDENT_SUFFIX, SUFFIX
from tests.robot.box import Box
from tests.robot.outside import Life, Outside
from tests.support.reading import Read

STEADY_MPS: Final = 0.4
"""What the operator asks for is 0.5 m/s."""

STEADY_S: Final = 4.0
DRIVES_S: Final = 150.0
STAYS_S: Final = 10.0
RECOVERED_S: Final = 60

LOST_S: Final = 1.5
"""Most of the log that a power cut may cost: recorder.flush_s, 0.5 s, and what one busy processor adds."""


def start(box: Box) -> None:
    """Boot until the gateway could be engaged."""
    box.boot()
    box.wait_up()
    box.wait_status()


def drive(box: Box, outside: Outside) -> None:
    """Boot, and have the operator drive; return while the robot moves steadily."""
    start(box)
    begin_drive(box, outside)


def begin_drive(box: Box, outside: Outside) -> None:
    """Have the operator drive; return while the robot moves steadily."""
    box.run("systemctl start box-operator")
    try:
        outside.wait_steady(STEADY_MPS, STEADY_S, DRIVES_S)
    except TimeoutError:
        raise AssertionError(box.run("journalctl -b -u box-operator -u cruiser-gateway | tail -60")) from None


def check_stays(outside: Outside, since_s: float, seconds: float = STAYS_S) -> None:
    """Nothing has moved since then, nothing asked for motion, and nothing does for some seconds more."""
    time.sleep(max(0.0, since_s + seconds - time.monotonic()))
    assert not outside.moves_since(since_s)
    assert not outside.drives_since(since_s)


def check_latched(box: Box) -> None:
    """A gateway that came after a stop waits for somebody's reset, and ``cruiser why`` says for what."""
    said = box.run("cruiser why cruiser-1", check=False)
    say("cruiser why", " | ".join(said.split("\n")[:4]))
    assert "cruiser reset" in said, said


def check_log(box: Box, last: Life, lost_s: float = LOST_S) -> None:
    """The log of before is whole, and lacks no more than its last moments.

    Args:
        box: up again.
        last: the guest's last sign of life before the power went, or a sign of a moment that shall be covered.
        lost_s: at most this much of the log may be missing before it.
    """
    box.run(
        f"for i in $(seq {RECOVERED_S}); do "
        "journalctl -b -u cruiser-recorder | grep -q 'is whole now' && exit 0; sleep 1; done; exit 1"
    )
    logs = box.fetch("/var/lib/cruiser/logs")
    whole = [path for path in logs.rglob(f"*{SUFFIX}") if not path.name.endswith(INCIDENT_SUFFIX + SUFFIX)]
    times_ns = [message[2] for path in whole for message in Read(path).messages]
    missing_s = (last.wall_ns - max(time_ns for time_ns in times_ns if time_ns <= last.wall_ns)) / 1e9
    say(
        "log",
        f"{len(whole)} whole, {len(times_ns)} messages; missing before the last sign of life: {missing_s:.2f} s",
    )
    assert missing_s < lost_s


def say(what: str, text: str) -> None:
    """A figure, into the file of results."""
    with Path(os.environ["ROBOT_FIGURES"]).open("a", encoding="utf-8") as figures:
        figures.write(f"{what}: {text}\n")
