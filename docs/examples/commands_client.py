# SPDX-License-Identifier: Apache-2.0
"""Drive half a metre a second for two seconds, by docs/commands.md alone: Zenoh, MessagePack and no code of ours.

Usage: python docs/examples/commands_client.py [ENDPOINT] [ROBOT]. A refusal ends it with what would cure it.
"""

import sys
import time
from typing import Any

import msgpack
import zenoh

ENDPOINT = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
ROBOT = sys.argv[2] if len(sys.argv) > 2 else "fleet/cruiser-1"
CLIENT = f'{{mode: "client", connect: {{endpoints: ["{ENDPOINT}"]}}, scouting: {{multicast: {{enabled: false}}}}}}'
COMMANDS = f"{ROBOT}/@cmd/python-example"
SPEED_MPS = 0.5
DRIVE_S = 2.0


def read(message: Any) -> dict[str, Any]:
    return msgpack.unpackb(message.payload.to_bytes())


def ask(session: zenoh.Session, verb: str, **request: object) -> Any:
    """Send a verb. Returns where its reply will arrive."""
    payload, every = msgpack.packb(request), zenoh.ConsolidationMode.NONE
    return session.get(f"{COMMANDS}/{verb}", payload=payload, timeout=3, consolidation=every)


def agreed(reply: Any) -> dict[str, Any]:
    """The reply to a verb; exits if the robot refused it."""
    answer = read(reply.ok)
    if not answer["ok"]:
        raise SystemExit(f"{answer['detail']}. Cure: {answer['cure']}")
    return answer


with zenoh.open(zenoh.Config.from_json5(CLIENT)) as session:
    states = session.declare_subscriber(f"{ROBOT}/safety/state", zenoh.handlers.RingChannel(1))
    drives = session.declare_publisher(
        f"{COMMANDS}/drive",
        express=True,
        priority=zenoh.Priority.INTERACTIVE_HIGH,
        congestion_control=zenoh.CongestionControl.DROP,
    )
    states.recv()  # the robot is there
    lease = agreed(ask(session, "acquire").recv())["lease"]
    challenge = read(states.recv())["challenge"]
    replies, next_verb = ask(session, "engage", lease=lease, challenge=challenge, deadman_s=0.8), "unpark"
    end_s = None  # not driving yet
    seq = 0
    # 20 to 50 states a second pace the loop. The stream of commands begins before `engage` is replied to.
    while True:
        state = read(states.recv())
        if end_s is None and (reply := replies.try_recv()) and agreed(reply):
            if next_verb:
                replies, next_verb = ask(session, next_verb, lease=lease), ""
            else:
                end_s = time.monotonic() + DRIVE_S
        speed_mps = SPEED_MPS if end_s and time.monotonic() < end_s else 0.0
        drive = {"lease": lease, "seq": seq, "challenge": state["challenge"]}
        drives.put(msgpack.packb(drive | {"speed_mps": speed_mps, "angle_deg": 0.0}))
        seq += 1
        if end_s and not state["engaged"]:
            raise SystemExit(f"stopped: {state['stop_reason']}; {state['stop_detail']}")
        if end_s and not speed_mps and not state["output_speed_mps"]:
            break
    agreed(ask(session, "release", lease=lease).recv())
