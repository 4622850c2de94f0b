"""A drive of real processes in signed mode, with a revocation: its log is verified and rerun."""

import json
import signal
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gateway.client.refusal import LeaseLost
from recorder import read_log
from schemas.authority.proof import GrantRole
from schemas.decisions import EventKind, Journal, SafetyEvent
from schemas.journal import Kind
from schemas.reasons import Reason
from schemas.zenoh_session import join
from tests.support.authority import Party
from tests.support.processes.gateway import Running, chassis, gateway, run
from tests.support.signed_site import WANTED_MPS, Site, driving, speed_of
from tests.support.waiting import wait_until


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """The operator drives until its grant is revoked; the robot stops, and the gateway ends."""
    site, archive = Site(tmp_path_factory.mktemp("signed")), Party("archive")
    site.fleet.authority.grant(archive, role=GrantRole.RECORDER, **site.holds)
    recorder = ("--config", site.write("recorder", archive), "-o", str(site.directory / "logs"))
    # The recorder comes later than the gateway: what was published before, it has to ask for.
    with (
        chassis() as (_, address),
        gateway(address, site.endpoint, "--config", site.robot_settings) as process,
        join(site.settings.zenoh) as session,
        Running("record", *recorder, "--connect", site.endpoint) as recording,
    ):
        recording.wait_says("writing")
        assert site.show(session, site.fleet.authority.revoke(1).text()).ok
        with driving(site) as (robot, lease):
            assert site.show(session, site.fleet.authority.revoke(2, keys=(site.operator.key,)).text()).ok
            with pytest.raises(LeaseLost):
                wait_until(lambda: False, lambda: lease.drive(WANTED_MPS))
            wait_until(lambda: speed_of(robot) < 0.01)
        assert process.stop() == 0, process.said
        assert recording.stop(signal.SIGINT) == 0, recording.said
    return site


def answer(site: Site, question: str, *words: str) -> dict[str, Any]:
    done = run(["review", question, "--json", str(site.directory / "logs"), *words])
    assert done.returncode == 0, done.stdout + done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_all_of_the_log_is_proven(site: Site) -> None:
    report = answer(site, "verify", "--authority", f"{Path(site.robot_settings).parent}/authority.json")
    (holder,) = report["holders"]
    assert holder["grant"] in {grant["id"] for grant in report["grants"] if grant["name"] == "ann"}
    assert {verb["verb"] for verb in report["verbs"]} >= {"acquire", "engage", "unpark"}
    assert all(file["fits"] for file in report["files"])


def test_the_run_comes_out_again_byte_for_byte(site: Site) -> None:
    """The inputs include the end of the lease, and the reasons against engaging."""
    result = answer(site, "rerun")
    assert result["same"]["safety/decision"] > 5
    assert not result["difference_count"]
    messages = [one.message for one in read_log(site.directory / "logs", topics=["journal", "safety/event"])]
    journals = [msgspec.msgpack.decode(one.inputs) for one in messages if isinstance(one, Journal)]
    ends = {one[2] for inputs in journals for one in inputs if one[0] == Kind.END_LEASE}
    stops = {one.reason for one in messages if isinstance(one, SafetyEvent) and one.kind is EventKind.STOP}
    assert (ends, stops) == ({Reason.GRANT_REVOKED.value}, {Reason.GRANT_REVOKED})
