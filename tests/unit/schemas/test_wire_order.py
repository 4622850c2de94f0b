"""A log holds a field and a member of an enumeration by its place: what logs of before hold keeps its place."""

from enum import Enum

import msgspec
import pytest

from schemas.decisions import ArbiterState, Bound, EventKind, SafetyState, StopPhase
from schemas.messages import Message
from schemas.reasons import Reason

ENUMERATIONS: dict[type[Enum], str] = {
    Reason: """
        none malformed too_large unknown_verb busy no_lease lease_held role_too_low lease_taken lease_released
        lease_expired sequence challenge_unknown too_old deadman not_engaged engaging already_engaged
        stopping moving parked gear_shifting command_not_zero not_confirmed disengaged bus_down bus_off
        bus_errors feedback_missing feedback_faulty feedback_late variant_unknown hand_transmitter
        mode_not_auto front_bumper rear_bumper implausible_speed found_moving other_commander remote_stop
        loop_late send_failed gate guard unguarded shutdown
    """,
    StopPhase: "idle ramp brake neutral hold disable",
    ArbiterState: "standby engaging engaged stopping",
    EventKind: "lease engaged stop stopped latch reset takeover fault guard",
    Bound: """
        speed acceleration deceleration steering steering_rate lateral_acceleration reversal bumper gear parking
    """,
}

FIELDS: dict[type[Message], str] = {
    SafetyState: """
        time_ns sequence tick state engaged stop_reason stop_phase lease_holder lease_role lease_expires_s latched
        blocked_by guarded speed_limit_mps acceleration_limit_mps2 deceleration_limit_mps2
        emergency_deceleration_mps2 steering_limit_deg steering_rate_limit_degps
        lateral_acceleration_limit_mps2 target_speed_mps target_angle_deg output_speed_mps
        output_angle_deg output_gear brake_pedal_percent parking
    """,
}


@pytest.mark.parametrize("kind", ENUMERATIONS, ids=lambda kind: kind.__name__)
def test_members_keep_their_places(kind: type[Enum]) -> None:
    """New ones come after them."""
    before = ENUMERATIONS[kind].split()
    assert [member.value for member in kind][: len(before)] == before


@pytest.mark.parametrize("kind", FIELDS, ids=lambda kind: kind.__name__)
def test_fields_keep_their_places(kind: type[Message]) -> None:
    """New ones come after them."""
    before = FIELDS[kind].split()
    assert [field.name for field in msgspec.structs.fields(kind)][: len(before)] == before
