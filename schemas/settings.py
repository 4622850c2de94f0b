"""Every setting, and every limit that decides what the robot or the log does, with unit, bounds and start value.

What bounds the work of one module alone (the timeout of a port, the length of a queue, how often a view is drawn)
is a named constant at the top of that module, and what the virtual chassis can do in ``gateway.sim.body``.
``configuration`` fills these classes from a TOML file, the environment and flags. The table in
``docs/configuration.md`` is generated from here: the docstrings say what each setting is.

Profiles of thin links say which subjects leave a robot seldom or not at all, as rules for Zenoh. It leaves samples
out at the robot's end of the links that are named: whoever is connected by another link gets everything. Replies,
and with them history, are left out only of subjects that do not leave at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta

from schemas import keys
from schemas.cruiser import SPEED_TOP_MPS, STEERING_TOP_DEG
from schemas.keys import ROBOT_PATTERN
from schemas.messages import BUS_MAX_LENGTH
from schemas.subjects import SUBJECTS, Pattern

FULL, OPERATOR, THIN = "full", "operator", "thin"

_RAW: Final = ("can/{bus}/rx", "can/{bus}/tx", "journal")
_DECODED: Final = tuple(subject.name for subject in SUBJECTS if subject.name.startswith("chassis/"))

PROFILES: Final[dict[str, dict[str, float]]] = {
    FULL: {},
    OPERATOR: dict.fromkeys((*_RAW, *_DECODED), 0.0)
    | {"state": 10.0, "chassis/odometry": 5.0, "safety/state": 25.0},
    THIN: dict.fromkeys((*_RAW, *_DECODED, "safety/decision"), 0.0)
    | {"state": 2.0, "chassis/odometry": 1.0, "safety/state": 2.0, "gateway/health": 0.5},
}
"""Of each profile the highest rates in Hz, by subject: 0 leaves it out, and what is not named leaves as it is."""

EVERY_INTERFACE: Final = "*"

PROFILE_PATTERN: Final = rf"^([^=/\s]{{1,15}}|\*)=({FULL}|{OPERATOR}|{THIN})\Z"
"""The form of ``zenoh.profiles``: an interface of Linux, and its profile."""

DOWNSAMPLING: Final = "downsampling"  # the path of the rules in Zenoh's configuration
EARLY: Final = 1.1  # rules' periods are shorter than a profile's: some samples come early

SEND_BUFFER_BYTES: Final = 16_384
"""The system's send buffer of each link of a robot with a profile; Linux doubles it.

No priority overtakes what is in it, and by itself Linux lets it grow to seven seconds of a link of 0.5 Mbit/s.
"""

SEND_BATCH_BYTES: Final = 16_384
"""Such a robot's Zenoh sends so much at a time. No priority overtakes a batch that is being sent, and Zenoh's own
64 KiB take a second of that link."""

SEND_BATCHES: Final = 16
"""So many of them, the most that Zenoh allows, wait in the queues of replies that nobody hurries for.

Who a gateway is takes 100 kB, and a reply that does not fit into its queue is dropped.
"""

LINK_SETTINGS: Final = {
    "transport/link/tcp/so_sndbuf": SEND_BUFFER_BYTES,
    "transport/link/tls/so_sndbuf": SEND_BUFFER_BYTES,
    "transport/link/tx/batch_size": SEND_BATCH_BYTES,
    "transport/link/tx/queue/size/data": SEND_BATCHES,
    "transport/link/tx/queue/size/data_low": SEND_BATCHES,
}
"""By their paths in Zenoh's configuration."""


def zenoh_rules(profiles: Sequence[str], root: str, robot: str) -> dict[str, Any]:
    """Return the entries of Zenoh's configuration for a robot's session, by path; none without a profile."""
    items: list[dict[str, Any]] = []
    for number, one in enumerate(profiles):
        interface, _, profile = one.rpartition("=")
        rates = PROFILES[profile]
        for name, messages, rules in (
            ("slower", ["put"], [_rule(root, robot, subject, hz) for subject, hz in rates.items() if hz]),
            (
                "none",
                ["put", "reply"],
                [_rule(root, robot, subject, 0) for subject, hz in rates.items() if not hz],
            ),
        ):
            if rules:
                where = {} if interface == EVERY_INTERFACE else {"interfaces": [interface]}
                items.append(
                    {
                        "id": f"profile-{number}-{name}",
                        "flows": ["egress"],
                        "messages": messages,
                        "rules": rules,
                        **where,
                    }
                )
    return {DOWNSAMPLING: items, **LINK_SETTINGS} if items else {}


def _rule(root: str, robot: str, subject: str, hz: float) -> dict[str, Any]:
    return {"key_expr": f"{root}/{robot}/{subject.format(bus=keys.ALL)}", "freq": hz * EARLY}


def rate_in_words(profile: str, subject: str) -> str:
    hz = PROFILES[profile].get(subject)
    if hz is None:
        return "all"
    if not hz:
        return "none"
    return f"at most {hz:g} Hz" if hz >= 1 else f"every {1 / hz:g} s at most"


PUBLISHED: Final = tuple(subject for subject in SUBJECTS if subject.pattern is Pattern.PUBLISHED)


CHANNEL_LIMIT: Final = 35_000
"""Channels of a log for keys that anybody may make up. Those beyond share one of RawSamples, each with its key."""

TABLE_CHANNEL_LIMIT: Final = 30_000  # channels for the key table's own: with all others below MCAP's 65,535
BUS_LIMIT: Final = 8  # buses of a robot whose keys count among the table's: their names are not in it
ROBOT_LIMIT: Final = 1024  # robots that have logs of their own and are asked who they are; others share one log
OWNED_KEY_LIMIT: Final = 65_536  # keys whose expression the recorder remembers; beyond it, it begins anew
INCIDENT_MAX_NS: Final = 600_000_000_000  # an incident that goes on is one log of ten minutes, then another
INCIDENT_SHARE: Final = 0.5  # share of ``budget_bytes`` for incidents, which are never deleted
MARK_SHARE: Final = 0.25  # share up to which marks, which nobody signs, begin incidents: faults have the rest
INCIDENT_FLOOR_SHARE: Final = 0.5  # share of ``floor_bytes`` that incidents leave free

EventKindName = Literal[
    "lease", "engaged", "stop", "stopped", "latch", "reset", "takeover", "fault", "guard", "gateway"
]


INCIDENT_EVENTS: Final[tuple[EventKindName, ...]] = ("stop", "stopped", "latch", "takeover", "fault", "guard")


class RecorderSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The recorder.

    Attributes:
        name: the recorder's chunk of its keys; if empty, in signed mode the name of its grant, else the host's
        keys: key expressions to record; if empty, everything under the root
        directory: the directory of the logs
        per_robot: a log for each robot; else one for all
        shard: NUMBER/COUNT, such as 2/4: this recorder is the second of four that share a fleet's robots by their
            names; if empty, it records all of them
        standby: write nothing but incidents
        flush_s: s; at most this much of the log is not yet on the disk
        chunk_bytes: bytes of a chunk before compression
        rotate_bytes: bytes; a log that has reached this size is ended, and another begun; 0 is never
        rotate_s: s; so is one that was begun so long ago; 0 is never
        queue_bytes: bytes of samples that may wait to be recorded; beyond it the oldest go, and are counted
        sample_max_bytes: bytes; a larger sample is not recorded, but counted
        budget_bytes: bytes that the directory's logs may take; beyond it the oldest go of the robot that takes
            most; 0 is no limit
        floor_bytes: bytes that stay free on the file system, or a tenth of it; below it the oldest logs go
        known_robots: names of the robots that are known, besides those that `recorder.keys` names; all others then
            share one robot's part of the budget
        keep_s: s; so much of a known robot's newest logs goes only when nothing else is left to go
        keep_incidents_s: s; an incident that an upload has brought to safety is deleted only when it is this old
        incident_events: kinds of `safety/event`, of severity warning or error, that make an incident
        incident_before_s: s before an incident that its log holds
        incident_after_s: s after an incident that its log holds
        incident_ring_bytes: bytes of messages held in memory for an incident, of all robots together
    """

    name: Annotated[str, Meta(pattern=r"^[a-z0-9-]*\Z")] = ""
    keys: list[str] = []
    directory: Annotated[str, Meta(min_length=1)] = "."
    per_robot: bool = True
    shard: Annotated[str, Meta(pattern=r"^([1-9][0-9]{0,2}/[1-9][0-9]{0,2})?\Z")] = ""
    standby: bool = False
    flush_s: Annotated[float, Meta(ge=0.05, le=10)] = 0.5
    chunk_bytes: Annotated[int, Meta(ge=1024, le=16_777_216)] = 1_048_576
    rotate_bytes: Annotated[int, Meta(ge=0)] = 0
    rotate_s: Annotated[float, Meta(ge=0, le=2_678_400)] = 0.0
    queue_bytes: Annotated[int, Meta(ge=1_000_000, le=16_000_000_000)] = 64_000_000
    sample_max_bytes: Annotated[int, Meta(ge=1024, le=1_000_000_000)] = 16_000_000
    budget_bytes: Annotated[int, Meta(ge=0)] = 0
    floor_bytes: Annotated[int, Meta(ge=0)] = 200_000_000
    known_robots: list[Annotated[str, Meta(pattern=rf"^{ROBOT_PATTERN}\Z")]] = []
    keep_s: Annotated[float, Meta(ge=0, le=2_678_400)] = 7200.0
    keep_incidents_s: Annotated[float, Meta(ge=0, le=31_536_000)] = 604_800.0
    incident_events: list[EventKindName] = msgspec.field(default_factory=lambda: [*INCIDENT_EVENTS])
    incident_before_s: Annotated[float, Meta(ge=0, le=300)] = 30.0
    incident_after_s: Annotated[float, Meta(ge=0, le=300)] = 30.0
    incident_ring_bytes: Annotated[int, Meta(ge=0, le=16_000_000_000)] = 64_000_000


class UploadSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The upload of finished logs: see docs/recording.md.

    Attributes:
        store: URL of the object store: s3://BUCKET/PLACE, gs://BUCKET/PLACE, az://CONTAINER/PLACE,
            file:///DIRECTORY; empty: nothing is uploaded
        options: of that store, by obstore's names, such as endpoint and region; credentials are the environment's
        logs: incidents and logs, or incidents alone
        rate_bytes_s: bytes/s that it takes of the link, each way, in the mean of parts of 5 MiB; 0 is no limit
        read_back: read each log back, and compare; else the store's own checksum is enough, where it has one
        catalog: put each log's row of the catalog beside it, for which it is read once more when no log waits
        cache_bytes: bytes of copies of a store's logs that `cruiser review` keeps in $XDG_CACHE_HOME/cruiser, or
            ~/.cache/cruiser; beyond it those go that were not asked for longest
    """

    store: str = ""
    options: dict[str, str | int | float | bool] = {}
    logs: Literal["all", "incidents"] = "all"
    rate_bytes_s: Annotated[int, Meta(ge=0, le=1_000_000_000)] = 250_000
    read_back: bool = True
    catalog: bool = True
    cache_bytes: Annotated[int, Meta(ge=0)] = 20_000_000_000


DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""The endpoint where a gateway listens and every other command connects. One robot needs no router."""

TICK_NS: Final = 10_000_000  # the loop's tick and the chassis's command period, 10 ms
LATE_NS: Final = 50_000_000  # a tick that begins later than this is reported in the log
LATE_TOLD_NS: Final = 1_000_000_000  # shortest time between two such reports, which fill no history
SILENCE_PERIODS: Final = 10  # a feedback frame is silent after this many of its periods without a valid one
SILENCE_MIN_NS: Final = 100_000_000  # none is silent sooner; both are below 160 ms, where a counter aliases

CHECKSUM_FAULTS: Final = 5
"""This many checksum faults of one identifier within CHECKSUM_WINDOW_NS are a failure of that frame.

Three would stop the robot seven times an hour where one frame in a thousand is damaged; five, once in some hundred
hours. None of these frames is ever believed."""

CHECKSUM_WINDOW_NS: Final = 1_000_000_000

IMPLAUSIBLE_FAULTS: Final = 3  # so many such frames of one identifier within the window are a failure of it

IMPLAUSIBLE_WINDOW_NS: Final = 1_000_000_000

ALIVE_FAULTS: Final = 5  # the alive counter has failed at this count: +1 per fault, -1 per good frame
ALIVE_MAX_LOST_STEP: Final = 3  # a step of 2 up to this is lost frames, beyond it a wrong sequence (E2E profile 1)
ALIVE_STUCK_REPEATS: Final = 3  # the counter is stuck after this many repeats in a row
PERIOD_WINDOW_FRAMES: Final = 20  # a frame's period is judged over this many frames
PERIOD_TOLERANCE: Final = 1.5  # the mean period is at fault above this many nominal periods, or below the inverse
VARIANT_EVIDENCE_FRAMES: Final = 5  # standstill frames in a row that agree confirm a firmware variant
STANDSTILL_MPS: Final = 0.05  # wheels slower than this stand still
STATE_PERIOD_NS: Final = 50_000_000  # `state` goes out every 50 ms, 20 Hz

ODOMETRY_PERIOD_NS: Final = 20_000_000

BATCH_PERIOD_NS: Final = 50_000_000  # raw frames go out in batches of 50 ms
BATCH_MAX_FRAMES: Final = 4096  # raw frames held for a batch; beyond it the oldest are dropped and counted
HEALTH_PERIOD_NS: Final = 1_000_000_000  # `gateway/health` goes out once a second
RECONNECT_MIN_S: Final = 0.1  # first pause before a lost bus is opened again; it doubles up to RECONNECT_MAX_S

RECONNECT_MAX_S: Final = 2.0

ENGAGE_TIMEOUT_NS: Final = 1_000_000_000  # the chassis reads auto so soon after five enables, or it failed

HOLD_NS: Final = 1_000_000_000
"""A stop holds the robot for 1 s behind the parking brake, after it was last seen to move."""

DISABLE_NS: Final = 500_000_000  # after the hold a stop sends disabled frames for 0.5 s, then nothing
REST_TIMEOUT_NS: Final = 10_000_000_000  # a gateway that shuts down waits so long for rest; a stop takes up to 7 s
NOT_SLOWING_NS: Final = 300_000_000  # a robot being stopped that does not slow down for so long is parked
SLOWING_MPS: Final = 0.02  # a robot slows down if it is slower by this than it was
BRAKE_UNSEEN_NS: Final = 3_000_000_000  # a stop without parking feedback waits so long before it continues
SHIFT_TICKS: Final = 10  # each gear is commanded for 100 ms behind the parking brake before the next step
BRAKE_MAX_NS: Final = 1_000_000_000  # a robot that moves so long after a command of zero speed is parked
AUTO_HOLD_NS: Final = 1_000_000_000  # an engaged robot that stands so long at zero command is parked
WARN_AGAIN_NS: Final = 5_000_000_000  # people are warned again before a robot sets off that stood so long
BLINK_NS: Final = 350_000_000  # indicators that warn are on for this long, and off for as long
SLIPS_NS: Final = 2_000_000_000  # motion so soon after the auto-hold: the motor held it, not the parking brake
MOTOR_HOLDS_NS: Final = 300_000_000  # given back to its motor, it is no faster after this time, or parked for good
BRAKE_RETURNS: Final = 2  # a stop whose disabled frames let the robot move so many times does not disable any more
RETURN_NS: Final = 10_000_000_000  # a robot found moving so soon after the end of its stop was not held either
BRAKED_NS: Final = 5_000_000_000  # a stop that does not disable ends by a reset, after standing braked for so long
STANDSTILL_TICKS: Final = 5  # the robot stands when its speed was under STANDSTILL_MPS for this many ticks, 50 ms
RESET_MIN_NS: Final = 500_000_000  # a reset that comes sooner after a latch was not meant for it
LOOP_LATE_STOP_NS: Final = 100_000_000  # a tick that begins later than this stops the robot
IMPLAUSIBLE_MPS: Final = 0.3  # speeds that differ by more than this and ``IMPLAUSIBLE_RATIO`` do not fit
IMPLAUSIBLE_RATIO: Final = 1.5  # factor beyond which speeds do not fit, with ``IMPLAUSIBLE_MPS``
IMPLAUSIBLE_NS: Final = 300_000_000  # time for which speeds must differ so, 300 ms
REFERENCE_DECELERATION_MPS2: Final = 0.8  # the reference of a falling command falls so fast: chassis lag
DRIVE_LAG_S: Final = 0.4  # lag of the chassis behind a falling command at most (chosen: no figure in the manual)
ROLLING_MPS: Final = 0.1  # a robot rolls that is faster than the standstill bound and a noisy coarse bit
ROLLING_NS: Final = 100_000_000  # time for which it is so fast while commanded to stand, or against its command
CREEPING_NS: Final = 1_000_000_000  # rolling too: over the standstill bound for so long, or its pulses count
OVERSPEED_MPS: Final = 0.3  # a measured speed is too fast that is over the limit in force by this
OVERSPEED_NS: Final = 300_000_000  # time for which a speed must be over the limit, 300 ms
NOT_MOVING_COMMAND_MPS: Final = 0.3  # commanded more than this, lag included, it must be seen to move
NOT_MOVING_MPS: Final = 0.15  # slower than this by drive feedback and wheels, it is not seen to move
NOT_MOVING_NS: Final = 1_000_000_000  # time for which it must not be seen to move, 1 s
GATHERING_MPS: Final = 0.06  # that time begins again when it is faster by more than this: it gathers speed
FROZEN_COMMAND_MPS: Final = 0.3  # speeds are frozen that keep each bit while the command changes by more
FROZEN_NS: Final = 1_000_000_000  # time for which they must not change, 1 s
FROZEN_STANDING_COMMAND_MPS: Final = 0.1  # commanded more, it does not stand if pulses or mileage count
FROZEN_STANDING_KM: Final = 0.002  # the mileage has counted by this: 2 m
FROZEN_STILL_NS: Final = 200_000_000  # time for which one of these holds: wheel speeds come every 50 ms
FOLLOWING_MPS: Final = 0.5  # the commanded speed rises while it is no more than this above the greatest one seen
FOLLOWING_S: Final = 0.6  # or than the speed that the acceleration gives in this time, if that is more
RUNAWAY_RISE_MPS: Final = 0.08  # ``OVERSPEED_MPS`` over its command, and faster by two coarse bits, it runs away
RUNAWAY_WINDOW_NS: Final = 200_000_000  # time in which it has become faster, 200 ms
RUNAWAY_NS: Final = 100_000_000  # time for which it must run away so, 100 ms
STEERING_DEVIATION_DEG: Final = 5.0  # an angle that is off the commanded one by more does not follow
STEERING_DEVIATION_NS: Final = 300_000_000  # time for which an angle must be off, 300 ms
STEERING_FOLLOWS_DEGPS: Final = 30.0  # rate of turning the wheels at which a chassis still follows
STEERING_LAG_S: Final = 0.2  # lag of the wheels behind the angle at most (chosen: no figure in the manual)
FROZEN_BODY_M: Final = 3.0  # mileage counts whole metres: unchanged after this way, the body frame is frozen
BUMPER_CLEAR_NS: Final = 300_000_000  # a bumper is released once it has read clear for this long: contacts bounce
PULSES_MOVING_FRAMES: Final = 16  # wheel pulses the same way in so many frames, 800 ms, show motion
PULSES_STEADY: Final = 0.9  # share of the first half of these pulses that the second half must reach
PULSES_REST_S: Final = 0.55  # pulses show rolling so long after it should have stood: half of them, three frames
CREEP_PULSES: Final = 40  # wheel pulses the same way, a few in each frame without long gaps, that show creeping
CREEP_FRAME_PULSES: Final = 2  # more pulses in a period are no creeping: it drives, or comes to rest
CREEP_PAUSE_FRAMES: Final = 10  # after so many periods, 500 ms, without a wheel pulse the robot stands
CREEP_REST_NS: Final = 2_000_000_000  # time to come to rest before a few wheel pulses show creeping
SEND_FAILURES: Final = 5  # this many ticks in a row whose frames the bus did not accept are a failure
LEFT_BLIND_NS: Final = 200_000_000  # left under command or owed a stop, it is stopped so long without body frames
YIELD_BURSTS: Final = 10  # bursts of zero speed and parking brake when the remote control takes a robot
BEHIND_NS: Final = 200_000_000  # frames that were never all read for this long are coming faster than they can be
FOUND_MOVING_NS: Final = 200_000_000  # in auto and moving so long while nobody commands it, it is stopped
REPEATED_NS: Final = 1_000_000_000  # a stop from standby so soon after another applies the parking brake at once
COMMANDER_NS: Final = 100_000_000  # another computer commands the chassis whose command frame came so lately

COMMANDER_QUIET_NS: Final = 1_000_000_000
"""After a pause of this length another computer's commands are news again. Below WARM_UP_NS of a run that is run
again: a part of it has to give the same events."""

ODOMETER_TIMEOUT_NS: Final = 2_000_000_000  # the mileage reads zero so soon after clearing, or it failed

TAIL_NS: Final = 100_000_000
"""Once lamps, horn or odometer are no longer requested, frames that clear them are sent for this long."""

DRIVES_PER_TICK: Final = 16  # drive commands judged in a tick; the rest waits in a ring, where the oldest go
VERBS_PER_TICK: Final = 8  # verbs judged in a tick at most; the rest wait
STOPS_PER_TICK: Final = 16  # remote stops judged in a tick; one is enough to stop, the others are answered too
MILEAGE_DIFFERS_KM: Final = 1.0  # further than this off the last run's, it may be another chassis's mileage
REQUEST_MAX_BYTES: Final = 1024  # no request is larger

SEQUENCE_STEP_MAX: Final = 1000
"""A drive command's ``seq`` is at most so far above the last accepted one: more than the longest lease of 10 s
holds at 50 Hz, so that no loss on the way reaches it, and nobody can use up the numbers."""

SAFETY_STATE_PERIOD_NS: Final = 50_000_000  # `safety/state` is published every 50 ms, and on change
SAFETY_STATE_ENGAGED_PERIOD_NS: Final = 20_000_000  # the same while engaged: half of it is age
DEADMAN_MAX_S: Final = 1.0  # no engagement has a longer deadman
GUARD_POLL_NS: Final = 5_000_000  # the guard looks at the loop's heartbeat every 5 ms
TOLD_LONG_AGO_NS: Final = 100_000_000  # held up longer, a stop continues from the measured speed, if lower
MUTE_FAILURES: Final = 20  # after so many ticks without a stop that the bus took, the guard tries its own way

GUARD_LATE_NS: Final = 80_000_000
"""A heartbeat older than this, and still so 5 ms later, is late: the guard stops the robot.

The first stop frame has to be on the bus within 100 ms of the last good one.
"""

GUARD_LOOK_NS: Final = 100_000_000  # a stop that begins or continues late waits so long for feedback
GUARD_RESTART_NS: Final = 5_000_000_000  # a lost guard is started again at most this often, while idle
GUARD_HANGS_TICKS: Final = 100  # a guard that gives no sign of life in so many ticks is killed and started again
REMOTE_FRAMES: Final = 2  # so many in a row that read remote are believed: one may be two flipped bits
OFF_BURSTS: Final = 10  # a stop sets lamps, horn and odometer in its first 10 bursts, 100 ms: one may get lost
GUARD_SILENT_NS: Final = 200_000_000  # without a sign, or feedback, for so long a guard does not watch
GUARD_GIVES_UP_NS: Final = 30_000_000_000  # a guard without gateway and bus tries for so long
HALT_LISTEN_NS: Final = 300_000_000  # `cruiser halt` judges the chassis after so long without another sender
HALT_YIELD_NS: Final = 15_000_000_000  # `cruiser halt` waits so long for another sender, maybe the guard


class RobotSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Name of this robot, and the root of its keys.

    Attributes:
        root: first chunks of every key
        name: the robot's chunk of the key
    """

    root: Annotated[str, Meta(pattern=rf"^{keys.ROOT_PATTERN}\Z")] = "fleet"
    name: Annotated[str, Meta(pattern=rf"^{keys.ROBOT_PATTERN}\Z")] = "cruiser-1"


class CanSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The CAN bus, through python-can.

    Attributes:
        interface: python-can interface: socketcan, socketcand, pcan, slcan, ...
        channel: the interface's channel; for socketcand HOST:PORT or HOST:PORT/BUS
        bitrate: bit/s, for interfaces that set it; 0 leaves it alone. The manual gives none; 500000 is common for
            this family
        bus: the bus's name in keys: can/{bus}/rx
        raw_frames: receive all frames of the bus, and publish them and those sent as they are; else only the
            chassis's own are asked for, and none is published raw
        options: further arguments of the python-can interface; of socketcan, ``fd`` alone
    """

    interface: Annotated[str, Meta(min_length=1)] = "socketcan"
    channel: Annotated[str, Meta(min_length=1)] = "can0"
    bitrate: Annotated[int, Meta(ge=0, le=1_000_000)] = 0
    bus: Annotated[str, Meta(pattern=rf"^{keys.BUS_PATTERN}\Z", max_length=BUS_MAX_LENGTH)] = "can0"
    raw_frames: bool = True
    options: dict[str, str | int | float | bool] = {}


NEEDED_FEEDBACK: Final = (
    "Auto_GearFeedBack",
    "Auto_SteeringFeedBack",
    "Auto_DriveFeedBack",
    "Auto_ParkingFeedBack",
    "Auto_WheelSpdFeedback",
    "Auto_MileageAndBodyFeedback",
)
"""Feedback that the arbiter decides by: `chassis.required_feedback` may name more, and not less."""

FeedbackName = Literal[
    "Auto_GearFeedBack",
    "Auto_SteeringFeedBack",
    "Auto_DriveFeedBack",
    "Auto_BrakingFeedBack",
    "Auto_ParkingFeedBack",
    "Auto_WheelSpdFeedback",
    "Auto_WheelPulseFeedback",
    "Auto_MileageAndBodyFeedback",
    "Auto_LightFeedback",
    "Auto_SpeakerFeedback",
]


class ChassisSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The chassis.

    Attributes:
        variant: firmware variant; auto waits for evidence at standstill
        required_feedback: feedback frames without which the robot is not commanded; braking (reserved, says the
            manual), wheel pulses, lamps and horn may be left out or added, the others are always needed
    """

    variant: Literal["auto", "coarse", "fine"] = "auto"
    required_feedback: list[FeedbackName] = msgspec.field(
        default_factory=lambda: [*NEEDED_FEEDBACK, "Auto_WheelPulseFeedback"]
    )


class ZenohSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The Zenoh session.

    Attributes:
        mode: mode of the session; unless it is said, commands and recorders that find a router become its clients:
            it passes nothing between peers
        connect: endpoints to connect to; if empty, tcp/127.0.0.1:7447 for all but the gateway
        listen: endpoints to listen on; if empty, a gateway that connects elsewhere listens on nothing, another on
            tcp/127.0.0.1:7447, or on a free port of 127.0.0.1 if a Zenoh node is there
        command_listen: endpoints on which the gateway listens for commands; if empty, the addresses that it
            listens on for all else, each one port on
        config: a Zenoh configuration file (JSON5); what it says holds, unless a setting of this table is given too
        lease_ms: a link without a sign of life for this long is lost; where it is not set, 5000 for `cruiser
            record --shard`
        profiles: INTERFACE=PROFILE, as wwan0=operator: what leaves the gateway over links on this network
            interface, or * for all: full, operator or thin; see docs/operate.md
        given: no setting: the names of those that a source gave, which may also be their start values
    """

    mode: Literal["peer", "client"] = "peer"
    connect: list[str] = []
    listen: list[str] = []
    command_listen: list[str] = []
    config: str = ""
    lease_ms: Annotated[int, Meta(ge=200, le=60_000)] = 1000
    profiles: list[Annotated[str, Meta(pattern=PROFILE_PATTERN)]] = []
    given: frozenset[str] = frozenset()


class GatewaySettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The edge process.

    Attributes:
        listen_only: send nothing on the bus, whatever is asked
        accept_unguarded: engage although no guard process can watch on this interface
        wait_for_bus: start although the bus is not there, and wait for it; else that is an error
        realtime_priority: SCHED_FIFO priority of the loop, where the system allows it; 0 is off
        state_dir: directory of the notes that keep what is latched, and the mileage, across a restart; auto:
            $STATE_DIRECTORY, which systemd sets, else $XDG_STATE_HOME/cruiser, else ~/.local/state/cruiser; empty:
            no note is kept
    """

    listen_only: bool = False
    accept_unguarded: bool = False
    wait_for_bus: bool = False
    realtime_priority: Annotated[int, Meta(ge=0, le=99)] = 10
    state_dir: str = "auto"


class CommandSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The safety arbiter. At run time its limits scale down, never up.

    Attributes:
        lease_s: s; a lease that is not renewed expires
        deadman_s: s; without an acceptable drive command for this long: a stop
        max_age_s: s; a drive command that may be older, by its echo, is refused
        travel_delay_m: m; farthest it drives before it can react to its operator: its speed is at most this over
            the age of the commands and the deadman
        view_delay_s: s; delay of the pictures that its operator drives by, which no gateway can measure: it is
            added to the age of the commands
        speed_limit_mps: m/s; highest speed, either way; a bumper hit at 2.2 m/s goes on for 1.5 m, at 1 for 0.4
        speed_limit_without_realtime_mps: m/s; highest speed of a gateway that no guard watches or that has no
            real-time priority
        acceleration_mps2: m/s2; most it speeds up
        deceleration_mps2: m/s2; how it slows down, and stops in a controlled way
        emergency_deceleration_mps2: m/s2; how it stops at once
        steering_limit_deg: deg; furthest steering angle
        steering_rate_degps: deg/s; fastest change of it
        lateral_acceleration_mps2: m/s2; v^2 tan(angle) / wheelbase; speed is reduced to keep it
        idle_s: s; an engaged robot that is asked for no speed for this long is disengaged; 0 is never
        warning_s: s; for this long both indicators blink, and no speed is commanded, once the robot is engaged,
            and again before it sets off after 5 s of standing; 0 is off
    """

    lease_s: Annotated[float, Meta(ge=0.5, le=10)] = 2.0
    deadman_s: Annotated[float, Meta(ge=0.05, le=0.5)] = 0.3
    max_age_s: Annotated[float, Meta(ge=0.1, le=1.0)] = 1.0
    travel_delay_m: Annotated[float, Meta(ge=0.2, le=5.0)] = 1.0
    view_delay_s: Annotated[float, Meta(ge=0, le=2)] = 0.0
    speed_limit_mps: Annotated[float, Meta(ge=0.05, le=SPEED_TOP_MPS)] = 1.0
    speed_limit_without_realtime_mps: Annotated[float, Meta(ge=0.05, le=SPEED_TOP_MPS)] = 1.0
    acceleration_mps2: Annotated[float, Meta(ge=0.1, le=1.5)] = 0.8
    deceleration_mps2: Annotated[float, Meta(ge=0.3, le=2.0)] = 1.2
    emergency_deceleration_mps2: Annotated[float, Meta(ge=0.5, le=3.0)] = 2.0
    steering_limit_deg: Annotated[float, Meta(ge=1, le=STEERING_TOP_DEG)] = STEERING_TOP_DEG
    steering_rate_degps: Annotated[float, Meta(ge=5, le=60)] = 60.0
    lateral_acceleration_mps2: Annotated[float, Meta(ge=0.2, le=3.0)] = 1.5
    idle_s: Annotated[float, Meta(ge=0, le=86_400)] = 300.0
    warning_s: Annotated[float, Meta(ge=0, le=10)] = 0.0


class AuthoritySettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Authentication of people and robots: see docs/authority.md.

    Attributes:
        mode: open: whoever reaches the gateway commands it, so it arms only where nothing but this machine reaches
            it; signed: people and robots are proven by their keys
        directory: directory of keys and grants, as 'cruiser provision' made it; auto: $XDG_CONFIG_HOME/cruiser,
            else ~/.config/cruiser
    """

    mode: Literal["open", "signed"] = "open"
    directory: str = "auto"


class DeskSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The desk: see docs/desk.md.

    Attributes:
        listen: ADDRESS:PORT where browsers ask; beyond this machine it needs a certificate
        certificate: its certificate chain for browsers, PEM
        key: that certificate's private key, PEM
        names: names under which browsers reach it, besides those of this machine
        logs: directory of a recorder, whose logs and reports whoever opens the page may read; empty: none
        viewers: addresses of viewers that open a log by its address; their pages may read the logs
    """

    listen: str = "127.0.0.1:8080"
    certificate: str = ""
    key: str = ""
    names: list[str] = []
    logs: str = ""
    viewers: list[str] = []


class SimSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The virtual chassis.

    Attributes:
        listen: HOST:PORT of the socketcand server
        variant: firmware variant it plays
    """

    listen: str = "127.0.0.1:29536"
    variant: Literal["coarse", "fine"] = "coarse"


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All settings; each field is a table of the TOML file."""

    robot: RobotSettings = RobotSettings()
    can: CanSettings = CanSettings()
    chassis: ChassisSettings = ChassisSettings()
    zenoh: ZenohSettings = ZenohSettings()
    gateway: GatewaySettings = GatewaySettings()
    command: CommandSettings = CommandSettings()
    recorder: RecorderSettings = RecorderSettings()
    upload: UploadSettings = UploadSettings()
    desk: DeskSettings = DeskSettings()
    sim: SimSettings = SimSettings()
    authority: AuthoritySettings = AuthoritySettings()
