"""``cruiser metrics``: a fleet's health for Prometheus. Commands nothing."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Final

from gateway.cli.shut_out import check_session_files
from gateway.provisioning.key_files import certificate_ends_s
from gateway.zenoh.client import FleetListener
from schemas.arguments import add_zenoh_arguments, ending_after, seconds
from schemas.command_line import ExitCode, address, needing_extra
from schemas.settings import Settings
from schemas.zenoh_session import place

EXAMPLE: Final = """\
  cruiser metrics --connect tcp/10.0.0.5:7447
  cruiser metrics --config ~/.config/cruiser/viewer.toml
  curl http://127.0.0.1:9747/metrics"""

LISTEN: Final = ("127.0.0.1", 9747)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--listen",
        type=address,
        default=LISTEN,
        metavar="ADDRESS:PORT",
        help=f"address for Prometheus (default {LISTEN[0]}:{LISTEN[1]}: this machine only); port 0: a free port",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="duration")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    with needing_extra():
        from gateway.cli.metrics_server import MetricsServer  # noqa: PLC0415 - needs the extra 'metrics'
        from gateway.metrics import FleetMetrics  # noqa: PLC0415 - the same
    if settings.zenoh.config:
        check_session_files(Path(settings.zenoh.config))
    metrics = FleetMetrics(settings.robot.root, version("cruiser-gateway"), certificate_ends_s(settings.zenoh))
    with MetricsServer(metrics, *arguments.listen) as server, FleetListener.open(settings) as listener:
        sys.stderr.write(f"metrics: {server.where}, robots at {place(settings.zenoh)}\n")
        sys.stderr.flush()
        server.follow(listener, ending_after(stopped, arguments.seconds, time.monotonic))
    return int(ExitCode.OK)
