"""``cruiser gateway`` that writes each tick's lateness and its processor time to a file at the end.

Usage: python -m tests.bench.gateway_probe FILE [flags of cruiser gateway]
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import gateway.cli.gateway as command
from gateway.cli.main import main
from gateway.command.flow import TickEffects
from gateway.core import Core

LATE_NS: list[int] = []
CPU_S: list[float] = []


class ProbedCore(Core):
    def tick(self, now_ns: int, wall_ns: int, late_ns: int, challenge: bytes) -> TickEffects:
        LATE_NS.append(late_ns)
        CPU_S.append(time.process_time())
        return super().tick(now_ns, wall_ns, late_ns, challenge)


if __name__ == "__main__":
    setattr(command, "Core", ProbedCore)  # noqa: B010 - an assignment would be an error of types
    code = main(["gateway", *sys.argv[2:]])
    measured = {"late_ns": LATE_NS, "cpu_s": CPU_S[-1] - CPU_S[0]}
    Path(sys.argv[1]).write_text(json.dumps(measured), encoding="utf-8")
    sys.exit(code)
