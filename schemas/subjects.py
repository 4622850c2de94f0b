"""The table of subjects: key, type, rate and quality of service; and that of the verbs.

The tables in docs/messages.md and docs/commands.md are generated from here.
"""

from __future__ import annotations

from enum import Enum
from typing import Any, Final, Generic, TypeVar

import msgspec

from schemas import decisions, messages, recording, requests


class Priority(Enum):
    """Zenoh's priorities that are in use, by Zenoh's names."""

    INTERACTIVE_HIGH = "INTERACTIVE_HIGH"
    DATA_HIGH = "DATA_HIGH"
    DATA = "DATA"
    DATA_LOW = "DATA_LOW"
    BACKGROUND = "BACKGROUND"


class Pattern(Enum):
    """The way to read a subject."""

    PUBLISHED = "published"
    QUERIED = "queried"


class Asking(Enum):
    """The way to send a verb to a robot: a query, whose reply has the result, or a put."""

    QUERY = "query"
    PUT = "put"
    EITHER = "query or put"


class Qos(msgspec.Struct, frozen=True):
    """Quality of service. Congestion control is always drop: a blocked put would block the loop.

    Attributes:
        express: sent at once, not batched with others.
        history: number of last samples that a late joiner receives.
        kept_bytes: bytes of its newest samples that are stored for queries on the key: see ``KEPT_FIRST``.
    """

    priority: Priority
    express: bool = False
    history: int = 0
    kept_bytes: int = 0


class Subject(msgspec.Struct, frozen=True):
    """A row of the table.

    Attributes:
        name: the part of the key after ``{root}/{robot}/``; ``{bus}`` stands for a CAN bus's name.
        about: description for the documents.
        rate: rate of samples for the documents.
        dbc_message: name of the DBC frame that it decodes; empty if there is none.
    """

    name: str
    type: type[messages.Message]
    about: str
    rate: str
    qos: Qos
    dbc_message: str = ""
    pattern: Pattern = Pattern.PUBLISHED

    @property
    def schema_name(self) -> str:
        """The schema's name, as in the Zenoh encoding and in MCAP: ``cruiser.Gear``."""
        return f"{SCHEMA_PREFIX}.{self.type.__name__}"

    @property
    def encoding(self) -> str:
        return f"application/msgpack;{self.schema_name}/{self.type.version}"


SCHEMA_PREFIX: Final = "cruiser"

SAFETY_HISTORY: Final = 1000
"""Decisions and events for late joiners and after a lost link. They are sent at once and have to fit into a link's
queue; older ones are available by query, see ``KEPT_FIRST``."""

SAFETY_KEPT_BYTES: Final = 2_000_000  # some 5,000 decisions
JOURNAL_KEPT_BYTES: Final = 16_000_000  # ten minutes at a bus's nominal load, one minute at full load
AUTHORITY_KEPT_BYTES: Final = 1_000_000  # statements of an hour, including those in use

KEPT_FIRST: Final = "first"
"""A query ``{key}?first=N`` for stored samples returns those from sequence N on, or from the oldest."""

KEPT_PIECE: Final = 16  # most samples that such a query returns, each in its own reply; without N it returns none

_FEEDBACK: Final = Qos(Priority.DATA)


def _chassis(name: str, kind: type[messages.Feedback], dbc_message: str, rate: str, about: str) -> Subject:
    return Subject(f"chassis/{name}", kind, about, rate, _FEEDBACK, dbc_message)


SUBJECTS: Final[tuple[Subject, ...]] = (
    _chassis("gear", messages.Gear, "Auto_GearFeedBack", "100 Hz", "gear in force"),
    _chassis("steering", messages.Steering, "Auto_SteeringFeedBack", "100 Hz", "steering angle, left positive"),
    _chassis("drive", messages.Drive, "Auto_DriveFeedBack", "100 Hz", "speed, a magnitude"),
    _chassis("braking", messages.Braking, "Auto_BrakingFeedBack", "100 Hz", "service brake"),
    _chassis("parking", messages.Parking, "Auto_ParkingFeedBack", "100 Hz", "parking brake"),
    _chassis("wheel_speed", messages.WheelSpeed, "Auto_WheelSpdFeedback", "20 Hz", "rear wheel speeds, signed"),
    _chassis("wheel_pulse", messages.WheelPulse, "Auto_WheelPulseFeedback", "20 Hz", "rear wheel encoder counts"),
    _chassis("body", messages.Body, "Auto_MileageAndBodyFeedback", "50 Hz", "mileage, bumpers, mode"),
    _chassis("light", messages.Light, "Auto_LightFeedback", "20 Hz", "headlamp and indicators"),
    _chassis("speaker", messages.Speaker, "Auto_SpeakerFeedback", "20 Hz", "horn"),
    Subject(
        "chassis/odometry",
        messages.Odometry,
        "pose, distance and speeds from drive and steering feedback, with growing variances",
        "50 Hz while the speed is known",
        _FEEDBACK,
    ),
    Subject(
        "can/{bus}/rx",
        messages.CanFrames,
        "every received frame, raw, in batches, with receive times",
        "20 Hz",
        Qos(Priority.DATA_LOW),
    ),
    Subject(
        "can/{bus}/tx",
        messages.CanFrames,
        "every sent frame, raw, in batches",
        "20 Hz while there are any",
        Qos(Priority.DATA_LOW),
    ),
    Subject(
        "state",
        messages.RobotState,
        "the whole robot in one message, for thin links and for people",
        "20 Hz",
        Qos(Priority.DATA_HIGH),
    ),
    Subject(
        "safety/state",
        decisions.SafetyState,
        "the arbiter: holder of the lease, limits in force, challenge to echo, why the robot stands still",
        "20 Hz, 50 Hz while engaged, and on change",
        Qos(Priority.INTERACTIVE_HIGH, express=True, history=1),
    ),
    Subject(
        "safety/decision",
        decisions.Decision,
        "every decision: request, verdict, reason, frames sent",
        "each",
        Qos(Priority.DATA_HIGH, history=SAFETY_HISTORY, kept_bytes=SAFETY_KEPT_BYTES),
    ),
    Subject(
        "safety/event",
        decisions.SafetyEvent,
        "events for people: stops, latches, faults, takeovers",
        "each",
        Qos(Priority.DATA_HIGH, history=SAFETY_HISTORY, kept_bytes=SAFETY_KEPT_BYTES),
    ),
    Subject(
        "journal",
        decisions.Journal,
        "all inputs of the core, in order: enough to rerun it",
        "20 Hz",
        Qos(Priority.DATA_LOW, kept_bytes=JOURNAL_KEPT_BYTES),
    ),
    Subject(
        "authority/statement",
        decisions.SignedStatement,
        "grants and revocations that the robot accepted, with their signatures; only in signed mode",
        "each, and those in use every minute",
        Qos(Priority.DATA_LOW, history=64, kept_bytes=AUTHORITY_KEPT_BYTES),
    ),
    Subject(
        "gateway/health",
        messages.GatewayHealth,
        "frame rates, losses, faults by kind, bus and Zenoh connection, loop lateness",
        "1 Hz",
        Qos(Priority.BACKGROUND),
    ),
    Subject(
        "gateway/info",
        messages.GatewayInfo,
        "versions, variant, configuration, DBC, schemas",
        "on query",
        Qos(Priority.DATA),
        pattern=Pattern.QUERIED,
    ),
)

LIVELINESS_CHUNK: Final = "gateway"  # the token ``{root}/{robot}/gateway``: connected, which is no proof of health
RECORDER_CHUNK: Final = "@recorder"  # verbatim chunk in a recorder's keys, ``{root}/@recorder/{recorder}``

RECORDER_SUBJECTS: Final[tuple[Subject, ...]] = (
    Subject(
        "health",
        recording.RecorderHealth,
        "the recorder's state, what it received and lost, its disk",
        "1 Hz",
        Qos(Priority.BACKGROUND),
    ),
    Subject(
        "event",
        recording.RecorderEvent,
        "events for people: incidents, a full disk, deleted logs",
        "each",
        Qos(Priority.DATA_HIGH),
    ),
    Subject(
        "gap",
        recording.RecordGap,
        "messages of a key that the recorder received and that are not in its log",
        "each",
        Qos(Priority.DATA_LOW),
    ),
)

ALL_SUBJECTS: Final = SUBJECTS + RECORDER_SUBJECTS

BY_NAME: Final = {subject.name: subject for subject in SUBJECTS}
BY_DBC_MESSAGE: Final = {subject.dbc_message: subject for subject in SUBJECTS if subject.dbc_message}
BY_TYPE: Final = {subject.type: subject for subject in reversed(ALL_SUBJECTS)}
"""A type's first subject: for CanFrames, that of received frames."""


ReplyType = TypeVar("ReplyType", bound=decisions.Reply | recording.RecorderReply)


class Verb(msgspec.Struct, Generic[ReplyType], frozen=True):
    """A row of a command table: a request that a robot or a recorder accepts.

    Attributes:
        verb: the last chunk of the key ``{root}/{robot}/@cmd/{operator}/{verb}``.
        about: its effect, for the documents.
        engaged_only: refused while the robot is not engaged.
    """

    verb: str
    request: type[requests.Request]
    reply: type[ReplyType]
    about: str
    asking: Asking = Asking.QUERY
    engaged_only: bool = False

    @property
    def schema_name(self) -> str:
        return f"{SCHEMA_PREFIX}.request.{self.request.__name__}"

    @property
    def encoding(self) -> str:
        return f"application/msgpack;{self.schema_name}/{self.request.version}"

    @property
    def reply_schema_name(self) -> str:
        return f"{SCHEMA_PREFIX}.{self.reply.__name__}"

    @property
    def reply_encoding(self) -> str:
        return f"application/msgpack;{self.reply_schema_name}/{self.reply.version}"


Command = Verb[decisions.Reply]  # a verb of a robot
RecorderCommand = Verb[recording.RecorderReply]  # a verb of a recorder, always a query
COMMAND_CHUNK: Final = "@cmd"  # verbatim chunk: no wildcard matches a command by accident
AUTHORITY_CHUNK: Final = "@auth"  # verbatim chunk of the query ``{root}/{robot}/@auth`` with a statement
STATEMENT_REPLY: Final = f"{SCHEMA_PREFIX}.{decisions.StatementReply.__name__}"
STATEMENT_REPLY_ENCODING: Final = f"application/msgpack;{STATEMENT_REPLY}/{decisions.StatementReply.version}"

TEXT_MAX_BYTES: Final = 16_384  # of a statement
SIGNED: Final = ("safety/state", "state")  # subjects whose samples are signed in signed mode

STOP_VERB: Final = "stop"
RESET_ODOMETRY_VERB: Final = "reset_odometry"
DRIVE_VERB: Final = "drive"

COMMAND_QOS: Final = Qos(Priority.INTERACTIVE_HIGH, express=True)

_Reply, _LeaseReply = decisions.Reply, decisions.LeaseReply

COMMANDS: Final[tuple[Command, ...]] = (
    Command("acquire", requests.Acquire, _LeaseReply, "get the lease, if it is free"),
    Command("renew", requests.Renew, _LeaseReply, "extend the lease, as driving does"),
    Command("release", requests.Release, _Reply, "give the lease back; an engaged robot is stopped"),
    Command(
        "take",
        requests.Take,
        _LeaseReply,
        "get the lease from a holder of no higher role; while the robot moves, only with `override`; an engaged "
        "robot is stopped",
    ),
    Command(
        "engage",
        requests.Engage,
        _Reply,
        "take command of the standing chassis; the reply comes when it reads auto",
    ),
    Command("disengage", requests.Disengage, _Reply, "stop in a controlled way and give up command"),
    Command(STOP_VERB, requests.Stop, _Reply, "the remote stop, for every client; latched", Asking.EITHER),
    Command("reset", requests.Reset, _Reply, "clear latched stops"),
    Command("park", requests.Park, _Reply, "apply the parking brake, at any speed", engaged_only=True),
    Command(
        "unpark", requests.Unpark, _Reply, "allow drive commands to release the parking brake", engaged_only=True
    ),
    Command("light", requests.Light, _Reply, "set headlamp and indicators", engaged_only=True),
    Command("horn", requests.Horn, _Reply, "switch the horn", engaged_only=True),
    Command(
        "clear_odometer",
        requests.ClearOdometer,
        _Reply,
        "set the total mileage to zero; the reply comes when it reads zero",
        engaged_only=True,
    ),
    Command(RESET_ODOMETRY_VERB, requests.ResetOdometry, _Reply, "set the pose of `chassis/odometry` to zero"),
    Command(DRIVE_VERB, requests.Drive, _Reply, "the stream that moves the robot, 10 to 50 Hz", Asking.PUT),
)

BY_VERB: Final = {command.verb: command for command in COMMANDS}

_RecorderReply = recording.RecorderReply

RECORDER_COMMANDS: Final[tuple[RecorderCommand, ...]] = (
    RecorderCommand("status", recording.Status, _RecorderReply, "get the recorder's health"),
    RecorderCommand("mark", recording.Mark, _RecorderReply, "record the time around now as an incident"),
)

ALL_VERBS: Final[tuple[Verb[Any], ...]] = (*COMMANDS, *RECORDER_COMMANDS)

RECORDER_BY_VERB: Final = {command.verb: command for command in RECORDER_COMMANDS}
