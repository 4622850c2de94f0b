"""From a bare Debian to a drive in signed mode, by docs/install.md."""

import os
import shutil
import time
from pathlib import Path
from typing import Final

from tests.robot import scene
from tests.robot.box import Box
from tests.robot.outside import Outside
from tests.support.provisioning import ProvisionedFleet

ROUTER: Final = "tls/127.0.0.1:7447"
SERVICES: Final = {
    "router": "router 127.0.0.1",
    "gateway": "robot cruiser-1",
    "recorder": "recorder box",
    "desk": "desk 127.0.0.1",
    "metrics": "viewer fleet",
}
BESIDE: Final = {"desk": "desk.json5", "metrics": "viewer.json5"}
"""Services that setup leaves alone, and the Zenoh file of each."""

ZENOHD: Final = os.environ.get("ROBOT_ZENOHD", "")
"""Zenoh's own router, if it shall be the one, by the drop-in of the package."""

DROP_IN: Final = "/etc/systemd/system/cruiser-router.service.d"
KEYS: Final = "/var/lib/tester"
OPERATOR: Final = "/etc/systemd/system/box-operator.service.d"
WELL: Final = "standing, feedback complete, guarded, recording, authority valid until "


def install_beside(box: Box) -> None:
    """Give desk and exporter their certificates, as docs/install.md does at a depot."""
    for service, file in BESIDE.items():
        bundle, keys = f"/run/{service}.bundle", f"/etc/cruiser/{service}"
        box.run(f"install -m 0644 /run/box/{service}.bundle {bundle}")
        box.run(f"runuser -u cruiser-{service} -- cruiser provision install {bundle} --directory {keys}")
        zenoh = f'config = "{keys}/{file}"'
        box.run(f"sed -i '/^connect/d; s|^\\[zenoh\\]|&\\n{zenoh}|' /etc/cruiser/{service}.toml")
        box.run(f"systemctl enable --now cruiser-{service}")


def try_beside(box: Box) -> None:
    """Ask desk and exporter, then stop them: they leave the only processor no time to record a drive."""
    scene.ask_fleet(box, "signed, started")
    box.run("systemctl stop cruiser-desk cruiser-metrics")


def test_a_fresh_debian_is_set_up_and_driven_in_signed_mode(
    fresh_box: Box, outside: Outside, tmp_path: Path
) -> None:
    box = fresh_box
    box.boot()
    box.wait_up()
    scene.install(box)
    if ZENOHD:
        shutil.copy(ZENOHD, box.share / "zenohd")
        box.run("install -m 0755 /run/box/zenohd /usr/local/bin/zenohd")
        example = "/usr/share/doc/cruiser-gateway/examples/zenohd.conf"
        box.run(f"install -D -m 0644 {example} {DROP_IN}/zenohd.conf && systemctl daemon-reload")
    for service, who in SERVICES.items():
        box.run(
            f"runuser -u cruiser-{service} -- cruiser provision {who} --directory /etc/cruiser/{service} "
            f"-o /tmp/{service}.request && cp /tmp/{service}.request /run/box/"
        )
    box.run(f"cruiser provision operator tester --directory {KEYS} -o /run/box/operator.request")
    fleet = ProvisionedFleet(tmp_path, ROUTER)
    for service in SERVICES:
        fleet.sign(box.share / f"{service}.request")
    fleet.sign(box.share / "operator.request", "--speed-limit", "0.8")

    begun_s = time.monotonic()
    bundles = " ".join(f"--bundle {service}.bundle" for service in SERVICES if service not in BESIDE)
    words = f"{bundles} --fingerprint {fleet.fingerprint}"
    said = box.run(f"cd /run/box && cruiser setup --defaults {words}", timeout_s=300)
    scene.say("setup, signed", f"{time.monotonic() - begun_s:.0f} s: {said.splitlines()[-1]}")
    assert said.splitlines()[-1].startswith(WELL), said
    assert not outside.told
    install_beside(box)
    box.run(f"cruiser provision install /run/box/operator.bundle --directory {KEYS}")
    settings = f"[Service]\\nEnvironment=CRUISER_CONFIG={KEYS}/operator.toml\\n"
    box.run(f"mkdir {OPERATOR}; printf '{settings}' >{OPERATOR}/signed.conf")
    box.power_off()

    begun_s = box.boot()
    box.wait_up()
    ready = box.wait_status()
    scene.say("signed", f"ready {time.monotonic() - begun_s:.1f} s after it was switched on: {ready}")
    # Who has no keys finds no door.
    box.run("! cruiser list --connect tcp/127.0.0.1:7447 --timeout 3 | grep cruiser-1")
    try_beside(box)
    scene.begin_drive(box, outside)
    scene.say("signed", f"drives at {outside.speed_mps:.2f} m/s")
    last = outside.lives[-1]
    box.cut_power()
    begun_s = box.boot()
    outside.wait_stands(90)
    stood_s = time.monotonic()
    box.wait_up()
    box.wait_status()
    assert ("zenohd" if ZENOHD else "cruiser router") in box.run("systemctl status cruiser-router")
    scene.ask_fleet(box, "signed, power cut")
    scene.check_log(box, last)
    scene.check_doctor(box, "signed, power cut", scene.POWER_CUT)
    scene.kill_service(box, "cruiser-router")
    scene.ask_fleet(box, "signed, router killed")
    killed = {"service_restarted": "cruiser-router.service, once because of signal"}
    scene.check_doctor(box, "signed, router killed", {**scene.POWER_CUT, **killed})
    scene.check_stays(outside, stood_s + 1, 1)
