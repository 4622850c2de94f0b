# SPDX-License-Identifier: Apache-2.0
"""Print what every robot reports, twice a second: Zenoh and MessagePack alone, no code of this project.

Usage: python docs/examples/subscribe.py [ENDPOINT] [KEY]
"""

import os
import sys
import time

import msgpack
import zenoh

ENDPOINT = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
KEY = sys.argv[2] if len(sys.argv) > 2 else "fleet/*/state"
CLIENT = f'{{mode: "client", connect: {{endpoints: ["{ENDPOINT}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
PERIOD_S = 0.5

next_s: dict[str, float] = {}
with zenoh.open(zenoh.Config.from_json5(CLIENT)) as session, session.declare_subscriber(KEY) as samples:
    for sample in samples:
        key, now_s = str(sample.key_expr), time.monotonic()
        if now_s < next_s.get(key, 0.0):
            continue
        next_s[key] = now_s + PERIOD_S
        # A MessagePack map with the units in its names; a value that is not known is None.
        state = msgpack.unpackb(sample.payload.to_bytes())
        fields = ("mode", "gear_position", "speed_mps", "angle_deg", "front_bumper", "rear_bumper")
        try:
            print(key, *(f"{name}={state[name]}" for name in fields), flush=True)
        except BrokenPipeError:
            # Nobody reads on, as behind "| head": what Python still holds goes nowhere.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            break
