"""The oracle of access by role: who may do what on which key, by the table of docs/authority.md."""

from __future__ import annotations

from typing import Final

from gateway.authority.enrolment import TransportRole

ROBOT, OTHER, OPERATOR, VIEWER, RECORDER, DESK = "robot", "other", "operator", "viewer", "recorder", "desk"
NOTHING: Final = "nothing"
ROLES: Final = {
    ROBOT: TransportRole.ROBOT,
    OTHER: TransportRole.ROBOT,
    OPERATOR: TransportRole.OPERATOR,
    VIEWER: TransportRole.VIEWER,
    RECORDER: TransportRole.RECORDER,
    DESK: TransportRole.DESK,
    NOTHING: TransportRole.NOTHING,
}
PEOPLE: Final = {OPERATOR, VIEWER, DESK}
COMMANDING: Final = {OPERATOR, DESK}
ROBOTS: Final = {ROBOT, OTHER}
NOBODY: Final[set[str]] = set()

R: Final = "fleet/cruiser-1"
TELEMETRY: Final = (
    "state",
    "chassis/gear",
    "can/can0/rx",
    "safety/state",
    "safety/decision",
    "journal",
    "authority/statement",
    "gateway/health",
)
KEPT: Final = ("journal", "safety/decision", "gateway/info", "safety/event/@adv/pub/1/2/_")
VERB: Final = f"{R}/@cmd/ann/acquire"
DRIVE: Final = f"{R}/@cmd/ann/drive"
STOP: Final = f"{R}/@cmd/ann/stop"
STOP_ALL: Final = "fleet/*/@cmd/ann/stop"
# All robots with such a name: Zenoh's rules cannot tell a pattern from the names in it.
STOP_MANY: Final = "fleet/c$*/@cmd/ann/stop"
ORDER: Final = "fleet/@recorder/depot/@cmd/ann/mark"

# A robot's certificate says that it is a robot, not which: forged telemetry of another shows in the signed chains.
# Who may put on which key; ``PUTS_REACHED`` are those that a robot subscribes to.
PUTS: Final = {f"{R}/{name}": ROBOTS for name in TELEMETRY} | {
    DRIVE: COMMANDING,
    VERB: NOBODY,
    f"{R}/@cmd/ann/engage": NOBODY,
    f"{R}/@cmd/*/*": NOBODY,
    f"{R}/@cmd/ann/*": NOBODY,
    f"{R}/@cmd/**": NOBODY,
    f"{R}/@cmd/ann/stop/further": NOBODY,
    f"{R}/@auth": NOBODY,
    "fleet/*/state": ROBOTS,
    "fleet/**": NOBODY,
    "fleet/cruiser-1": NOBODY,
    f"{R}/other": NOBODY,
    "other/cruiser-1/state": NOBODY,
    f"{R}/gateway": NOBODY,
    "fleet/@recorder/depot/health": {RECORDER},
    ORDER: NOBODY,
    STOP: PEOPLE,
    STOP_ALL: COMMANDING,
    STOP_MANY: PEOPLE,
}
PUTS_REACHED: Final = {DRIVE, STOP, STOP_ALL, STOP_MANY}

# Whose query on which key reaches the robot, and is answered.
QUERIES: Final = {f"{R}/{name}": PEOPLE | {RECORDER} for name in KEPT} | {
    "fleet/*/gateway/info": PEOPLE | {RECORDER, OTHER},
    f"{R}/gateway/info": PEOPLE | {RECORDER, OTHER},
    VERB: COMMANDING,
    f"{R}/@cmd/ann/reset": COMMANDING,
    f"{R}/@cmd/*/*": NOBODY,
    f"{R}/@cmd/**": NOBODY,
    f"{R}/**": NOBODY,
    "fleet/**": NOBODY,
    "fleet/*/@cmd/ann/acquire": NOBODY,
    DRIVE: NOBODY,
    STOP: PEOPLE,
    STOP_ALL: COMMANDING,
    STOP_MANY: PEOPLE,
    f"{R}/@auth": PEOPLE,
    "fleet/*/@auth": PEOPLE,
}
# Who receives anything under which subscription.
SUBSCRIPTIONS: Final = {f"fleet/*/{name}": PEOPLE | {RECORDER} for name in TELEMETRY} | {
    f"{R}/chassis/*": PEOPLE | {RECORDER},
    "fleet/**": {RECORDER},
    f"{R}/**": {RECORDER},
    "**": NOBODY,
    f"{R}/@cmd/*/*": ROBOTS,
    f"{R}/@cmd/**": NOBODY,
    "fleet/*/@cmd/*/*": ROBOTS,
    "fleet/@recorder/*/health": PEOPLE | {RECORDER},
}
# Whose replies on which key reach an operator.
IMPOSTORS: Final = {
    f"{R}/gateway/info": ROBOTS,
    VERB: ROBOTS,
    f"{R}/@cmd/*/*": ROBOTS,
    f"{R}/@auth": ROBOTS,
    ORDER: {RECORDER},
}
# Whose liveliness tokens are seen.
TOKENS: Final = {
    "fleet/ghost/gateway": ROBOTS,
    "fleet/ghost/safety/event/@adv/pub/1/2/_": ROBOTS,
    "fleet/@recorder/ghost": {RECORDER},
    "fleet/ghost": NOBODY,
    "operators/ghost": NOBODY,
}
