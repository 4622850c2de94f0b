"""Failures of parts of the robot's computer in mid-drive."""

import time
from typing import Final

import pytest

from tests.robot import scene
from tests.robot.box import Box
from tests.robot.outside import Outside

STANDS_S: Final = 30.0
KILLED: Final = {
    # Gone, or without a sign of life: whichever the guard sees first.
    "latched": "last heartbeat",
    "service_restarted": "cruiser-gateway.service, once because of signal (it was killed)",
}
FULL: Final = {"disk_full": "/var/lib/cruiser/logs: 0 MB free", "recorder_stopped": "is full"}
HUNG: Final = {
    "latched": "last heartbeat",
    "service_restarted": "cruiser-gateway.service, once because of watchdog (it hung)",
}


@pytest.mark.parametrize("signal", ["KILL", "STOP"])
def test_a_gateway_that_dies_or_hangs(box: Box, outside: Outside, signal: str) -> None:
    scene.start(box)
    begun_s = scene.drive_and_signal(box, outside, signal)
    outside.wait_stands(STANDS_S)
    stood_s = time.monotonic()
    scene.wait_restarted(box, "cruiser-gateway")
    box.wait_status()
    scene.say(
        f"gateway, SIG{signal}",
        f"the chassis stood {stood_s - begun_s:.1f} s later, having gone {outside.distance_m(begun_s):.1f} m; "
        f"a new gateway was guarded after {time.monotonic() - begun_s:.0f} s",
    )
    if signal == "STOP":
        assert "watchdog" in box.run("journalctl -b -u cruiser-gateway")
    scene.check_latched(box)
    scene.check_doctor(box, f"SIG{signal}", HUNG if signal == "STOP" else KILLED)
    scene.check_stays(outside, stood_s + 1)
    last = outside.lives[-1]
    box.cut_power()
    scene.start(box)
    scene.check_log(box, last)
    scene.check_doctor(box, f"SIG{signal}, power cut", {**scene.POWER_CUT, "latched": "the guard has stopped"})


def test_an_interface_that_goes_and_comes_back(box: Box, outside: Outside) -> None:
    scene.start(box)
    # Both wait for the file: to start a process in mid-drive could end the drive.
    box.run(
        "mkfifo /run/orders /run/pause; exec 8<>/run/pause; ip -batch /run/orders >/dev/null 2>&1 & "
        "{ until [ -e /run/box/cut ]; do read -r -t 0.1 -u 8 _; done; echo link delete can0 >/run/orders; } "
        ">/dev/null 2>&1 &"
    )
    scene.begin_drive(box, outside)
    last = outside.lives[-1]
    (box.share / "cut").touch()
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
    assert zero_s - bus.at_s < scene.TOLD_S
    box.wait_status(deadline_s=120)
    scene.check_stays(outside, stood_s + 1)
    # Gateway or guard, whichever has the bus first, stops the robot; what the guard does is latched.
    scene.check_doctor(box, "interface back", {}, or_else="latched")
    box.run("ip link delete can0")
    box.wait_status("standby, no bus")
    scene.check_doctor(box, "interface gone", {"interface_missing": "can0"}, or_else="latched")
    box.cut_power()
    scene.start(box)
    scene.check_log(box, last)
    power_cut = {"not_shut_down": scene.POWER_CUT["not_shut_down"]}
    scene.check_doctor(box, "interface gone, power cut", power_cut, or_else="latched")
    scene.check_stays(outside, stood_s + 1, 1)


def test_a_full_disk(box: Box, outside: Outside) -> None:
    scene.start(box)
    log = scene.wait_log(box)
    full = outside.lives[-1]
    box.run("fallocate -l $(($(stat -f -c '%f * %S' /) - 65536)) /var/full; cat /dev/zero >>/var/full; true")
    begun_s = scene.drive_and_signal(box, outside, "KILL")
    outside.wait_stands(STANDS_S)
    stood_s = time.monotonic()
    scene.wait_restarted(box, "cruiser-gateway")
    box.wait_status()
    scene.say(
        "disk full",
        f"gateway killed: the chassis stood {stood_s - begun_s:.1f} s later; "
        f"a new one is guarded after {time.monotonic() - begun_s:.0f} s",
    )
    scene.check_latched(box)
    scene.check_doctor(box, "disk full", {**KILLED, **FULL, "latched": "the disk was full"})
    scene.check_stays(outside, stood_s + 1)

    # The power goes in mid-drive, and the disk is full still.
    box.run("systemctl stop box-operator")
    scene.begin_drive(box, outside)
    box.cut_power()
    begun_s = box.boot()
    outside.wait_stands(90)
    stood_s = time.monotonic()
    zero_s, bus = outside.first_zero_s(begun_s), outside.first_life(begun_s, bus_is_up=True)
    assert zero_s is not None
    assert bus is not None
    assert zero_s - bus.at_s < scene.TOLD_S
    box.wait_up()
    box.wait_status()
    scene.say("disk full", f"power cut: zero told {zero_s - bus.at_s:.2f} s after the interface was up")
    scene.check_latched(box)
    scene.check_doctor(box, "disk full, power cut", {**scene.POWER_CUT, **FULL, "latched": "the disk was full"})
    scene.check_stays(outside, stood_s + 1, 1)

    # A part for which there was no room at the recorder's start is made whole when there is.
    tries = box.run("journalctl -b -u cruiser-recorder | grep 'cannot recover'; ls -l " + scene.LOGS, check=False)
    scene.say("disk full, power cut", " | ".join(tries.splitlines()))
    box.run("rm /var/full")
    scene.check_log(box, full, log=log)
    scene.check_doctor(box, "disk full, then room", {**scene.POWER_CUT, "latched": "the disk was full"})
    scene.check_stays(outside, stood_s + 1, 1)


def test_a_clock_that_is_set_back(box: Box, outside: Outside) -> None:
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
    # The package may have been built within that hour.
    scene.check_doctor(box, "clock set back", {"clock_set_back": "by 36"}, or_else="clock_behind")
    scene.check_stays(outside, stood_s + 1)
    box.cut_power()
    scene.start(box)
    scene.check_log(box, before)
    scene.check_log(box, last)
    scene.check_stays(outside, stood_s + 1, 1)
