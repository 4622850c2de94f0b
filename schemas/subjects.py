"""The one table of subjects: key, type, origin, rate and quality of service.

Nothing else in the tree says how a subject is sent. The key table of the README is generated from here.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

import msgspec

from schemas import messages


class Priority(Enum):
    """Zenoh's priorities that are in use; the values are Zenoh's own names."""

    INTERACTIVE_HIGH = "INTERACTIVE_HIGH"
    DATA_HIGH = "DATA_HIGH"
    DATA = "DATA"
    DATA_LOW = "DATA_LOW"
    BACKGROUND = "BACKGROUND"


class Pattern(Enum):
    """How a subject is reached: by subscribing, or by a query."""

    PUBLISHED = "published"
    QUERIED = "queried"


class Qos(msgspec.Struct, frozen=True):
    """Quality of service. Congestion control is always drop: a blocked put would block the loop.

    Attributes:
        priority: Zenoh's priority.
        express: sent at once instead of batched with others.
    """

    priority: Priority
    express: bool = False


class Subject(msgspec.Struct, frozen=True):
    """A row of the table.

    Attributes:
        name: the part of the key after ``{root}/{robot}/``; ``{bus}`` stands for a CAN bus's name.
        type: the message class.
        about: what it is, for people.
        rate: how often, for people.
        qos: quality of service.
        dbc_message: the frame of the DBC that it decodes; empty if it decodes none.
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
        """The Zenoh encoding of its samples: ``application/msgpack;cruiser.Gear/1``."""
        return f"application/msgpack;{self.schema_name}/{self.type.version}"


SCHEMA_PREFIX: Final = "cruiser"

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
        "can/{bus}/rx",
        messages.CanFrames,
        "every frame received, raw, in batches; lossless, with receive times",
        "20 Hz",
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

LIVELINESS_CHUNK: Final = "gateway"
"""The liveliness token ``{root}/{robot}/gateway``: connected. Never proof of health."""

BY_NAME: Final = {subject.name: subject for subject in SUBJECTS}
BY_DBC_MESSAGE: Final = {subject.dbc_message: subject for subject in SUBJECTS if subject.dbc_message}
BY_TYPE: Final = {subject.type: subject for subject in SUBJECTS}
