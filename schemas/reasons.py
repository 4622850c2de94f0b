"""The one enumeration of reasons: why a request was refused, why the robot was stopped, why it stands still."""

from __future__ import annotations

from collections.abc import Collection
from enum import Enum
from typing import Final

import msgspec


class Reason(Enum):
    """Why. What each means and what would cure it: docs/commands.md. ``none`` where all is well."""

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
        means: what it is.
        cure: what would cure it. What it quotes is a command; ROBOT in it stands for the robot's name: see
            ``cure_of``.
    """

    means: str
    cure: str


_BOTH: Final = "; with both pressed, free the robot by hand or with the remote control"
ACQUIRE: Final = "acquire it with 'cruiser drive ROBOT', or with 'cruiser lease ROBOT --hold'"
"""The cure where nobody holds the lease, on the command line."""

ENGAGE: Final = "engage with 'cruiser drive ROBOT' (driving: key g)"
"""The cure where the robot is not engaged, on the command line."""

RESET: Final = "reset with 'cruiser reset ROBOT' (driving: key r), then "
"""With this the cure of a latch begins, or goes on; what stands before it comes first."""

_RESET: Final = f"clear the cause, then {RESET}{ENGAGE}"


class _Texts(dict[Reason, Text]):
    """Texts of reasons; a reason of a newer version has the word alone."""

    def __missing__(self, reason: Reason) -> Text:
        return Text(f"{reason.value}, which this version does not know", "upgrade this side")


_KNOWN_TEXTS: Final[dict[Reason, Text]] = {
    Reason.NONE: Text("nothing is wrong", ""),
    Reason.MALFORMED: Text(
        "the request is not what its schema says",
        "send the fields that the schema names; a newer client may need a newer gateway",
    ),
    Reason.TOO_LARGE: Text(
        "the request is larger than any request can be", "send the fields that the schema names"
    ),
    Reason.UNKNOWN_VERB: Text(
        "there is no such verb, or it is not asked for in this way", "see the command table in docs/commands.md"
    ),
    Reason.BUSY: Text("the same is under way already, or too many ask at once", "wait a moment, and try again"),
    Reason.NO_LEASE: Text("this lease is not in force", f"{ACQUIRE}, and use the number that it shows"),
    Reason.LEASE_HELD: Text(
        "someone else holds the lease",
        "wait until it is given back, or take it with 'cruiser lease ROBOT --take' once the robot stands",
    ),
    Reason.ROLE_TOO_LOW: Text(
        "the holder's role is higher",
        "ask the holder, or take it in a higher role: 'cruiser lease ROBOT --take --role supervisor'",
    ),
    Reason.LEASE_TAKEN: Text(
        "someone else has taken the lease",
        "ask who has it now, as 'cruiser lease ROBOT' says, or take it back with 'cruiser lease ROBOT --take' "
        "once the robot stands",
    ),
    Reason.LEASE_RELEASED: Text("the lease was given back", ACQUIRE),
    Reason.LEASE_EXPIRED: Text(
        "the lease was not renewed in time", f"{ACQUIRE}, which renew it; a client of its own has to"
    ),
    Reason.SEQUENCE: Text(
        "the sequence number does not rise, or by too much",
        "let seq rise by 1 with each drive command of a lease, from 0 or 1 on",
    ),
    Reason.CHALLENGE_UNKNOWN: Text(
        "the echoed challenge was not published lately, so the command's age is not known",
        "echo the newest challenge of safety/state",
    ),
    Reason.TOO_OLD: Text("the command is too old", "echo the newest challenge of safety/state; mend the link"),
    Reason.DEADMAN: Text(
        "no acceptable drive command came in time",
        f"keep the stream of drive commands without a pause, then {ENGAGE}",
    ),
    Reason.NOT_ENGAGED: Text("the robot is not engaged", ENGAGE),
    Reason.ENGAGING: Text("the robot is being engaged", "wait until 'cruiser watch ROBOT' shows engaged"),
    Reason.ALREADY_ENGAGED: Text(
        "the robot is engaged already", "drive it, or leave 'cruiser drive' first (lease.disengage())"
    ),
    Reason.STOPPING: Text("the stop sequence is under way", "wait until it has ended"),
    Reason.MOVING: Text(
        "the robot moves",
        "wait until it stands; 'cruiser stop ROBOT' stops it; 'cruiser lease ROBOT --take --override' takes its "
        "lease all the same",
    ),
    Reason.PARKED: Text(
        "the parking brake is applied",
        "allow drive commands to release it: 'cruiser unpark ROBOT --lease N', or lease.unpark()",
    ),
    Reason.GEAR_SHIFTING: Text("the gear is being changed, or the parking brake released", "wait"),
    Reason.COMMAND_NOT_ZERO: Text("the drive command is not zero", "let go of the keys, or lease.drive(0.0)"),
    Reason.NOT_CONFIRMED: Text("the chassis did not confirm it in time", "look at the chassis and its feedback"),
    Reason.DISENGAGED: Text("the holder of the lease disengaged", ENGAGE),
    Reason.BUS_DOWN: Text("the CAN bus is not there", "see 'cruiser list' for why (gateway/health)"),
    Reason.BUS_OFF: Text(
        "the CAN controller has left the bus after too many errors",
        "look at cables, termination and bit rate; with restart-ms the interface comes back by itself",
    ),
    Reason.BUS_ERRORS: Text(
        "the error state of the CAN controller has changed", "look at cables, termination and bit rate"
    ),
    Reason.FEEDBACK_MISSING: Text(
        "feedback of the chassis is missing",
        "look at the chassis's power and the CAN cable; 'cruiser watch ROBOT' shows which frames are silent now",
    ),
    Reason.FEEDBACK_FAULTY: Text(
        "feedback of the chassis fails its checksum or counter",
        "see 'cruiser list --json' for which frames (gateway/health); look at cables and termination",
    ),
    Reason.FEEDBACK_LATE: Text(
        "frames come faster than the gateway can read them, so what it sees is old",
        "look for a node that floods the bus, and at the processor's load",
    ),
    Reason.VARIANT_UNKNOWN: Text(
        "the firmware variant, and with it the scale of speeds, is not known",
        "let the robot stand still with its feedback on the bus; where it does, chassis.variant is set wrong",
    ),
    # The remote control (RC), by its old name: this stands in events, which a journal run again gives by the byte.
    Reason.HAND_TRANSMITTER: Text(
        "the hand transmitter has the robot", f"switch the remote control's SA to command control, then {ENGAGE}"
    ),
    Reason.MODE_NOT_AUTO: Text(
        "the chassis does not read auto", f"look at the robot's button and at the remote control, then {ENGAGE}"
    ),
    Reason.FRONT_BUMPER: Text(
        "the front bumper was hit", f"{RESET}drive backward ('cruiser drive ROBOT') until it is clear{_BOTH}"
    ),
    Reason.REAR_BUMPER: Text(
        "the rear bumper was hit", f"{RESET}drive forward ('cruiser drive ROBOT') until it is clear{_BOTH}"
    ),
    Reason.IMPLAUSIBLE_SPEED: Text(
        "the speeds do not fit each other or the command",
        f"look at the wheels, and at chassis.variant, which may be set wrong; then {RESET}{ENGAGE}",
    ),
    Reason.FOUND_MOVING: Text(
        "the chassis was found moving, or not held, and nobody commanded it",
        f"look for what moved it, and at its parking brake, then {ENGAGE}",
    ),
    Reason.OTHER_COMMANDER: Text(
        "another computer commands the chassis on the bus", f"end the other one, then {ENGAGE}"
    ),
    Reason.REMOTE_STOP: Text("a remote stop was received", f"{RESET}{ENGAGE}"),
    Reason.LOOP_LATE: Text("the gateway's loop was late", f"look at the processor's load, then {ENGAGE}"),
    Reason.SEND_FAILED: Text(
        "the bus does not take our frames", f"look at cables, termination and the bus's load, then {ENGAGE}"
    ),
    Reason.GATE: Text("the last gate before the bus refused a frame: a fault of the gateway's own", _RESET),
    Reason.GUARD: Text("the guard has stopped the robot in place of the gateway", _RESET),
    Reason.UNGUARDED: Text(
        "no guard watches the gateway, not yet or not on this interface",
        "wait a second; else use an interface that several processes can open, or accept it with "
        "gateway.accept_unguarded",
    ),
    Reason.SHUTDOWN: Text("the gateway is ending", "wait until it is back"),
    Reason.LINK_TOO_SLOW: Text(
        "the link is too slow to drive over", "echo the newest challenge of safety/state, over a faster link"
    ),
    Reason.NO_REALTIME: Text(
        "the gateway has no real-time priority: a busy processor can delay it until the guard stops the robot, so "
        "its speed limit is lower",
        "run it as deploy/cruiser-gateway.service does (LimitRTPRIO=20), or allow it in /etc/security/limits.conf "
        "(USER - rtprio 20), with gateway.realtime_priority above 0",
    ),
    Reason.ROLLING: Text(
        "the robot moves although it is told to stand, or against what it is told: the parking brake is applied",
        f"look for a slope that is too steep, a weak motor, or somebody who pushes; then {RESET}{ENGAGE}",
    ),
    Reason.OVERSPEED: Text("the robot is faster than the limit in force", _RESET),
    Reason.STEERING: Text("the steering does not follow what it is told", _RESET),
    Reason.FEEDBACK_FROZEN: Text(
        "feedback of the chassis stands still while other feedback or the command shows that the robot moves",
        _RESET,
    ),
    Reason.UNAUTHENTICATED: Text(
        "the gateway can be reached from other machines, and does not know who commands it",
        "give it keys with 'cruiser provision robot ROBOT', and set authority.mode to signed; or let it listen "
        "on and connect to 127.0.0.1 alone",
    ),
    Reason.SELF_TEST: Text(
        "the gateway's own keys or its own access control are not in order",
        "see to what 'cruiser why ROBOT' names; the gateway reads its files again once they were replaced",
    ),
    Reason.AUTHORITY_STALE: Text(
        "nothing was heard from the authority for too long, so what was revoked meanwhile is not known",
        "bring the robot to this version, which waits for no word of the authority",
    ),
    Reason.PROOF_MISSING: Text(
        "the request is not signed", "command it with an operator's key: see docs/authority.md"
    ),
    Reason.PROOF_WRONG: Text(
        "the signature does not fit the request",
        "send it with the key of the grant, to whom it was signed for, as it was signed: see docs/authority.md",
    ),
    Reason.REPLAYED: Text("the same was received before", "sign each request anew"),
    Reason.GRANT_UNKNOWN: Text(
        "the grant, or its authority, is not known there", "show it the grant with its chain (query @auth)"
    ),
    Reason.GRANT_EXPIRED: Text("the grant is over, or has not begun", "get a new grant from the authority"),
    Reason.GRANT_REVOKED: Text("the grant was revoked", "ask the fleet's authority"),
    Reason.NOT_GRANTED: Text("the grant does not allow it", "get a grant that does"),
    Reason.STOPPED_BY_OTHER: Text(
        "somebody else has stopped the robot, and may stand before it",
        "ask them; then say whose stop is cleared: 'cruiser reset ROBOT --of NAME', or lease.reset(of=NAME)",
    ),
    Reason.IDLE: Text("nobody has driven the robot for so long that it was disengaged", ENGAGE),
    Reason.NOT_MOVING: Text(
        "the robot is commanded to move, and is seen to stand",
        f"look for what blocks it, and whether it moves although its speed reads zero; then {RESET}{ENGAGE}",
    ),
    Reason.BRAKE_SLIPS: Text(
        "the parking brake reads applied and does not hold the robot: the motor alone holds it",
        "chock its wheels, or drive it to level ground with the remote control; "
        f"once it has stood braked for 5 s, {RESET}mend the brake before the next slope",
    ),
}

TEXTS: Final[dict[Reason, Text]] = _Texts(_KNOWN_TEXTS)  # every reason in words; a test holds that none is missing

_RENEW_ROBOT: Final = "'cruiser provision renew robot' on the robot, 'sign' at the authority, 'install --replace'"
_RENEW_NEW: Final = _RENEW_ROBOT.replace("--replace'", "--replace --fingerprint F'")

OF_A_ROBOT: Final[dict[Reason, Text]] = _Texts(
    {
        **_KNOWN_TEXTS,
        Reason.NO_LEASE: Text("nobody holds the lease", ACQUIRE),
        Reason.GRANT_EXPIRED: Text(
            "the robot's own grant is over, or has not begun",
            f"set its clock if it is wrong; if not: {_RENEW_ROBOT}",
        ),
        Reason.GRANT_REVOKED: Text(
            "the robot's own grant was revoked", f"if its authority was replaced: {_RENEW_NEW}; else ask there"
        ),
        Reason.GRANT_UNKNOWN: Text(
            "the robot's own grant is not of the authority that it knows", f"let it in anew: {_RENEW_NEW}"
        ),
    }
)
"""The same where a reason is said of a robot, not of a request."""

AS_ASKED: Final = frozenset({Reason.DISENGAGED, Reason.IDLE, Reason.LEASE_RELEASED, Reason.SHUTDOWN})
"""Ends that the driver, or who runs the gateway, asked for or left to happen: nothing is wrong, at any speed."""

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
"""Reasons whose operator did it; with every other the operator is whom it befell."""

NO_STOP: Final = frozenset({Reason.HAND_TRANSMITTER, Reason.BUS_DOWN})
"""While one of these holds, a remote stop cannot be carried out."""


def of_a_robot(reason: Reason, beside: Collection[Reason]) -> Text:
    """A reason for which a robot stands still, beside others: what these forbid is no cure."""
    if reason is Reason.MOVING and not NO_STOP.isdisjoint(beside):
        drives = (
            "; the remote control drives it: let go of its sticks" if Reason.HAND_TRANSMITTER in beside else ""
        )
        return Text(TEXTS[reason].means, f"wait until it stands{drives}")
    return OF_A_ROBOT[reason]


def cure_of(cure: str, robot: str) -> str:
    """A cure with the robot's name, which may come with its root, in the commands that it quotes."""
    return cure.replace("ROBOT", robot.rpartition("/")[2])
