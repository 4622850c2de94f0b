"""Inside the box: ask desk and exporter until both answer for the robot, as a browser and Prometheus would.

    python fleet_inside.py [LOGS]

With LOGS, a log of the robot is downloaded from the desk, and its report made. Prints what was seen.
"""

import json
import sys
import time
import urllib.request
from collections.abc import Callable
from typing import Final

from websockets.sync.client import connect
from websockets.typing import Origin

ROBOT: Final = "cruiser-1"
DESK: Final = "127.0.0.1:8080"
EXPORTER: Final = "http://127.0.0.1:9747/metrics"
ANSWERS_S: Final = 90.0


def get(address: str) -> bytes:
    with urllib.request.urlopen(address, timeout=60) as answer:  # noqa: S310 - the addresses above
        content: bytes = answer.read()
    return content


def page() -> str:
    return "page" if b"<html" in get(f"http://{DESK}/") else ""


def robot_on_desk() -> str:
    with connect(f"ws://{DESK}/link", origin=Origin(f"http://{DESK}"), open_timeout=10) as link:
        end_s = time.monotonic() + 5
        while time.monotonic() < end_s:
            said = link.recv(timeout=5)
            if ROBOT.encode() in (said if isinstance(said, bytes) else said.encode()):
                return "robot on the desk"
    return ""


def metrics() -> str:
    wanted = f'cruiser_up{{robot="{ROBOT}"}} 1.0'
    return wanted if wanted in get(EXPORTER).decode() else ""


def log() -> str:
    """Download a finished log and its report from the desk."""
    # The package has no library that reads catalogs: its desk lists the names of all logs.
    head = json.loads(get(f"http://{DESK}/find?search=logs").splitlines()[0])
    for name in head["uncataloged"]:
        if name.endswith(".part"):
            continue
        content, report = get(f"http://{DESK}/logs/{name}"), get(f"http://{DESK}/reports/{name}")
        if content.startswith(b"\x89MCAP") and b"uPlot" in report:
            return f"log of {len(content)} bytes, report of {len(report)}"
    return ""


def wait(question: Callable[[], str], end_s: float) -> str:
    """Repeat a question until it is answered. Returns the answer, or "no" and the reason."""
    while True:
        try:
            said = question()
            fault = "no answer that was asked for"
        except (OSError, TimeoutError, ValueError) as error:
            said, fault = "", f"{error!r} {error.read()[:300]!r}" if hasattr(error, "read") else repr(error)
        if said or time.monotonic() > end_s:
            return said or f"no {question.__name__}: {fault}"
        time.sleep(1)


def main() -> int:
    questions = [page, robot_on_desk, metrics, *([log] if "LOGS" in sys.argv else [])]
    end_s = time.monotonic() + ANSWERS_S
    answers = [wait(question, end_s) for question in questions]
    sys.stdout.write("; ".join(answers) + "\n")
    return int(any(answer.startswith("no ") for answer in answers))


if __name__ == "__main__":
    sys.exit(main())
