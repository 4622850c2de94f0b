"""``cruiser metrics``: what a fleet says of itself, for Prometheus. It commands nothing."""

from __future__ import annotations

import argparse
import ipaddress
import logging
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Final

from gateway.provisioning.tls_files import certificate_ends_s, check_tls_files
from gateway.zenoh.client import FleetListener, place
from schemas.arguments import add_zenoh_arguments, ending_after, seconds
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings

log = logging.getLogger(__name__)

EXAMPLE: Final = """\
  cruiser metrics --connect tcp/10.0.0.5:7447
  cruiser metrics --config ~/.config/cruiser/viewer.toml
  curl http://127.0.0.1:9747/metrics"""

LISTEN: Final = ("127.0.0.1", 9747)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "--listen",
        type=_address,
        default=LISTEN,
        metavar="ADDRESS:PORT",
        help=f"where Prometheus asks ({LISTEN[0]}:{LISTEN[1]}: this machine alone); port 0 is a free one",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="end after this time")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Serve the metrics until it is stopped.

    Raises:
        CommandError: a package is missing, the address is taken, a certificate is wrong, or no Zenoh node answers.
    """
    try:
        from gateway.cli.metrics_server import MetricsServer  # noqa: PLC0415 - needs the extra 'metrics'
        from gateway.metrics.fleet_metrics import FleetMetrics  # noqa: PLC0415 - the same
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "prometheus_client":
            raise
        raise CommandError("this needs prometheus_client: pip install 'cruiser-gateway[metrics]'") from None
    if settings.zenoh.config:
        file = Path(settings.zenoh.config)
        warning = check_tls_files(file, file.stem, time.time())
        if warning:
            log.warning("%s", warning)
    metrics = FleetMetrics(settings.robot.root, version("cruiser-gateway"), certificate_ends_s(settings.zenoh))
    with MetricsServer(metrics, *arguments.listen) as server, FleetListener.open(settings) as listener:
        sys.stderr.write(f"metrics: {server.where}, robots at {place(settings.zenoh)}\n")
        sys.stderr.flush()
        server.follow(listener, ending_after(stopped, arguments.seconds, time.monotonic))
    return int(ExitCode.OK)


def _address(text: str) -> tuple[str, int]:
    """An address on the command line.

    Raises:
        argparse.ArgumentTypeError: it is not an IP address and a port.
    """
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    try:
        ipaddress.ip_address(host)
        number = int(port)
    except ValueError:
        number = -1
    if not 0 <= number < 1 << 16:
        raise argparse.ArgumentTypeError(f"{text!a} is not an address and a port, such as 0.0.0.0:9747")
    return host, number
