"""Every setting, and every limit that affects the robot or the log, with unit, bounds and default.

Limits that concern one module only (a port's timeout, the length of a queue) are constants in that module; those
of the virtual chassis are in ``gateway.sim.body``. ``configuration`` fills these classes from a TOML file, the
environment and flags. ``docs/configuration.md`` is generated from the docstrings here.

Profiles for thin links limit the rates of subjects, as rules for Zenoh. Zenoh drops samples at the robot's end of
the named links only; clients on other links receive everything. Replies, history included, are dropped only for
subjects that the profile leaves out.
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
"""Highest rates of each profile in Hz, by subject. 0 leaves a subject out; others are not limited."""

EVERY_INTERFACE: Final = "*"

PROFILE_PATTERN: Final = rf"^([^=/\s]{{1,15}}|\*)=({FULL}|{OPERATOR}|{THIN})\Z"
"""The form of ``zenoh.profiles``: an interface of Linux, and its profile."""

DOWNSAMPLING: Final = "downsampling"  # path of the rules in Zenoh's configuration
EARLY: Final = 1.1  # factor between a rule's rate and the profile's, since some samples come early

SEND_BUFFER_BYTES: Final = 16_384
"""The system's send buffer of each link of a robot with a profile; Linux doubles it.

No priority overtakes its content. By default Linux lets it grow to seven seconds of a link of 0.5 Mbit/s.
"""

SEND_BATCH_BYTES: Final = 16_384
"""Zenoh's batch size for such a robot. No priority overtakes a batch: Zenoh's default of 64 KiB takes a second."""

SEND_BATCHES: Final = 16
"""Batches in the queues of replies, the most that Zenoh allows: a reply that does not fit into its queue is
dropped, and that on ``gateway/info`` has 100 kB."""

LINK_SETTINGS: Final = {
    "transport/link/tcp/so_sndbuf": SEND_BUFFER_BYTES,
    "transport/link/tls/so_sndbuf": SEND_BUFFER_BYTES,
    "transport/link/tx/batch_size": SEND_BATCH_BYTES,
    "transport/link/tx/queue/size/data": SEND_BATCHES,
    "transport/link/tx/queue/size/data_low": SEND_BATCHES,
}


def zenoh_rules(profiles: Sequence[str], root: str, robot: str) -> dict[str, Any]:
    """Return entries of a robot's Zenoh configuration, by path; none without a profile."""
    items: list[dict[str, Any]] = []
    for number, one in enumerate(profiles):
        interface, _, profile = one.rpartition("=")
        where = {} if interface == EVERY_INTERFACE else {"interfaces": [interface]}
        rates = PROFILES[profile].items()
        for name, messages, is_sent in (("slower", ["put"], True), ("none", ["put", "reply"], False)):
            rules = [_rule(root, robot, subject, hz) for subject, hz in rates if (hz > 0) is is_sent]
            if rules:
                head = {"id": f"profile-{number}-{name}", "flows": ["egress"]}
                items.append({**head, "messages": messages, "rules": rules, **where})
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


CHANNEL_LIMIT: Final = 35_000  # channels of a log for unknown keys; further ones share a RawSample channel
TABLE_CHANNEL_LIMIT: Final = 30_000  # channels for keys of the table; all together stay below MCAP's 65,535
BUS_LIMIT: Final = 8  # buses of a robot whose keys count as keys of the table
ROBOT_LIMIT: Final = 1024  # robots with their own logs, queried for their identity; further ones share one log
OWNED_KEY_LIMIT: Final = 65_536  # keys whose expression the recorder caches; beyond it the cache is cleared
INCIDENT_MAX_NS: Final = 600_000_000_000  # longest incident log; a longer incident continues in another
INCIDENT_SHARE: Final = 0.5  # share of ``budget_bytes`` for incidents, which are never deleted
MARK_SHARE: Final = 0.25  # share up to which marks, which are unsigned, begin incidents; the rest is for faults
INCIDENT_FLOOR_SHARE: Final = 0.5  # share of ``floor_bytes`` that incidents leave free

EventKindName = Literal[
    "lease", "engaged", "stop", "stopped", "latch", "reset", "takeover", "fault", "guard", "gateway"
]


INCIDENT_EVENTS: Final[tuple[EventKindName, ...]] = ("stop", "stopped", "latch", "takeover", "fault", "guard")


class RecorderSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The recorder.

    Attributes:
        name: the recorder's chunk of its keys; if empty, in signed mode the name in its grant, else the host's
            name
        keys: key expressions to record; if empty, everything under the root
        directory: directory of the logs
        per_robot: write a log for each robot; else one log for all
        shard: NUMBER/COUNT, such as 2/4: the second of four recorders that divide a fleet's robots among them by
            name; if empty, record all robots
        standby: write only incidents
        flush_s: s; longest time until a recorded message is on the disk
        chunk_bytes: bytes of a chunk before compression
        rotate_bytes: bytes; a log of this size is ended, and another begun; 0 is never
        rotate_s: s; a log of this age is ended, and another begun; 0 is never
        queue_bytes: bytes of samples that may wait to be recorded; beyond it the oldest are dropped and counted
        sample_max_bytes: bytes; a larger sample is dropped and counted
        budget_bytes: bytes that the directory's logs may take; beyond it the oldest logs are deleted of the robot
            that takes most; 0 is no limit
        floor_bytes: bytes, or a tenth of the file system if that is less, that stay free; below it the oldest logs
            are deleted
        known_robots: names of known robots, besides those in `recorder.keys`; all others then share one robot's
            part of the budget
        keep_s: s; a known robot's logs of this last time are deleted only if nothing else is left
        keep_incidents_s: s; an uploaded incident is deleted only when it is this old
        incident_events: kinds of `safety/event`, of severity warning or error, that begin an incident
        incident_before_s: s before an incident that its log contains
        incident_after_s: s after an incident that its log contains
        incident_ring_bytes: bytes of messages of all robots held in memory for an incident
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
            file:///DIRECTORY; if empty, nothing is uploaded
        options: options of the store, by obstore's names, such as endpoint and region; credentials come from the
            environment
        logs: all logs, or incidents only
        rate_bytes_s: bytes/s; average bandwidth, each way, over parts of 5 MiB; 0 is no limit
        read_back: read each uploaded log back and compare it; else trust the store's checksum, if it has one
        catalog: upload each log's row of the catalog beside it; the log is read once more for it, when no log
            waits
        cache_bytes: bytes of copies of a store's logs that `cruiser review` keeps in $XDG_CACHE_HOME/cruiser, or
            ~/.cache/cruiser; beyond it the least recently used are deleted
    """

    store: str = ""
    options: dict[str, str | int | float | bool] = {}
    logs: Literal["all", "incidents"] = "all"
    rate_bytes_s: Annotated[int, Meta(ge=0, le=1_000_000_000)] = 250_000
    read_back: bool = True
    catalog: bool = True
    cache_bytes: Annotated[int, Meta(ge=0)] = 20_000_000_000


DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"  # where a gateway listens and other commands connect

TICK_NS: Final = 10_000_000  # the loop's tick and the chassis's command period, 10 ms
LATE_NS: Final = 50_000_000  # a tick that begins later than this is reported in the log
LATE_TOLD_NS: Final = 1_000_000_000  # shortest time between two such reports
SILENCE_PERIODS: Final = 10  # a feedback frame is silent after this many of its periods without a valid one
SILENCE_MIN_NS: Final = 100_000_000  # shortest such time; both are below 160 ms, where a counter aliases

CHECKSUM_FAULTS: Final = 5
"""This many checksum faults of one identifier within CHECKSUM_WINDOW_NS are a failure of that frame.

If one frame in a thousand is damaged, three would stop the robot seven times an hour, five once in some hundred
hours. Damaged frames are never used."""

CHECKSUM_WINDOW_NS: Final = 1_000_000_000
IMPLAUSIBLE_FAULTS: Final = 3  # this many such frames of one identifier within the window are its failure
IMPLAUSIBLE_WINDOW_NS: Final = 1_000_000_000

ALIVE_FAULTS: Final = 5  # the alive counter has failed at this count: +1 per fault, -1 per good frame
ALIVE_MAX_LOST_STEP: Final = 3  # a step of 2 to this is lost frames, a larger one a wrong sequence (E2E profile 1)
ALIVE_STUCK_REPEATS: Final = 3  # the counter is stuck after this many repeats in a row
PERIOD_WINDOW_FRAMES: Final = 20  # a frame's period is judged over this many frames
PERIOD_TOLERANCE: Final = 1.5  # the mean period is at fault above this many nominal periods, or below the inverse
VARIANT_EVIDENCE_FRAMES: Final = 5  # standstill frames in a row that agree confirm a firmware variant
STANDSTILL_MPS: Final = 0.05  # wheels slower than this stand still
STATE_PERIOD_NS: Final = 50_000_000  # of `state`: 20 Hz
ODOMETRY_PERIOD_NS: Final = 20_000_000
BATCH_PERIOD_NS: Final = 50_000_000  # of batches of raw frames
BATCH_MAX_FRAMES: Final = 4096  # raw frames held for a batch; beyond it the oldest are dropped and counted
HEALTH_PERIOD_NS: Final = 1_000_000_000  # of `gateway/health`
RECONNECT_MIN_S: Final = 0.1  # first pause before a lost bus is opened again; it doubles up to RECONNECT_MAX_S
RECONNECT_MAX_S: Final = 0.5
ENGAGE_TIMEOUT_NS: Final = 1_000_000_000  # engaging fails if the chassis does not read auto by then
HOLD_NS: Final = 1_000_000_000  # a stop holds the robot with the parking brake for this long after its last motion
DISABLE_NS: Final = 500_000_000  # after the hold a stop sends disabled frames for 0.5 s, then nothing
REST_TIMEOUT_NS: Final = 10_000_000_000  # longest wait for rest at shutdown; a stop takes up to 7 s
NOT_SLOWING_NS: Final = 300_000_000  # a robot being stopped that does not slow down for this long is parked
SLOWING_MPS: Final = 0.02  # a robot slows down if its speed fell by this much
BRAKE_UNSEEN_NS: Final = 3_000_000_000  # a stop without parking feedback waits this long before it continues
SHIFT_TICKS: Final = 10  # each gear is commanded for 100 ms with the parking brake on before the next step
BRAKE_MAX_NS: Final = 1_000_000_000  # a robot that still moves this long after a zero speed command is parked
AUTO_HOLD_NS: Final = 1_000_000_000  # an engaged robot that stands this long at zero command is parked
WARN_AGAIN_NS: Final = 5_000_000_000  # after standing this long, a robot warns again before it sets off
BLINK_NS: Final = 350_000_000  # time that warning indicators are on, and then off
SLIPS_NS: Final = 2_000_000_000  # motion this soon after the auto-hold: the motor held it, not the parking brake
MOTOR_HOLDS_NS: Final = 300_000_000  # held by its motor, it must be no faster by then, or is parked for good
BRAKE_RETURNS: Final = 2  # after this many motions during disabled frames a stop does not disable any more
RETURN_NS: Final = 10_000_000_000  # motion this soon after the end of a stop counts as one of these
BRAKED_NS: Final = 5_000_000_000  # a stop that does not disable can be reset after standing braked for this long
STANDSTILL_TICKS: Final = 5  # the robot stands when its speed was under STANDSTILL_MPS for this many ticks, 50 ms
RESET_MIN_NS: Final = 500_000_000  # a reset this soon after a latch was not meant for it
LOOP_LATE_STOP_NS: Final = 100_000_000  # a tick that begins later than this stops the robot
IMPLAUSIBLE_MPS: Final = 0.3  # speeds that differ by more than this and ``IMPLAUSIBLE_RATIO`` do not fit
IMPLAUSIBLE_RATIO: Final = 1.5  # factor beyond which speeds do not fit, with ``IMPLAUSIBLE_MPS``
IMPLAUSIBLE_NS: Final = 300_000_000  # time for which speeds must differ by that much
REFERENCE_DECELERATION_MPS2: Final = 0.8  # rate at which the reference of a falling command falls: chassis lag
DRIVE_LAG_S: Final = 0.4  # longest lag of the chassis behind a falling command (chosen: no figure in the manual)
ROLLING_MPS: Final = 0.1  # a faster robot rolls: above the standstill bound and a noisy coarse bit
ROLLING_NS: Final = 100_000_000  # time of that speed while commanded to stand, or against the command
CREEPING_NS: Final = 1_000_000_000  # rolling too: over the standstill bound for this long, or wheel pulses
OVERSPEED_MPS: Final = 0.3  # a measured speed above the limit in force by this is too fast
OVERSPEED_NS: Final = 300_000_000  # time for which a speed must be too fast
NOT_MOVING_COMMAND_MPS: Final = 0.3  # commanded more than this, lag included, the robot must move
NOT_MOVING_MPS: Final = 0.15  # below this by drive feedback and wheels, the robot does not move
NOT_MOVING_NS: Final = 1_000_000_000  # time for which it must not move
GATHERING_MPS: Final = 0.06  # that time begins again when its speed rises by more than this
FROZEN_COMMAND_MPS: Final = 0.3  # speeds without a change in any bit are frozen if the command changes by more
FROZEN_NS: Final = 1_000_000_000  # time for which they must not change
FROZEN_STANDING_COMMAND_MPS: Final = 0.1  # commanded more, a robot whose pulses or mileage count does not stand
FROZEN_STANDING_KM: Final = 0.002  # change of the mileage that counts: 2 m
FROZEN_STILL_NS: Final = 200_000_000  # time for which one of these holds: wheel speeds come every 50 ms
FOLLOWING_MPS: Final = 0.5  # the commanded speed rises only while it is at most this much above the measured one
FOLLOWING_S: Final = 0.6  # or above the speed that the acceleration gives in this time, if that is more
RUNAWAY_RISE_MPS: Final = 0.08  # ``OVERSPEED_MPS`` over its command and faster by this (two bits), it runs away
RUNAWAY_WINDOW_NS: Final = 200_000_000  # time in which it became faster
RUNAWAY_NS: Final = 100_000_000  # time for which it must run away
STEERING_DEVIATION_DEG: Final = 5.0  # an angle further from the commanded one does not follow
STEERING_DEVIATION_NS: Final = 300_000_000  # time for which an angle must deviate
STEERING_FOLLOWS_DEGPS: Final = 30.0  # lowest rate of turning the wheels at which the steering follows
STEERING_LAG_S: Final = 0.2  # longest lag of the wheels behind the angle (chosen: no figure in the manual)
FROZEN_BODY_M: Final = 3.0  # mileage counts whole metres: unchanged after this distance, the body frame is frozen
BUMPER_CLEAR_NS: Final = 300_000_000  # a bumper is released once it has read clear for this long: contacts bounce
PULSES_MOVING_FRAMES: Final = 16  # wheel pulses in one direction in this many frames, 800 ms, show motion
PULSES_STEADY: Final = 0.9  # share of the first half of these pulses that the second half must reach
PULSES_REST_S: Final = 0.55  # time to come to rest before pulses show rolling: half of them, and three frames
CREEP_PULSES: Final = 40  # wheel pulses in one direction, a few in each frame, that show creeping
CREEP_FRAME_PULSES: Final = 2  # with more pulses in a period it does not creep: it drives, or comes to rest
CREEP_PAUSE_FRAMES: Final = 10  # after this many periods, 500 ms, without a wheel pulse the robot stands
CREEP_REST_NS: Final = 2_000_000_000  # time to come to rest before a few wheel pulses show creeping
SEND_FAILURES: Final = 5  # this many ticks in a row whose frames the bus did not accept are a failure
LEFT_BLIND_NS: Final = 200_000_000  # without body frames, a robot left under command is stopped after this
YIELD_BURSTS: Final = 10  # bursts of zero speed and parking brake when the remote control takes a robot
BEHIND_NS: Final = 200_000_000  # after this long without an empty buffer, frames come faster than they are read
FOUND_MOVING_NS: Final = 200_000_000  # an idle robot in auto that moves for this long is stopped
REPEATED_NS: Final = 1_000_000_000  # a stop from standby this soon after another applies the parking brake at once
COMMANDER_NS: Final = 100_000_000  # another computer's command frame counts for this long
COMMANDER_QUIET_NS: Final = 1_000_000_000
"""After a pause of this length another computer's commands are a new event. Shorter than WARM_UP_NS of a rerun, so
that a part of a run gives the same events."""

ODOMETER_TIMEOUT_NS: Final = 2_000_000_000  # clearing fails if the mileage does not read zero by then
TAIL_NS: Final = 100_000_000  # frames that clear lamps, horn or odometer are sent for this long
DRIVES_PER_TICK: Final = 16  # most drive commands judged in a tick; the rest wait in a ring buffer
VERBS_PER_TICK: Final = 8  # most verbs judged in a tick; the rest wait
STOPS_PER_TICK: Final = 16  # most remote stops judged in a tick; one is enough to stop, the others get replies too
MILEAGE_DIFFERS_KM: Final = 1.0  # further than this from the last run's, it may be another chassis's mileage
REQUEST_MAX_BYTES: Final = 1024  # of a request's payload
SEQUENCE_STEP_MAX: Final = 1000
"""Largest step of a drive command's ``seq``: more than the longest lease of 10 s sends at 50 Hz, so that no loss
exceeds it, and no client can use up the numbers."""

SAFETY_STATE_PERIOD_NS: Final = 50_000_000  # of `safety/state`, which is also published on change
SAFETY_STATE_ENGAGED_PERIOD_NS: Final = 20_000_000  # the same while engaged; half of it adds to a command's age
DEADMAN_MAX_S: Final = 1.0  # longest deadman of an engagement
GUARD_POLL_NS: Final = 5_000_000  # the guard checks the loop's heartbeat every 5 ms
TOLD_LONG_AGO_NS: Final = 100_000_000  # delayed longer, a stop continues from the measured speed, if lower
MUTE_FAILURES: Final = 20  # after this many ticks in a stop without a stop frame sent, the guard takes over
GUARD_LATE_NS: Final = 80_000_000
"""A heartbeat older than this, and still 5 ms later, is late: the guard stops the robot.

The first stop frame has to be on the bus within 100 ms of the last good one.
"""

GUARD_LOOK_NS: Final = 100_000_000  # a stop that begins or continues late waits this long for feedback
GUARD_RESTART_NS: Final = 5_000_000_000  # shortest time between two restarts of a lost guard, while idle
GUARD_HANGS_TICKS: Final = 100  # a guard without a sign of life in this many ticks is killed and restarted
REMOTE_FRAMES: Final = 2  # frames in a row that read remote before it counts: one may be two flipped bits
OFF_BURSTS: Final = 10  # a stop sets lamps, horn and odometer in its first 10 bursts, 100 ms: one may get lost
GUARD_SILENT_NS: Final = 200_000_000  # a guard without a sign of life, or feedback, for this long does not watch
GUARD_GIVES_UP_NS: Final = 30_000_000_000  # a guard without gateway and bus tries for this long
HALT_LISTEN_NS: Final = 300_000_000  # `cruiser halt` judges the chassis after this long without another sender
HALT_YIELD_NS: Final = 15_000_000_000  # `cruiser halt` waits this long for another sender, maybe the guard


class RobotSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The robot's name, and the root of its keys.

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
        bitrate: bit/s, for interfaces that set it; 0 leaves it unchanged. The manual gives none; 500000 is common
            for this family
        bus: the bus's name in keys: can/{bus}/rx
        raw_frames: receive all frames of the bus, and publish received and sent frames raw; else receive only the
            chassis's frames, and publish none raw
        options: further arguments of the python-can interface; for socketcan, only ``fd``
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
"""Feedback that the arbiter needs: `chassis.required_feedback` has to name these, and may name more."""

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
        required_feedback: feedback frames without which the robot is not commanded; braking (reserved, in the
            manual), wheel pulses, lamps and horn may be left out or added, the others are always needed
    """

    variant: Literal["auto", "coarse", "fine"] = "auto"
    required_feedback: list[FeedbackName] = msgspec.field(
        default_factory=lambda: [*NEEDED_FEEDBACK, "Auto_WheelPulseFeedback"]
    )


class ZenohSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The Zenoh session.

    Attributes:
        mode: mode of the session; if it is not set, commands and recorders that find a router become its clients,
            since a router forwards nothing between peers
        connect: endpoints to connect to; if empty, none for the gateway, tcp/127.0.0.1:7447 for every other
            command
        listen: endpoints to listen on; if empty, none for a gateway that connects elsewhere, else
            tcp/127.0.0.1:7447, or a free port of 127.0.0.1 if another Zenoh node uses that one
        command_listen: endpoints on which the gateway listens for commands; if empty, the addresses of `listen`,
            each with the next port
        config: a Zenoh configuration file (JSON5); the settings of this table that are set take precedence over it
        lease_ms: a link without a sign of life for this long is lost; the default is 5000 for `cruiser record
            --shard`
        profiles: INTERFACE=PROFILE, as wwan0=operator: the profile (full, operator or thin) of the gateway's links
            on this network interface, or * for all; see docs/operate.md
        given: not a setting: the names of those that a source set, also to their defaults
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
        listen_only: send nothing on the bus, whatever is requested
        accept_unguarded: allow engaging although no guard process can watch on this interface
        wait_for_bus: start without the bus and wait for it; else a missing bus is an error
        realtime_priority: SCHED_FIFO priority of the loop, where the system allows it; 0 is off
        state_dir: directory for what survives a restart: latched stops and the mileage; auto: $STATE_DIRECTORY,
            which systemd sets, else $XDG_STATE_HOME/cruiser, else ~/.local/state/cruiser; if empty, nothing is
            stored
    """

    listen_only: bool = False
    accept_unguarded: bool = False
    wait_for_bus: bool = False
    realtime_priority: Annotated[int, Meta(ge=0, le=99)] = 10
    state_dir: str = "auto"


class CommandSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The safety arbiter. At run time its limits can be lowered, never raised.

    Attributes:
        lease_s: s; a lease that is not renewed for this long expires
        deadman_s: s; without a valid drive command for this long, the robot is stopped
        max_age_s: s; a drive command that may be older, by its echo, is refused
        travel_delay_m: m; longest distance before the robot can react to its operator: its speed is at most this
            divided by the age of the commands plus the deadman
        view_delay_s: s; delay of the operator's video, which the gateway cannot measure; it is added to the age of
            the commands
        speed_limit_mps: m/s; highest speed, forward and in reverse; after a bumper hit at 2.2 m/s the robot needs
            1.5 m to stop, at 1 m/s 0.4 m
        speed_limit_without_realtime_mps: m/s; highest speed without a guard or without real-time priority
        acceleration_mps2: m/s2; highest acceleration
        deceleration_mps2: m/s2; deceleration of drive commands and of a controlled stop
        emergency_deceleration_mps2: m/s2; deceleration of a stop at once
        steering_limit_deg: deg; largest steering angle
        steering_rate_degps: deg/s; fastest change of the steering angle
        lateral_acceleration_mps2: m/s2; v^2 tan(angle) / wheelbase; the speed is reduced to stay below it
        idle_s: s; an engaged robot without a commanded speed for this long is disengaged; 0 is never
        warning_s: s; time that both indicators blink, at zero speed, after engaging and before the robot sets off
            after 5 s of standing; 0 is off
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
        mode: open: any client that reaches the gateway may command it, so it can be engaged only if it is
            reachable from this machine alone; signed: people and robots prove their identity with keys
        directory: directory of keys and grants, as made by 'cruiser provision'; auto: $XDG_CONFIG_HOME/cruiser,
            else ~/.config/cruiser
    """

    mode: Literal["open", "signed"] = "open"
    directory: str = "auto"


class DeskSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The desk: see docs/desk.md.

    Attributes:
        listen: ADDRESS:PORT for browsers; other than a loopback address needs a certificate
        certificate: certificate chain for browsers, PEM
        key: the certificate's private key, PEM
        names: further host names that browsers may use, besides those of this machine
        logs: a recorder's directory, whose logs and reports everyone who opens the page may read; empty: none
        viewers: addresses of web viewers, such as https://app.foxglove.dev/~/view, whose pages may read the logs
    """

    listen: str = "127.0.0.1:8080"
    certificate: str = ""
    key: str = ""
    names: list[str] = []
    logs: str = ""
    viewers: list[str] = []


ROS_DISTRIBUTIONS: Final = ("humble", "jazzy", "kilted", "lyrical")


class RosSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The ROS 2 graph: see docs/ros2.md.

    Attributes:
        connect: Zenoh endpoint of its router, rmw_zenohd
        distribution: ROS 2 distribution; humble has no type hashes
    """

    connect: str = "tcp/127.0.0.1:7447"
    distribution: Literal["humble", "jazzy", "kilted", "lyrical"] = "jazzy"


class SimSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The virtual chassis.

    Attributes:
        listen: HOST:PORT of the socketcand server
        variant: firmware variant to simulate
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
    ros: RosSettings = RosSettings()
    sim: SimSettings = SimSettings()
    authority: AuthoritySettings = AuthoritySettings()
