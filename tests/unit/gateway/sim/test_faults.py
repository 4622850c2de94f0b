"""The words of the faults."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.frame import ERROR, EXTENDED
from gateway.sim.disturbances import (
    GRAMMAR,
    ChassisFault,
    Contact,
    FaultLine,
    FaultTextError,
    Foreign,
    ScheduledFault,
    Sticks,
    parse,
    parse_scheduled,
)
from schemas.messages import Variant

S = 1_000_000_000
GEAR = "Auto_GearFeedBack"
STRANGE = 0x18C4D6EF | EXTENDED

RIGHT = {
    f"silence {GEAR} for 2s": FaultLine(ChassisFault("silence", (GEAR,)), 2 * S),
    "checksum auto_gearfeedback": FaultLine(ChassisFault("checksum", (GEAR,))),
    f"stuck {GEAR} for 3 frames": FaultLine(ChassisFault("stuck", (GEAR,)), 0, 3),
    f"skip {GEAR}": FaultLine(ChassisFault("skip", (GEAR,), 2)),
    "skip all by 5 for 500ms": FaultLine(ChassisFault("skip", ("all",), 5), S // 2),
    "drop all every 10 for 1min": FaultLine(ChassisFault("drop", ("all",), 10), 60 * S),
    f"drop {GEAR} next 4": FaultLine(ChassisFault("drop", (GEAR,)), 0, 4),
    "silence all off": FaultLine(ChassisFault("silence", ("all",), ended=True)),
    f"freeze {GEAR} for 3 frames": FaultLine(ChassisFault("freeze", (GEAR,)), 0, 3),
    "foreign 123": FaultLine(ChassisFault("foreign", (0x123,), Foreign(0x123))),
    "foreign 0x18C4D6EF 00ff every 1.5s": FaultLine(
        ChassisFault("foreign", (STRANGE,), Foreign(STRANGE, b"\x00\xff", 3 * S // 2))
    ),
    "foreign 7ff error": FaultLine(ChassisFault("foreign", (0x7FF,), Foreign(0x7FF | ERROR))),
    "foreign 200 off": FaultLine(ChassisFault("foreign", (0x200,), ended=True)),
    "bumper front on": FaultLine(ChassisFault("bumper", ("front",), Contact(hit=True))),
    "Bumper BOTH off": FaultLine(ChassisFault("bumper", ("front", "rear"), Contact(hit=False), ended=True)),
    "bumper rear on bounce for 2s": FaultLine(
        ChassisFault("bumper", ("rear",), Contact(hit=True, bounces=True)), 2 * S
    ),
    "bumper rear off bounce": FaultLine(ChassisFault("bumper", ("rear",), Contact(hit=False, bounces=True))),
    "transmitter remote": FaultLine(ChassisFault("transmitter")),
    "transmitter command": FaultLine(ChassisFault("transmitter", ended=True)),
    "sticks -0.5 +10": FaultLine(ChassisFault("sticks", value=Sticks(-0.5, 10.0))),
    "scale wrong": FaultLine(ChassisFault("scale")),
    "scale right": FaultLine(ChassisFault("scale", ended=True)),
    "variant fine": FaultLine(ChassisFault("variant", value=Variant.FINE)),
    "slope -30 for 2s": FaultLine(ChassisFault("condition", ("slope_deg",), -30.0), 2 * S),
    "payload 100": FaultLine(ChassisFault("condition", ("payload_kg",), 100.0)),
    "pedal 0.3": FaultLine(ChassisFault("condition", ("pedal_gain",), 0.3)),
    "motor 0.5": FaultLine(ChassisFault("condition", ("motor_strength",), 0.5)),
    "brake 0.2": FaultLine(ChassisFault("condition", ("parking_grip",), 0.2)),
    "reboot": FaultLine(ChassisFault("reboot")),
    "reboot for 3s": FaultLine(ChassisFault("reboot"), 3 * S),
    "clear": FaultLine(ChassisFault("clear")),
}

WRONG = {
    "": "a fault",
    "bumpr front on": "did you mean 'bumper'?",
    "bumper frot on": "did you mean 'front'?",
    "bumper front": "'on' or 'off'",
    "silence": "a message",
    "silence Auto_GearFeedbak": f"did you mean '{GEAR}'?",
    "silence Auto_GearCmd": "did you mean",
    "silence zzz": "there are: Auto_GearFeedBack, Auto_SteeringFeedBack, ",
    f"silence {GEAR} for ever": "no duration",
    f"silence {GEAR} for 0s": "no time",
    f"silence {GEAR} for": "a duration",
    f"silence {GEAR} for 2s now": "'now' is more",
    f"silence {GEAR} off for 2s": "no duration",
    "bumper front off for 2s": "no duration",
    "clear for 2s": "no duration",
    f"drop {GEAR}": "'every' or 'next'",
    f"drop {GEAR} every 0": "whole number",
    f"skip {GEAR} by x": "whole number",
    "foreign 800": "identifier",
    "foreign 20000000": "identifier",
    "foreign 1234": "identifier",
    "foreign 123 xyz": "hex digits",
    "foreign 123 001122334455667788": "hex digits",
    "sticks 1": "angle",
    "sticks nan 0": "no number",
    "slope": "a number from -30 to 30",
    "slope 30.1": "'30.1' is not from -30 to 30",
    "slope steep": "no number",
    "payload -1": "not from 0 to 100",
    "pedal 1.1": "not from 0 to 1",
    "motor 2": "not from 0 to 1",
    "bumper front on bouncing": "'bouncing' is more",
    "variant medium": "there are: coarse, fine",
    "transmitter remoto": "did you mean 'remote'?",
}


@pytest.mark.parametrize(("text", "line"), RIGHT.items())
def test_a_line_says_what_it_says(text: str, line: FaultLine) -> None:
    """Each form of the grammar has its value; letter case does not matter."""
    assert parse(text) == line


@pytest.mark.parametrize(("text", "hint"), WRONG.items())
def test_a_wrong_line_names_the_word_and_the_cure(text: str, hint: str) -> None:
    """The reason says what is wrong, and the nearest right word."""
    error = parse(text)
    assert isinstance(error, FaultTextError)
    assert hint in error.reason or hint in error.reason.lower()


@given(st.text() | st.lists(st.sampled_from([*" ".join([*RIGHT, *WRONG]).split(), "é", "\ud800"])).map(" ".join))
def test_no_text_raises(text: str) -> None:
    """Faults come from the network too: any text is a fault or an error of one bounded line."""
    outcome = parse(text)
    if isinstance(outcome, FaultTextError):
        assert outcome.reason
        assert len(outcome.reason) < 500
        assert "\n" not in outcome.reason
    parse_scheduled(text)


def test_the_help_names_every_fault() -> None:
    """What can be asked for is in the grammar that people see, and the other way round."""
    shown = set(re.findall(r"^ {2}(\w+)", GRAMMAR, re.MULTILINE))
    assert shown == {text.split()[0].lower() for text in RIGHT}


@pytest.mark.parametrize(
    ("text", "after_ns"),
    [("3s bumper front on", 3 * S), (" 0.5s  clear", S // 2), ("clear", 0), ("250ms clear", S // 4)],
)
def test_a_scheduled_fault_has_its_delay_first(text: str, after_ns: int) -> None:
    """Without a delay it is meant at once."""
    fault = parse_scheduled(text)
    assert isinstance(fault, ScheduledFault)
    assert fault.after_ns == after_ns


@pytest.mark.parametrize("text", ["3 bumper front on", "3s", "3s bumpr front on", "", "-1s clear"])
def test_a_wrong_schedule_is_an_error(text: str) -> None:
    """A delay has a unit, and a fault after it."""
    assert isinstance(parse_scheduled(text), FaultTextError)
