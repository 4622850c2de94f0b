"""The classes that a checkpoint can hold, under the names that it has for them.

Every log has these names in it. Classes and attributes can be moved and renamed in the code; here an alias and the
name of an attribute stay as they are. An alias is what the class was called when it was first in a checkpoint.
"""

from __future__ import annotations

from typing import Final

from gateway.chassis.cruiser.gate_table import MotionBurst
from gateway.chassis.cruiser.variant import StandstillEvidence, VariantDetector
from gateway.chassis.faults import FaultKind
from gateway.chassis.frame import Frame
from gateway.chassis.supervision import AliveCounter, FaultWindow, FrameSupervisor, Period
from gateway.command.actuation import Actuation
from gateway.command.arbiter import Arbiter
from gateway.command.auxiliary import Auxiliary, AuxiliaryFrame
from gateway.command.chassis_monitor import ChassisMonitor
from gateway.command.chassis_state import ChassisState
from gateway.command.engagement import Engagement
from gateway.command.flow import CommandFlow
from gateway.command.frames import FrameMaker
from gateway.command.freshness import ChallengeLog
from gateway.command.gate import Gate
from gateway.command.handover import Handover
from gateway.command.latches import Latches
from gateway.command.lease import HeldLease, Leases
from gateway.command.limits import MotionLimits
from gateway.command.link_age import LinkAge
from gateway.command.motion import MotionProfile, Target
from gateway.command.notices import Notices
from gateway.command.operator_link import OperatorLink
from gateway.command.outbox import Outbox
from gateway.command.outcome import Event, TickOutcome
from gateway.command.output import Output
from gateway.command.plausibility import Envelope, Plausibility, Stillness
from gateway.command.report import Reporter
from gateway.command.request import Credentials, Judged, RawRequest, Ruling, VerbAnswer
from gateway.command.setpoint import Setpoint
from gateway.command.standing import Standing
from gateway.command.stop import StopSequence
from gateway.command.verbs import Verbs
from gateway.telemetry.chassis_tracker import ChassisTracker, Encoders
from gateway.telemetry.feedback import FeedbackStream
from gateway.telemetry.health import HealthMeter, Links
from gateway.telemetry.raw_frames import FrameBatch
from schemas.can_word import UnseenRounds
from schemas.decisions import ArbiterState, Bound, EventKind, Severity, StopPhase
from schemas.messages import (
    Body,
    Braking,
    BrakingStatus,
    ControllerState,
    Drive,
    Gear,
    GearPosition,
    Light,
    Mode,
    Parking,
    ParkingStatus,
    Speaker,
    Steering,
    Variant,
    WheelPulse,
    WheelSpeed,
)
from schemas.reasons import Reason
from schemas.requests import Role

CLASSES: Final[dict[str, type]] = {
    "Actuation": Actuation,
    "AliveCounter": AliveCounter,
    "Arbiter": Arbiter,
    "ArbiterState": ArbiterState,
    "Auxiliary": Auxiliary,
    "AuxiliaryFrame": AuxiliaryFrame,
    "Body": Body,
    "Bound": Bound,
    "Braking": Braking,
    "BrakingStatus": BrakingStatus,
    "ChallengeLog": ChallengeLog,
    "ChassisMonitor": ChassisMonitor,
    "ChassisState": ChassisState,
    "ChassisTracker": ChassisTracker,
    "CommandFlow": CommandFlow,
    "ControllerState": ControllerState,
    "Credentials": Credentials,
    "Drive": Drive,
    "Encoders": Encoders,
    "Engagement": Engagement,
    "Envelope": Envelope,
    "Event": Event,
    "EventKind": EventKind,
    "FaultKind": FaultKind,
    "FaultWindow": FaultWindow,
    "FeedbackStream": FeedbackStream,
    "Frame": Frame,
    "FrameBatch": FrameBatch,
    "FrameMaker": FrameMaker,
    "FrameSupervisor": FrameSupervisor,
    "Gate": Gate,
    "Gear": Gear,
    "GearPosition": GearPosition,
    "Handover": Handover,
    "HealthMeter": HealthMeter,
    "HeldLease": HeldLease,
    "Judged": Judged,
    "Latches": Latches,
    "Leases": Leases,
    "Light": Light,
    "LinkAge": LinkAge,
    "Links": Links,
    "Mode": Mode,
    "MotionBurst": MotionBurst,
    "MotionLimits": MotionLimits,
    "MotionProfile": MotionProfile,
    "Notices": Notices,
    "OperatorLink": OperatorLink,
    "Outbox": Outbox,
    "Output": Output,
    "Parking": Parking,
    "ParkingStatus": ParkingStatus,
    "Period": Period,
    "Plausibility": Plausibility,
    "RawRequest": RawRequest,
    "Reason": Reason,
    "Reporter": Reporter,
    "Role": Role,
    "Ruling": Ruling,
    "Setpoint": Setpoint,
    "Severity": Severity,
    "Speaker": Speaker,
    "Standing": Standing,
    "StandstillEvidence": StandstillEvidence,
    "Steering": Steering,
    "Stillness": Stillness,
    "StopPhase": StopPhase,
    "StopSequence": StopSequence,
    "Target": Target,
    "TickOutcome": TickOutcome,
    "UnseenRounds": UnseenRounds,
    "Variant": Variant,
    "VariantDetector": VariantDetector,
    "VerbAnswer": VerbAnswer,
    "Verbs": Verbs,
    "WheelPulse": WheelPulse,
    "WheelSpeed": WheelSpeed,
}
"""No other class is ever made from a checkpoint. What else a core refers to is left out: a new core has it."""

RENAMED: Final[dict[str, dict[str, str]]] = {}
"""By alias: attributes that were renamed, and what checkpoints call them."""
