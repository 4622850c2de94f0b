"""The robot's computer loses its power while the robot drives."""

import time

from gateway.chassis.cruiser.early_stop import FOUND
from tests.robot import scene
from tests.robot.box import Box
from tests.robot.outside import Outside

DARK_S = 3.0  # the power stays off


def test_a_power_cut_in_mid_drive(box: Box, outside: Outside) -> None:
    scene.drive(box, outside)
    cut_s = box.cut_power()
    last = outside.lives[-1]
    time.sleep(DARK_S)
    assert outside.speed_mps >= scene.STEADY_MPS, "the chassis obeys its last command for ever"

    begun_s = box.boot()
    outside.wait_stands(deadline_s=90)
    stood_s = time.monotonic()
    bus = outside.first_life(begun_s, bus_is_up=True)
    zero_s = outside.first_zero_s(begun_s)
    assert bus is not None
    assert zero_s is not None
    scene.say(
        "power cut",
        f"switched on to interface up {bus.at_s - begun_s:.1f} s, to zero told {zero_s - bus.at_s:.2f} s more; "
        f"without power the chassis drove on for {stood_s - cut_s:.1f} s (dark for {begun_s - cut_s:.1f} s), "
        f"{outside.distance_m(cut_s):.1f} m",
    )
    assert zero_s - bus.at_s < scene.TOLD_S
    box.wait_up()
    (found,) = [entry for entry in box.journal("-b -u 'cruiser-early-stop@*'") if FOUND in entry["MESSAGE"]]
    scene.say("power cut", f"zero speed was told by: {found['MESSAGE']}")
    ready = box.wait_status()
    scene.say("power cut", f"ready {time.monotonic() - begun_s:.1f} s after it was switched on: {ready}")
    scene.check_latched(box)
    scene.check_stays(outside, stood_s + 1)
    scene.check_log(box, last)
    scene.check_doctor(box, "power cut", scene.POWER_CUT)
