"""The journal's entries, and the rules by which they were written.

The inputs in a message of the journal: what the gateway's core was given. See ``schemas.decisions.Journal``.

The versions of the rules by which the arbiter decides.

The same inputs give the same decisions under the same rules alone. A journal names the rules under which it was
made, so that whoever runs it again under others knows that differences are to be expected.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class Kind(IntEnum):
    """The kind of an input of the core: the method that received it."""

    FRAME = 0
    """[can_id, data, wall_ns, fd_flags, remote_length]"""
    REQUEST = 1
    """handle, verb, operator, payload, size, fault; in journals of before without the fault. The payload names the
    lease by its identifier: see ``gateway.command.restart``. In signed mode the payload is as it was
    received, and attachment and credentials follow: see ``gateway.command.rulings``."""
    LINKS = 2
    """Those that ``gateway.journal.LINKS`` names, in its order; only when one of them has changed"""
    TICK = 3
    """wall_ns, late_ns, challenge; under rules 1 without the challenge"""
    SENT = 4
    """count, wall_ns"""
    SHUT_DOWN = 5
    REST = 6
    """[what the arbiter is remembered by], controller, and the links as in LINKS: nothing is given to the core.
    The gateway is at rest, and from here on a run can be run again: see ``gateway.command.restart``."""
    GUARD_STOP = 7
    """words: the guard stopped the robot before this start, and nobody has reset that"""
    WARNING = 8
    """words: what was found at the start and a person should know"""
    END_LEASE = 9
    """reason, words: the grant of who holds the lease does not hold any more"""
    BARS = 10
    """{reason: words}: why nobody may engage the robot, whoever asks; empty again when that is over"""
    CARRIED = 11
    """[latched causes with their details, why the last stop began, its figures, whether a stop is owed, lamps,
    horn]: the gateway has started again by itself, with renewed files: see ``gateway.command.restart``"""
    CHECKPOINT = 12
    """wall_ns, state: nothing is given to the core. All of its state, as MessagePack, once a minute whatever the
    robot does, so that from here on a version of the same state can run it again: see ``gateway.journal``"""
    CRASHED = 13
    """the gateway before this one did not end in order"""


COMMAND_RULES: Final = 7
"""The rules of this version. To be raised, with a row below, by every change that decides something otherwise."""

_UNNUMBERED: Final = 0
"""The number in journals that were made under rules 1, before the rules had numbers."""

CHANGES: Final[dict[int, str]] = {
    2: "a stop ramps down in gear, applies the parking brake and stays in gear while it holds; "
    "the brake pedal is never pressed; "
    "a robot that stands at zero command gets its parking brake after a second, a drive command with a speed "
    "releases it, and the direction is reversed behind it; "
    "park is accepted at any speed; "
    "rolling, overspeed, steering that does not follow and a frozen mileage stop the robot and are latched; "
    "a remote stop that cannot be carried out is refused, latched, and carried out later; "
    "a robot that moves in mode stop is told to park; "
    "a burst that the gate refuses is replaced by zero speed and the parking brake; "
    "a bumper counts as clear after 300 ms; "
    "braking, lamp and horn feedback need not come; "
    "a stop by the guard stays latched across a restart; "
    "drive, engage and reset echo a challenge instead of a tick, so those of before with a tick are refused as "
    "malformed; "
    "commands up to 1 s old are accepted, and the speed is bounded by their age and the deadman; "
    "without real-time priority or a guard the speed limit is lower; "
    "a stop that nobody asked for is told as a warning while the robot moves; "
    "a gateway that is told to end says so; "
    "safety/state comes at 50 Hz while the robot is engaged",
    3: "commands of another computer are an event also while the robot stands by",
    4: "a drive command whose seq is more than 1,000 above the last accepted one is refused; "
    "five wrong checksums in a second stop the robot, three before; "
    "wheel pulses are counted per period, so that a lost frame makes no slowing robot look steady",
    5: "wheel pulses alone show that a robot rolls only 0.55 s after it should have come to rest; "
    "drive feedback beyond what the chassis can do shows that it moves; where there is none, so do wheel speeds "
    "of an unknown scale",
    6: "a robot that is found moving, or is given back in motion, is told no more than its steering angle allows; "
    "a speed of less than one bit of the drive command counts as none where the robot rolls; "
    "wheels that follow a slow change of the steering angle with a lag of 0.2 s do follow",
    7: "the speed limit that no setting names is 1.0 m/s, 2.222 before; "
    "the age that bounds the speed is at least the largest of the last 300 ms, and no mean of a second alone; "
    "a reset names whose stop it clears, where that was somebody else's; "
    "a stop that is latched switches both indicators on, and leaves them on until the next engage; "
    "an engaged robot that is asked for no speed for five minutes is disengaged; "
    "a robot that the remote control takes is left with zero speed and the parking brake; "
    "a stop that begins while the mode is not auto has no ramp, and one that is owed waits for a body frame; "
    "what was seen before the bus was lost counts no more; "
    "a latched robot that the remote control gives back is owed its parking brake; "
    "a robot that is commanded to move and is seen to stand stops, and so does one whose speeds are frozen; "
    "a commanded speed waits for a robot that does not follow; "
    "a robot that becomes faster than commanded gets its parking brake after 100 ms; "
    "a speed of zero that no feedback has confirmed is not called standing; "
    "the speed limit of an idle robot is the one that an engage would bring; "
    "a robot whose parking brake slips is given back to its motor; a stop that lets it move twice stays in gear; "
    "the gear is changed once the parking brake has read applied for 100 ms; "
    "at zero speed, after a part of a burst, the parking frame is sent second; "
    "a loop that is late while the robot stands by is told as information; "
    "the first robot that is found moving after a crash is latched",
}
"""The changes that each version of the rules brought."""


def rules_notice(rules: int) -> str:
    """Return a warning for a journal that was made under other rules; empty if the rules are those of today."""
    if rules == COMMAND_RULES:
        return ""
    made = max(rules, _UNNUMBERED + 1)
    changes = "; ".join(text for number, text in CHANGES.items() if number > made)
    what = changes or "this version does not know what that changed"
    return f"made under rules {made}, today's are {COMMAND_RULES}: {what}; differences are expected"
