"""A part of the robot's computer fails in mid-drive: what moves is stopped, and nothing moves by itself."""

import time
from typing import Final

import pytest

from tests.robot import scene
from tests.robot.box import Box
from tests.robot.outside import Outside

STANDS_S: Final = 30.0
RESTARTED_S: Final = 90.0


def wait_restarted(box: Box) -> None:
    """Wait until systemd has begun the gateway again, and it is guarded."""
    box.run(
        f"for i in $(seq {RESTARTED_S:.0f}); do "
        "[ $(systemctl show --property=NRestarts --value cruiser-gateway) = 0 ] || exit 0; sleep 1; done; "
        "systemctl status cruiser-gateway; journalctl -b -u cruiser-gateway | tail -30; exit 1",
        timeout_s=2 * RESTARTED_S,
    )
    box.wait_status()


@pytest.mark.parametrize("signal", ["KILL", "STOP"])
def test_a_gateway_that_dies_or_hangs(box: Box, outside: Outside, signal: str) -> None:
    """Its guard stops the robot; systemd begins it again, if need be by the watchdog; it waits for a reset."""
    scene.drive(box, outside)
    begun_s = time.monotonic()
    box.run(f"systemctl kill --signal={signal} --kill-whom=main cruiser-gateway")
    outside.wait_stands(STANDS_S)
    stood_s = time.monotonic()
    wait_restarted(box)
    scene.say(
        f"gateway, SIG{signal}",
        f"the chassis stood {stood_s - begun_s:.1f} s later, having gone {outside.distance_m(begun_s):.1f} m; "
        f"a new gateway was guarded after {time.monotonic() - begun_s:.0f} s",
    )
    if signal == "STOP":
        assert "watchdog" in box.run("journalctl -b -u cruiser-gateway")
    scene.check_latched(box)
    scene.check_stays(outside, stood_s + 1)
    last = outside.lives[-1]
    box.cut_power()
    box.boot()
    box.wait_up()
    box.wait_status()
    scene.check_log(box, last)


def test_an_interface_that_goes_and_comes_back(box: Box, outside: Outside) -> None:
    """Nobody can tell the chassis anything meanwhile; with the interface comes the early stop."""
    scene.drive(box, outside)
    box.run("ip link delete can0")
    gone_s = time.monotonic()
    time.sleep(3)
    assert outside.speed_mps >= scene.STEADY_MPS, "the chassis obeys its last command for ever"
    back_s = time.monotonic()
    box.run("ip link add can0 type vcan && ip link set can0 up")
    outside.wait_stands(STANDS_S)
    stood_s = time.monotonic()
    bus, zero_s = outside.first_life(back_s, bus_is_up=True), outside.first_zero_s(back_s)
    assert bus is not None
    assert zero_s is not None
    scene.say(
        "interface gone and back",
        f"zero told {zero_s - bus.at_s:.2f} s after it was up; "
        f"{stood_s - gone_s:.1f} s without command, {outside.distance_m(gone_s):.1f} m",
    )
    box.wait_status(deadline_s=120)
    scene.check_latched(box)
    scene.check_stays(outside, stood_s + 1)
    assert "commanded it: stopping the robot" in box.run("journalctl -b -u 'cruiser-*'")


def test_a_clock_that_is_set_back(box: Box, outside: Outside) -> None:
    """An hour: what the robot does hangs on no time of day, and no log is lost or overwritten."""
    scene.drive(box, outside)
    before = outside.lives[-1]
    set_s = time.monotonic()
    box.run("date --set '1 hour ago'")
    time.sleep(5)
    told = [told for told in outside.drives_since(set_s) if told.at_s > set_s + 4]
    scene.say("clock set back", f"the drive {'went on' if told else 'was ended'}")
    box.run("systemctl stop box-operator")
    outside.wait_stands(STANDS_S)
    stood_s = time.monotonic()
    last = outside.lives[-1]
    box.wait_status()
    scene.check_stays(outside, stood_s + 1)
    box.cut_power()
    box.boot()
    box.wait_up()
    box.wait_status()
    scene.check_log(box, before)
    scene.check_log(box, last)
    scene.check_stays(outside, stood_s + 1, 1)
