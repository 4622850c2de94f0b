"""Desk and exporter of the package, as systemd's services."""

import time

from tests.robot import scene
from tests.robot.box import Box
from tests.robot.outside import Outside

SERVICES = ("cruiser-desk", "cruiser-metrics")


def test_desk_and_exporter_answer_and_come_back(box: Box, outside: Outside) -> None:
    scene.start(box)
    # A log that is whole, beside the one that is being written.
    box.run("systemctl restart cruiser-recorder")
    box.run("sed -i 's/^# logs/logs/' /etc/cruiser/desk.toml && systemctl enable --now " + " ".join(SERVICES))
    scene.ask_fleet(box, "started", logs=True)
    kept = "runuser -u cruiser-desk -G cruiser-recorder -- ls /etc/cruiser/recorder"
    assert "Permission denied" in box.run(f"{kept} 2>&1", check=False)

    for service in SERVICES:
        scene.kill_service(box, service)
    scene.ask_fleet(box, "killed")

    box.cut_power()
    since_s = time.monotonic()
    scene.start(box)
    scene.ask_fleet(box, "power cut", logs=True)
    scene.check_stays(outside, since_s, 1)
