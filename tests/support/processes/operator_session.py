"""An operator's program as a process: drives at 0.6 m/s, and hangs on SIGUSR1.

Usage: python -m tests.support.processes.operator_session ENDPOINT OPERATOR
"""

import ctypes
import signal
import sys
import time

import zenoh

from gateway.client.robot import Robot
from schemas.settings import Settings, ZenohSettings
from schemas.zenoh_session import open_session
from tests.support.processes.holding import hold

HANG = signal.SIGUSR1
HANG_S = 600
SPEED_MPS = 0.6


def token_key(operator: str) -> str:
    return f"operators/{operator}"


def main(endpoint: str, operator: str) -> None:
    """Drive for ever. Prints ``driving`` once the robot does."""
    settings = Settings(zenoh=ZenohSettings(connect=[endpoint]))
    # The whole program stands, and its stream with it; Zenoh's own threads live, and so do link and token.
    signal.signal(HANG, lambda _number, _frame: ctypes.PyDLL(None).sleep(HANG_S))
    session = open_session(ZenohSettings(mode="client"), [endpoint], [])
    token = session.liveliness().declare_token(token_key(operator))
    with Robot.connect("cruiser-1", operator, settings, 30) as robot, robot.lease() as lease:
        is_told = False
        while isinstance(token, zenoh.LivelinessToken):
            hold(robot, lease, SPEED_MPS)
            if not is_told and robot.wait_for(lambda state: state.output_speed_mps >= SPEED_MPS, 0):
                is_told = True
                sys.stdout.write("driving\n")
                sys.stdout.flush()
            time.sleep(0.02)


if __name__ == "__main__":
    main(*sys.argv[1:])
