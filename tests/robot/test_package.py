"""Upgrades of the package while the robot moves and while it stands."""

import os
import shutil
import time
from pathlib import Path
from typing import Final

import pytest

from tests.robot import scene
from tests.robot.box import Box
from tests.robot.image import call
from tests.robot.outside import Outside

NEWER: Final = "9.0-1~deb12"
TRIES: Final = 3
INSTALLED: Final = "dpkg-query --show cruiser-gateway"
INSTALL_S: Final = 180.0


@pytest.fixture(scope="session")
def newer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("newer")
    call("dpkg-deb", "-R", os.environ["ROBOT_PACKAGE"], place / "tree")
    control = place / "tree/DEBIAN/control"
    lines = control.read_text("utf-8").splitlines()
    control.write_text(
        "".join(f"{'Version: ' + NEWER if x.startswith('Version:') else x}\n" for x in lines), "utf-8"
    )
    call("dpkg-deb", "--root-owner-group", "-Zzstd", "-z1", "-b", place / "tree", place / "newer.deb")
    return place / "newer.deb"


def test_an_upgrade_while_the_robot_moves_and_while_it_stands(box: Box, outside: Outside, newer: Path) -> None:
    scene.start(box)
    shutil.copy(newer, box.share / "newer.deb")
    for tries_left in reversed(range(TRIES)):
        scene.begin_drive(box, outside)
        before = box.run(INSTALLED)
        tried_s = time.monotonic()
        said = box.run("dpkg -i /run/box/newer.deb; echo ended with $?", timeout_s=INSTALL_S)
        if "a robot moves" in said or not tries_left:
            break
        # What dpkg does in here before it asks held the drive up, which was stopped: once more.
        box.run("systemctl stop box-operator")
        box.wait_status()
    assert "a robot moves, or is being commanded: nothing is changed" in said, said
    assert "ended with 1" in said, said
    scene.say("upgrade while moving", f"refused after {time.monotonic() - tried_s:.1f} s")
    assert box.run(INSTALLED) == before
    assert box.run("systemctl is-active cruiser-gateway").strip() == "active"

    box.run("systemctl stop box-operator")
    outside.wait_stands(30)
    stood_s = time.monotonic()
    box.wait_status()
    time.sleep(3)
    begun_s = time.monotonic()
    box.run("dpkg -i /run/box/newer.deb", timeout_s=INSTALL_S)
    box.wait_status()
    scene.say("upgrade while standing", f"{time.monotonic() - begun_s:.0f} s until the new gateway is guarded")
    assert NEWER in box.run(INSTALLED)
    assert box.run("systemctl is-active cruiser-recorder").strip() == "active"
    # What dpkg did to the drive may have been too much.
    scene.check_doctor(box, "upgraded", {}, or_else="latched")
    scene.check_stays(outside, stood_s + 1)
    box.power_off()
    begun_s = box.boot()
    box.wait_up()
    ready = box.wait_status()
    scene.say("boot", f"ready {time.monotonic() - begun_s:.1f} s after it was switched on: {ready}")
    scene.say_memory(box)
    scene.check_doctor(box, "upgraded, booted", {}, or_else="latched")
    scene.check_stays(outside, stood_s + 1, 1)
    box.fetch("/var/lib/cruiser/logs")
