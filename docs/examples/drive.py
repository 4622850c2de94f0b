# SPDX-License-Identifier: Apache-2.0
"""Drive half a metre a second for four seconds, and stop. For a robot, or `cruiser sim` and `cruiser gateway`."""

import sys
import time

from gateway import CommandError, Robot

try:
    with Robot.connect("cruiser-1") as robot, robot.lease() as lease:
        lease.engage(speed_limit_mps=0.5)
        lease.unpark()
        for _ in range(40):
            lease.drive(0.5, angle_deg=5.0)  # holds for 0.5 s unless it is renewed
            time.sleep(0.1)
        lease.disengage()
except CommandError as error:  # refused, stopped, lost its lease, or unreachable
    sys.exit(str(error))  # why, and what would cure it
