"""What two successive messages tell: two states of the arbiter, two healths of the gateway."""

from typing import Any

import msgspec
import pytest

from recorder.review.entries import FAILURES_IN_WORDS, EntryKind, changes, risen
from schemas.decisions import ArbiterState, Severity
from schemas.messages import ControllerState, FrameHealth, GatewayHealth, Variant
from schemas.reasons import TEXTS, Reason
from schemas.requests import Role
from tests.support.messages import HEALTH
from tests.unit.recorder.review.test_events import state

NOBODY: dict[str, Any] = {"lease_holder": ""}
ONE: dict[str, Any] = {"lease_holder": "operator-1", "lease_role": Role.OPERATOR}
TWO: dict[str, Any] = {"lease_holder": "operator-2", "lease_role": Role.SUPERVISOR}
ENGAGED: dict[str, Any] = {"state": ArbiterState.ENGAGED}
BOTH: dict[str, Any] = {"latched": [Reason.GATE, Reason.FRONT_BUMPER]}
NONE = Reason.NONE


def rest(reason: Reason) -> dict[str, Any]:
    """Standing by, after a stop for this reason."""
    return {"state": ArbiterState.STANDBY, "stop_reason": reason}


def means(reason: Reason) -> str:
    """In words."""
    return TEXTS[reason].means


STATES: list[tuple[dict[str, Any], dict[str, Any], list[tuple[EntryKind, Reason, str]]]] = [
    ({"output_speed_mps": 0.1}, {"output_speed_mps": 0.2}, []),
    (NOBODY, ONE, [(EntryKind.LEASE, NONE, "operator-1 holds the lease as operator")]),
    (ONE, NOBODY, [(EntryKind.LEASE, NONE, "operator-1 no longer holds the lease")]),
    (ONE, TWO, [(EntryKind.LEASE, NONE, "operator-2 holds the lease as supervisor, operator-1 before")]),
    (
        ENGAGED,
        rest(Reason.DEADMAN),
        [
            (EntryKind.STOP, Reason.DEADMAN, f"stopping: {means(Reason.DEADMAN)}"),
            (EntryKind.STOPPED, Reason.DEADMAN, "stopped: no commands sent"),
        ],
    ),
    *(
        (ENGAGED, rest(reason), [(kind, reason, f"no commands sent any more: {means(reason)}")])
        for reason, kind in ((Reason.HAND_TRANSMITTER, EntryKind.TAKEOVER), (Reason.GUARD, EntryKind.GUARD))
    ),
    (
        {},
        BOTH,
        [
            (EntryKind.LATCH, reason, f"latched until a reset: {means(reason)}")
            for reason in (Reason.GATE, Reason.FRONT_BUMPER)
        ],
    ),
    (BOTH, {}, [(EntryKind.RESET, NONE, "reset: gate, front_bumper")]),
    ({"guarded": True}, {"guarded": False}, [(EntryKind.GUARD, NONE, "the guard is gone")]),
    ({"guarded": False}, {"guarded": True}, [(EntryKind.GUARD, NONE, "a guard watches the gateway")]),
]


@pytest.mark.parametrize(("before", "now", "told"), STATES)
def test_two_states_tell_what_changed_between_them(
    before: dict[str, Any], now: dict[str, Any], told: list[tuple[EntryKind, Reason, str]]
) -> None:
    """Leases, latches, the guard and the arbiter; whatever else changes tells nothing."""
    found = changes(state(0, 0, **before), state(5, 1, **now))
    assert [(one.kind, one.reason, one.text) for one in found] == told


def test_a_hole_between_two_states_is_told() -> None:
    """When it was is not known any better."""
    (change,) = changes(state(0, 0), state(300, 9, latched=[Reason.GATE]))
    assert change.text.endswith("(within 3.0 s without a state in the log)")


FRAME = msgspec.structs.replace(HEALTH.feedback[0], valid=50)
WELL = msgspec.structs.replace(HEALTH, faults={}, feedback=[FRAME])
NAMES = ("Auto_GearFeedBack", "Auto_DriveFeedBack")


def health(**changes: object) -> GatewayHealth:
    """A health that is well, but for this."""
    return msgspec.structs.replace(WELL, **changes)


def frame(**changes: object) -> list[FrameHealth]:
    """The feedback, with this changed."""
    return [msgspec.structs.replace(FRAME, **changes)]


def frames(**changes: object) -> list[FrameHealth]:
    """Two frames, both with this changed."""
    return [msgspec.structs.replace(FRAME, name=name, **changes) for name in NAMES]


ILL = health(
    faults={"checksum": 7}, feedback=frame(failures=["checksum"], checksum_faults=7), bus_losses=3, bus_up=False
)
SILENT = health(feedback=frames(failures=["silence"]), faults={"silence": 2})

Told = tuple[str, int, tuple[str, ...], bool, Severity]


def new(text: str, count: int = 1, about: tuple[str, ...] = (), severity: Severity = Severity.WARNING) -> Told:
    """A fault."""
    return text, count, about, False, severity


def over(text: str, count: int = 1, about: tuple[str, ...] = (), severity: Severity = Severity.INFO) -> Told:
    """What is known to be over."""
    return text, count, about, True, severity


THIS = (FRAME.name,)

HEALTHS: list[tuple[GatewayHealth | None, GatewayHealth, list[Told]]] = [
    (ILL, ILL, []),
    (None, WELL, []),
    (WELL, health(faults={"silence": 2}), [new("frames stayed away", 2)]),
    (WELL, health(faults={"period": 5}), [new("frames came irregularly", 5)]),
    (WELL, health(feedback=frame(checksum_faults=3)), [new("frames with a wrong checksum", 3, THIS)]),
    (WELL, health(feedback=frame(failures=["silence"])), [new("silent", 1, THIS)]),
    (WELL, health(bus_losses=1), [new("the CAN bus was lost")]),
    (WELL, health(bus_drops=9), [new("frames were dropped: not read in time, or garbled", 9)]),
    (WELL, health(publish_failures=4), [new("Zenoh did not take samples", 4)]),
    (WELL, health(inbox_drops=5), [new("requests were dropped unread: too many came", 5)]),
    (
        WELL,
        health(bus_up=False, bus_detail="no such device"),
        [new("the CAN bus can0 is not there: no such device", severity=Severity.ERROR)],
    ),
    (
        WELL,
        health(controller=ControllerState.PASSIVE),
        [new("the CAN controller: unknown before, passive now")],
    ),
    (WELL, health(variant=Variant.FINE), [over("the firmware variant: coarse before, fine now")]),
    (health(bus_up=False), WELL, [over("the CAN bus can0 is back")]),
    (health(feedback=frame(failures=["period"])), WELL, [over("no longer at fault (period)", 1, THIS)]),
    # Counts of before a log's beginning are none of its.
    (
        None,
        ILL,
        [new("the CAN bus can0 is not there", severity=Severity.ERROR), new("checksums fail", 1, THIS)],
    ),
    # The sum over all frames is left out where a frame tells.
    (
        WELL,
        health(faults={"checksum": 3, "length": 1}, feedback=frame(checksum_faults=3)),
        [new("frames with a wrong checksum", 3, THIS), new("faults of frames: length")],
    ),
    (health(feedback=frames()), SILENT, [new("silent", 2, NAMES)]),
    # What was only late is counted once it has come, and so may have been lost long before.
    (
        SILENT,
        health(feedback=frames(lost=50), faults={"silence": 2}),
        [over("no longer at fault (silence)", 2, NAMES), over("missing frames", 100, NAMES, Severity.WARNING)],
    ),
]


@pytest.mark.parametrize(("before", "now", "told"), HEALTHS)
def test_two_healths_tell_what_went_wrong_between_them(
    before: GatewayHealth | None, now: GatewayHealth, told: list[Told]
) -> None:
    """Once, with its count and the frames that it is about, and nothing else."""
    found = risen(before, now)
    assert [(one.text, one.count, one.about, one.is_end, one.severity) for one in found] == told


def test_every_failure_has_words() -> None:
    """Those of the supervision."""
    assert set(FAILURES_IN_WORDS) == {"checksum", "implausible", "alive_counter", "period", "silence"}
