"""Lamps, horn and odometer."""

from gateway.chassis.port import AuxiliaryFrame
from gateway.choice import CHASSIS
from gateway.command.auxiliary import Auxiliary
from schemas.settings import ODOMETER_TIMEOUT_NS, TAIL_NS


def lamps(*, head: bool = False, left: bool = False, right: bool = False) -> AuxiliaryFrame:
    return AuxiliaryFrame("Auto_LightCmd", {"Headlamp": head, "RightIndicator": right, "LeftIndicator": left})


def horn(*, on: bool) -> AuxiliaryFrame:
    return AuxiliaryFrame("Auto_SpeakerCmd", {"Horn": on})


def odometer(*, on: bool) -> AuxiliaryFrame:
    return AuxiliaryFrame("Auto_OdometerCmd", {"Enable": on, "ClearMileage": on})


def set_lamps(auxiliary: Auxiliary, now_ns: int, *on: str) -> None:
    """These shine, and no other."""
    auxiliary.set_light(headlamp="headlamp" in on, left="left" in on, right="right" in on, now_ns=now_ns)


def test_nothing_is_sent_that_is_not_asked_for() -> None:
    """Frames go out only while they are."""
    assert Auxiliary(CHASSIS).frames(0) == []


def test_each_lamp_shines_until_it_is_put_out() -> None:
    """And then frames say off for 100 ms."""
    for lamp in ("headlamp", "left", "right"):
        made = Auxiliary(CHASSIS)
        set_lamps(made, 0, lamp)
        expected = [lamps(head=lamp == "headlamp", left=lamp == "left", right=lamp == "right")]
        assert made.frames(0) == made.frames(10**12) == expected
        set_lamps(made, 10**12)
        assert made.frames(10**12 + TAIL_NS - 1) == [lamps()]
        assert made.frames(10**12 + TAIL_NS) == []


def test_the_horn_sounds_until_it_is_ended() -> None:
    """The same."""
    made = Auxiliary(CHASSIS)
    made.set_horn(on=True, now_ns=0)
    assert made.frames(10**12) == [horn(on=True)]
    made.set_horn(on=False, now_ns=5)
    assert made.frames(5 + TAIL_NS - 1) == [horn(on=False)]
    assert made.frames(5 + TAIL_NS) == []


def test_the_odometer_is_cleared_once_it_reads_zero() -> None:
    """Not before the frames can have had an effect; told once; then frames say off."""
    made = Auxiliary(CHASSIS)
    assert made.clearing_result(0.0, 0) is None
    made.clear_odometer(0)
    assert made.is_clearing
    assert made.frames(0) == [odometer(on=True)]
    assert made.clearing_result(0.0, TAIL_NS - 1) is None
    assert made.clearing_result(0.0005, TAIL_NS) is None
    assert made.clearing_result(0.0004, TAIL_NS) is True
    assert made.clearing_result(0.0, TAIL_NS) is None
    assert not made.is_clearing
    assert made.frames(2 * TAIL_NS - 1) == [odometer(on=False)]
    assert made.frames(2 * TAIL_NS) == []


def test_an_odometer_that_does_not_read_zero_has_failed() -> None:
    """Contradiction 3 of the protocol notes: confirmed by the feedback, reported as failed otherwise."""
    for mileage_km in (12.0, None):
        made = Auxiliary(CHASSIS)
        made.clear_odometer(0)
        assert made.clearing_result(mileage_km, ODOMETER_TIMEOUT_NS - 1) is None
        assert made.clearing_result(mileage_km, ODOMETER_TIMEOUT_NS) is False


def test_a_stop_ends_all_of_it() -> None:
    """The chassis keeps the last command for ever: each ends with frames that say off."""
    made = Auxiliary(CHASSIS)
    made.end(0)
    assert made.frames(0) == []
    set_lamps(made, 0, "left")
    made.set_horn(on=True, now_ns=0)
    made.clear_odometer(0)
    made.end(5)
    assert made.frames(5 + TAIL_NS - 1) == [lamps(), horn(on=False), odometer(on=False)]
    assert made.frames(5 + TAIL_NS) == []


def test_lamps_that_were_put_out_are_told_so_again_in_a_stop() -> None:
    """It costs nothing, and what was lost on the bus is made good; after somebody else took over, it is past."""
    stopped, left = Auxiliary(CHASSIS), Auxiliary(CHASSIS)
    for made in (stopped, left):
        set_lamps(made, 0, "right")
        set_lamps(made, 1)
        assert not made.is_off(TAIL_NS)
        assert made.is_off(1 + TAIL_NS)
    left.leave(10**12)
    for made in (stopped, left):
        made.end(10**12)
    assert stopped.frames(10**12) == [lamps()]
    assert left.frames(10**12) == []
    assert stopped.is_off(10**12 + TAIL_NS)


def test_lamps_that_shine_after_a_takeover_are_put_out_with_the_next_engagement() -> None:
    """Until then they are not off: the chassis has them on."""
    made = Auxiliary(CHASSIS)
    set_lamps(made, 0, "headlamp")
    made.leave(1)
    assert not made.is_off(10**12)
    made.end(10**12)
    assert made.frames(10**12) == [lamps()]
    assert made.is_off(10**12 + TAIL_NS)
