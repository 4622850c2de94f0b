"""Reasons why a request was refused, why the robot was stopped, or why it stands still."""

from __future__ import annotations

from collections.abc import Collection
from enum import Enum
from typing import Final

import msgspec


class Reason(Enum):
    """A reason; its meaning and cure are in docs/commands.md. ``none``: nothing is wrong."""

    NONE = "none"

    # The request itself.
    MALFORMED = "malformed"
    TOO_LARGE = "too_large"
    UNKNOWN_VERB = "unknown_verb"
    BUSY = "busy"

    # The lease.
    NO_LEASE = "no_lease"
    LEASE_HELD = "lease_held"
    ROLE_TOO_LOW = "role_too_low"
    LEASE_TAKEN = "lease_taken"
    LEASE_RELEASED = "lease_released"
    LEASE_EXPIRED = "lease_expired"

    # The age of a command.
    SEQUENCE = "sequence"
    CHALLENGE_UNKNOWN = "challenge_unknown"
    TOO_OLD = "too_old"
    DEADMAN = "deadman"

    # What the robot is doing.
    NOT_ENGAGED = "not_engaged"
    ENGAGING = "engaging"
    ALREADY_ENGAGED = "already_engaged"
    STOPPING = "stopping"
    MOVING = "moving"
    PARKED = "parked"
    GEAR_SHIFTING = "gear_shifting"
    COMMAND_NOT_ZERO = "command_not_zero"
    NOT_CONFIRMED = "not_confirmed"
    DISENGAGED = "disengaged"

    # The chassis.
    BUS_DOWN = "bus_down"
    BUS_OFF = "bus_off"
    BUS_ERRORS = "bus_errors"
    FEEDBACK_MISSING = "feedback_missing"
    FEEDBACK_FAULTY = "feedback_faulty"
    FEEDBACK_LATE = "feedback_late"
    VARIANT_UNKNOWN = "variant_unknown"
    HAND_TRANSMITTER = "hand_transmitter"
    MODE_NOT_AUTO = "mode_not_auto"
    FRONT_BUMPER = "front_bumper"
    REAR_BUMPER = "rear_bumper"
    IMPLAUSIBLE_SPEED = "implausible_speed"
    FOUND_MOVING = "found_moving"
    OTHER_COMMANDER = "other_commander"

    # The gateway.
    REMOTE_STOP = "remote_stop"
    LOOP_LATE = "loop_late"
    SEND_FAILED = "send_failed"
    GATE = "gate"
    GUARD = "guard"
    UNGUARDED = "unguarded"
    SHUTDOWN = "shutdown"

    # New ones go to the end: a log holds a reason by its place.
    LINK_TOO_SLOW = "link_too_slow"
    NO_REALTIME = "no_realtime"
    ROLLING = "rolling"
    OVERSPEED = "overspeed"
    STEERING = "steering"
    FEEDBACK_FROZEN = "feedback_frozen"

    # Who may command: see docs/authority.md.
    UNAUTHENTICATED = "unauthenticated"
    SELF_TEST = "self_test"
    AUTHORITY_STALE = "authority_stale"
    PROOF_MISSING = "proof_missing"
    PROOF_WRONG = "proof_wrong"
    REPLAYED = "replayed"
    GRANT_UNKNOWN = "grant_unknown"
    GRANT_EXPIRED = "grant_expired"
    GRANT_REVOKED = "grant_revoked"
    NOT_GRANTED = "not_granted"

    STOPPED_BY_OTHER = "stopped_by_other"
    IDLE = "idle"
    NOT_MOVING = "not_moving"
    BRAKE_SLIPS = "brake_slips"


class Text(msgspec.Struct, frozen=True):
    """A reason in words.

    Attributes:
        cure: quoted parts are commands, with ROBOT for the robot's name: see ``cure_of``.
    """

    means: str
    cure: str


_BOTH: Final = "; with both pressed, free the robot by hand or with the remote control"
ACQUIRE: Final = "acquire it with 'cruiser drive ROBOT', or with 'cruiser lease ROBOT --hold'"
"""The cure for a missing lease."""

ENGAGE: Final = "engage with 'cruiser drive ROBOT' (driving: key g)"
"""The cure for a robot that is not engaged."""

RESET: Final = "reset with 'cruiser reset ROBOT' (driving: key r), then "
"""Part of the cure of every latch; the text before it comes first."""

_RESET: Final = f"clear the cause, then {RESET}{ENGAGE}"


class _Texts(dict[Reason, Text]):
    """Texts by reason; a reason of a newer version has only its name."""

    def __missing__(self, reason: Reason) -> Text:
        return Text(f"{reason.value}, which this version does not know", "upgrade this side")


_KNOWN_TEXTS: Final[dict[Reason, Text]] = {
    Reason.NONE: Text("nothing is wrong", ""),
    Reason.MALFORMED: Text(
        "the request does not match its schema",
        "send the fields that the schema names; a newer client may need a newer gateway",
    ),
    Reason.TOO_LARGE: Text("the request is too large", "send the fields that the schema names"),
    Reason.UNKNOWN_VERB: Text(
        "there is no such verb, or it was sent in the wrong way (query or put)",
        "see the command table in docs/commands.md",
    ),
    Reason.BUSY: Text(
        "the same request is already in progress, or there are too many at once", "wait a moment, then try again"
    ),
    Reason.NO_LEASE: Text("the lease number is not valid", f"{ACQUIRE}, and use the number that it shows"),
    Reason.LEASE_HELD: Text(
        "someone else holds the lease",
        "wait until it is released, or take it with 'cruiser lease ROBOT --take' once the robot stands",
    ),
    Reason.ROLE_TOO_LOW: Text(
        "the holder's role is higher",
        "ask the holder, or take it in a higher role: 'cruiser lease ROBOT --take --role supervisor'",
    ),
    Reason.LEASE_TAKEN: Text(
        "someone else has taken the lease",
        "see who holds it with 'cruiser lease ROBOT'; take it back with 'cruiser lease ROBOT --take' "
        "once the robot stands",
    ),
    Reason.LEASE_RELEASED: Text("the lease was released", ACQUIRE),
    Reason.LEASE_EXPIRED: Text(
        "the lease was not renewed in time", f"{ACQUIRE}; these renew it, your own client has to do so itself"
    ),
    Reason.SEQUENCE: Text(
        "the sequence number did not increase, or increased by too much",
        "increase seq by 1 with each drive command of a lease, starting at 0 or 1",
    ),
    Reason.CHALLENGE_UNKNOWN: Text(
        "the echoed challenge was not published recently, so the age of the command is unknown",
        "echo the newest challenge of safety/state",
    ),
    Reason.TOO_OLD: Text("the command is too old", "echo the newest challenge of safety/state; improve the link"),
    Reason.DEADMAN: Text(
        "no valid drive command arrived in time",
        f"send drive commands without a pause, then {ENGAGE}",
    ),
    Reason.NOT_ENGAGED: Text("the robot is not engaged", ENGAGE),
    Reason.ENGAGING: Text("the robot is being engaged", "wait until 'cruiser watch ROBOT' shows engaged"),
    Reason.ALREADY_ENGAGED: Text("the robot is already engaged", "drive it, or leave 'cruiser drive' first"),
    Reason.STOPPING: Text("the robot is being stopped", "wait until the stop has ended"),
    Reason.MOVING: Text(
        "the robot moves",
        "wait until it stands; 'cruiser stop ROBOT' stops it; 'cruiser lease ROBOT --take --override' takes the "
        "lease anyway",
    ),
    Reason.PARKED: Text(
        "the parking brake is applied",
        "allow drive commands to release it: 'cruiser unpark ROBOT --lease N'",
    ),
    Reason.GEAR_SHIFTING: Text("the gear is changing, or the parking brake is being released", "wait"),
    Reason.COMMAND_NOT_ZERO: Text("the drive command is not zero", "let go of the keys, or send a speed of zero"),
    Reason.NOT_CONFIRMED: Text(
        "the chassis did not confirm the command in time", "check the chassis and its feedback"
    ),
    Reason.DISENGAGED: Text("the holder of the lease disengaged", ENGAGE),
    Reason.BUS_DOWN: Text("there is no CAN bus", "see why with 'cruiser list' (gateway/health)"),
    Reason.BUS_OFF: Text(
        "the CAN controller has left the bus after too many errors",
        "check cables, termination and bit rate; with restart-ms set, the interface recovers automatically",
    ),
    Reason.BUS_ERRORS: Text(
        "the error state of the CAN controller has changed", "check cables, termination and bit rate"
    ),
    Reason.FEEDBACK_MISSING: Text(
        "feedback from the chassis is missing",
        "check the chassis's power and the CAN cable; 'cruiser watch ROBOT' shows which frames are missing now",
    ),
    Reason.FEEDBACK_FAULTY: Text(
        "feedback from the chassis has a wrong checksum or counter",
        "see which frames with 'cruiser list --json' (gateway/health); check cables and termination",
    ),
    Reason.FEEDBACK_LATE: Text(
        "frames arrive faster than the gateway can read them, so its view of the chassis is outdated",
        "look for a node that floods the bus; check the processor load",
    ),
    Reason.VARIANT_UNKNOWN: Text(
        "the firmware variant, and so the scale of its speeds, is unknown",
        "let the robot stand still with its feedback on the bus; if it already does, chassis.variant is set wrong",
    ),
    Reason.HAND_TRANSMITTER: Text(
        "the remote control has the robot", f"switch the remote control's SA to command control, then {ENGAGE}"
    ),
    Reason.MODE_NOT_AUTO: Text(
        "the chassis is not in mode auto", f"check the robot's stop button and the remote control, then {ENGAGE}"
    ),
    Reason.FRONT_BUMPER: Text(
        "the front bumper was hit", f"{RESET}drive backward ('cruiser drive ROBOT') until it is clear{_BOTH}"
    ),
    Reason.REAR_BUMPER: Text(
        "the rear bumper was hit", f"{RESET}drive forward ('cruiser drive ROBOT') until it is clear{_BOTH}"
    ),
    Reason.IMPLAUSIBLE_SPEED: Text(
        "the measured speeds do not match each other or the command",
        f"check the wheels and the setting chassis.variant; then {RESET}{ENGAGE}",
    ),
    Reason.FOUND_MOVING: Text(
        "uncommanded motion",
        f"find out what moved it and check its parking brake, then {ENGAGE}",
    ),
    Reason.OTHER_COMMANDER: Text(
        "another computer commands the chassis on the bus", f"stop the other computer, then {ENGAGE}"
    ),
    Reason.REMOTE_STOP: Text("a remote stop was received", f"{RESET}{ENGAGE}"),
    Reason.LOOP_LATE: Text("the gateway's loop was late", f"check the processor load, then {ENGAGE}"),
    Reason.SEND_FAILED: Text(
        "the bus does not accept the gateway's frames", f"check cables, termination and bus load, then {ENGAGE}"
    ),
    Reason.GATE: Text("the last check before the bus refused a frame: an internal fault of the gateway", _RESET),
    Reason.GUARD: Text("the guard has stopped the robot in place of the gateway", _RESET),
    Reason.UNGUARDED: Text(
        "no guard watches the gateway: it has not started yet, or cannot use this interface",
        "wait a second; otherwise use an interface that several processes can open, or accept it with "
        "gateway.accept_unguarded",
    ),
    Reason.SHUTDOWN: Text("the gateway is shutting down", "wait until it is back"),
    Reason.LINK_TOO_SLOW: Text(
        "the link is too slow for driving", "use a faster link; echo the newest challenge of safety/state"
    ),
    Reason.NO_REALTIME: Text(
        "the gateway has no real-time priority: a busy processor can delay it until the guard stops the robot, so "
        "its speed limit is lower",
        "run it like deploy/cruiser-gateway.service (LimitRTPRIO=20), or allow it in /etc/security/limits.conf "
        "(USER - rtprio 20), with gateway.realtime_priority above 0",
    ),
    Reason.ROLLING: Text(
        "the robot moves without a command, or against it: the parking brake is applied",
        f"look for a steep slope, a weak motor, or a person pushing the robot; then {RESET}{ENGAGE}",
    ),
    Reason.OVERSPEED: Text("the robot is faster than its speed limit", _RESET),
    Reason.STEERING: Text("the steering does not follow its command", _RESET),
    Reason.FEEDBACK_FROZEN: Text(
        "feedback from the chassis is frozen while other feedback or the command shows that the robot moves",
        _RESET,
    ),
    Reason.UNAUTHENTICATED: Text(
        "the gateway can be reached from other machines, and cannot tell who commands it",
        "give it keys with 'cruiser provision robot ROBOT', and set authority.mode to signed; or let it listen "
        "on and connect to 127.0.0.1 only",
    ),
    Reason.SELF_TEST: Text(
        "the gateway's keys or its access control are wrong",
        "fix what 'cruiser why ROBOT' names; the gateway reads its files again when they are replaced",
    ),
    Reason.AUTHORITY_STALE: Text(
        "no message from the authority for too long, so newer revocations are not known",
        "upgrade the robot: this version does not depend on messages from the authority",
    ),
    Reason.PROOF_MISSING: Text(
        "the request is not signed", "sign it with an operator's key: see docs/authority.md"
    ),
    Reason.PROOF_WRONG: Text(
        "the signature does not match the request",
        "sign it with the grant's key, and send it unchanged to the robot it is for: see docs/authority.md",
    ),
    Reason.REPLAYED: Text("this request was already received", "sign each request separately"),
    Reason.GRANT_UNKNOWN: Text(
        "the robot does not know the grant or its authority", "send it the grant with its chain (query @auth)"
    ),
    Reason.GRANT_EXPIRED: Text("the grant has expired, or is not valid yet", "get a new grant from the authority"),
    Reason.GRANT_REVOKED: Text("the grant was revoked", "ask the fleet's authority why"),
    Reason.NOT_GRANTED: Text("the grant does not allow this", "get a grant that does"),
    Reason.STOPPED_BY_OTHER: Text(
        "another person stopped the robot, and may be standing in front of it",
        "ask them; then name whose stop you clear: 'cruiser reset ROBOT --of NAME'",
    ),
    Reason.IDLE: Text("no drive command with a speed for too long, so the robot was disengaged", ENGAGE),
    Reason.NOT_MOVING: Text(
        "the robot is commanded to move, but stands still",
        f"find out what blocks it, and whether it moves although its speed reads zero; then {RESET}{ENGAGE}",
    ),
    Reason.BRAKE_SLIPS: Text(
        "the parking brake reads applied but does not hold the robot: only the motor holds it",
        "chock the wheels, or drive it to level ground with the remote control; "
        f"once it has stood braked for 5 s, {RESET}repair the brake before the next slope",
    ),
}

TEXTS: Final[dict[Reason, Text]] = _Texts(_KNOWN_TEXTS)  # a test checks that none is missing

_RENEW_ROBOT: Final = "'cruiser provision renew robot' on the robot, 'sign' at the authority, 'install --replace'"
_RENEW_NEW: Final = _RENEW_ROBOT.replace("--replace'", "--replace --fingerprint F'")

OF_A_ROBOT: Final[dict[Reason, Text]] = _Texts(
    {
        **_KNOWN_TEXTS,
        Reason.NO_LEASE: Text("no operator holds the lease", ACQUIRE),
        Reason.GRANT_EXPIRED: Text(
            "the robot's own grant has expired, or is not valid yet",
            f"if its clock is wrong, set it; otherwise: {_RENEW_ROBOT}",
        ),
        Reason.GRANT_REVOKED: Text(
            "the robot's own grant was revoked",
            f"if its authority was replaced: {_RENEW_NEW}; otherwise ask the authority",
        ),
        Reason.GRANT_UNKNOWN: Text(
            "the robot's own grant is from an authority that it does not know", f"provision it again: {_RENEW_NEW}"
        ),
    }
)
"""Texts for a reason that applies to a robot, not to a request."""

AS_ASKED: Final = frozenset({Reason.DISENGAGED, Reason.IDLE, Reason.LEASE_RELEASED, Reason.SHUTDOWN})
"""Normal ends: the driver, or the person who runs the gateway, asked for them or let them happen."""

ASKED_BY: Final = frozenset(
    {
        Reason.DISENGAGED,
        Reason.LEASE_RELEASED,
        Reason.LEASE_TAKEN,
        Reason.REMOTE_STOP,
        Reason.STOPPED_BY_OTHER,
        Reason.HAND_TRANSMITTER,
    }
)
"""Reasons whose operator caused the stop; for every other one the operator was affected by it."""

NO_STOP: Final = frozenset({Reason.HAND_TRANSMITTER, Reason.BUS_DOWN})
"""While one of these holds, a remote stop cannot be carried out."""


def of_a_robot(reason: Reason, beside: Collection[Reason]) -> Text:
    """Text of a reason why a robot stands still, without a cure that the reasons beside it forbid."""
    if reason is Reason.MOVING and not NO_STOP.isdisjoint(beside):
        drives = "; the remote control drives it: release its sticks" if Reason.HAND_TRANSMITTER in beside else ""
        return Text(TEXTS[reason].means, f"wait until it stands{drives}")
    return OF_A_ROBOT[reason]


def cure_of(cure: str, robot: str) -> str:
    """Put the robot's name, given with or without its root, into the commands that a cure quotes."""
    return cure.replace("ROBOT", robot.rpartition("/")[2])
