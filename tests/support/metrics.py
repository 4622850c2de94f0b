"""What ``cruiser metrics`` serves of made-up messages, and what rules and dashboard ask of it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
from prometheus_client import CollectorRegistry, Metric, generate_latest
from prometheus_client.registry import Collector

from gateway.metrics import FleetMetrics
from gateway.telemetry.samples import Received, TokenChange
from schemas import codec, keys
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.recording import RecorderHealth
from schemas.subjects import BY_TYPE
from tests.support.messages import HEALTH, ROBOT, ROOT, STANDBY, STATE, recorder_health

DEPLOY: Final = Path(__file__).parents[2] / "deploy"
RULES: Final = DEPLOY / "prometheus" / "cruiser.rules.yml"
DASHBOARD: Final = DEPLOY / "grafana" / "cruiser.json"

ENDS_NS: Final = 1_800_000_000_500_000_000
# A message of each kind that has all its values.
FULL: Final[tuple[Message, ...]] = (
    msgspec.structs.replace(
        HEALTH,
        faults={"checksum": 2},
        unknown_identifiers={"0x123": 3},
        certificate_ends_ns=ENDS_NS,
        grant_ends_ns=ENDS_NS,
    ),
    msgspec.structs.replace(
        STANDBY,
        latched=[Reason.REMOTE_STOP, Reason.GUARD],
        blocked_by=[Reason.REMOTE_STOP],
        link_age_s=0.02,
        link_age_last_s=0.03,
        link_age_p50_s=0.02,
        link_age_p99_s=0.04,
        travel_speed_limit_mps=3.0,
    ),
    STATE,
    msgspec.structs.replace(recorder_health(), dropped={"disk": 4}),
)
START_NS: Final = 10**12
WALL_S: Final = 1_700_000_000.0


def received(message: Message, name: str = "", encoding: str = "") -> Received:
    subject = BY_TYPE[type(message)]
    if isinstance(message, RecorderHealth):
        key = keys.of_recorder(ROOT, name or "depot", subject.name)
    else:
        key = keys.build(ROOT, name or ROBOT, subject)
    return Received(key, encoding or subject.encoding, codec.encode(message))


def token(robot: str = ROBOT, *, present: bool = True) -> TokenChange:
    return TokenChange(keys.liveliness(ROOT, robot), present)


def fleet(*heard: Received | TokenChange, now_ns: int = START_NS) -> FleetMetrics:
    metrics = FleetMetrics(ROOT, "1.2.3", certificate_ends_s=1_800_000_000)
    metrics.linked = True
    for one in heard:
        metrics.receive(one, now_ns, WALL_S)
    return metrics


def exposition(metrics: FleetMetrics, now_ns: int = START_NS) -> str:
    class Served(Collector):
        def collect(self) -> Iterator[Metric]:
            return metrics.families(now_ns)

    registry = CollectorRegistry()
    registry.register(Served())
    return generate_latest(registry).decode()


def series(metrics: FleetMetrics, now_ns: int = START_NS) -> dict[str, float]:
    """The values by name and labels."""
    lines = (line for line in exposition(metrics, now_ns).splitlines() if not line.startswith("#"))
    return {name: float(value) for name, _, value in (line.rpartition(" ") for line in lines)}


def full_exposition() -> str:
    """A robot and a recorder with every value, and a silent robot."""
    return exposition(fleet(token("silent"), token(), *map(received, FULL)))


def queries() -> list[str]:
    found: list[str] = []

    def visit(part: Any) -> None:  # noqa: ANN401 - any part of a JSON file
        if isinstance(part, dict):
            found.extend(value for key, value in part.items() if key == "expr")
        for inner in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
            visit(inner)

    visit(json.loads(DASHBOARD.read_text("utf-8")))
    return [
        text.replace("$__rate_interval", "1m").replace("$robot", ".*").replace("$recorder", ".*") for text in found
    ]


def names_in(text: str) -> set[str]:
    return set(re.findall(r"\bcruiser_\w+", text))
