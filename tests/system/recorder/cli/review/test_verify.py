"""A drive of real processes in signed mode, with a revocation: its log is verified and rerun."""

import json
import signal
import time
from pathlib import Path

import msgspec
import pytest

from gateway.client.refusal import LeaseLost
from gateway.client.robot import Robot
from recorder import read_log
from schemas.authority.proof import GrantRole, Signed
from schemas.decisions import EventKind, Journal, SafetyEvent
from schemas.journal import Kind
from schemas.reasons import Reason
from schemas.settings import AuthoritySettings, Settings, ZenohSettings
from schemas.zenoh_session import join
from tests.support.authority import Fleet, Party
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, run
from tests.support.processes.gateway import chassis as virtual_chassis
from tests.support.provisioned import provision
from tests.support.waiting import wait_until

ROBOT = "cruiser-1"
DAY_S = 86_400


class SignedDrive(msgspec.Struct, frozen=True):
    """A recording, and the path of the fleet's authority."""

    logs: Path
    authority: Path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> SignedDrive:
    """Ann drives until her grant is revoked; the robot stops, and the gateway ends."""
    directory = tmp_path_factory.mktemp("signed")
    fleet, robot, ann, archive = Fleet(), Party(ROBOT), Party("ann"), Party("archive")
    now_s = int(time.time())
    period = {"not_before": now_s - 60, "not_after": now_s + DAY_S}
    fleet.authority.grant(robot, role=GrantRole.ROBOT, robots=[ROBOT], **period)
    fleet.authority.grant(ann, speed_limit_mps=0.4, **period)
    fleet.authority.grant(archive, role=GrantRole.RECORDER, **period)
    provision(directory / "robot", "robot", robot, fleet)
    provision(directory / "recorder", "recorder", archive, fleet)
    own = provision(directory / "operator", "operator", ann, fleet)
    configuration = directory / "robot.toml"
    configuration.write_text(
        f'[authority]\nmode = "signed"\ndirectory = "{directory}/robot"\n'
        f'[gateway]\nstate_dir = "{directory}/state"\n'
    )
    of_recorder = directory / "recorder.toml"
    of_recorder.write_text(f'[authority]\nmode = "signed"\ndirectory = "{directory}/recorder"\n')
    endpoint, logs = free_endpoint(), directory / "logs"
    settings = Settings(
        zenoh=ZenohSettings(connect=[endpoint]), authority=AuthoritySettings(mode="signed", directory=str(own))
    )
    with virtual_chassis() as (_, address):
        bus = ["--interface", "socketcand", "--channel", address, "--listen", endpoint]
        with Running("gateway", "--config", str(configuration), *bus) as gateway:
            gateway.wait_says("^gateway: ")
            # It comes later than the gateway: what was published before, it has to ask for.
            words = ("record", "--config", str(of_recorder), "-o", str(logs), "--connect", endpoint)
            with Running(*words) as recording:
                recording.wait_says("writing")
                drive(settings, fleet, ann)
                assert gateway.stop() == 0, gateway.said
                assert recording.stop(signal.SIGINT) == 0, recording.said
    return SignedDrive(logs, own / "authority.json")


def show(settings: Settings, statement: Signed) -> None:
    session = join(settings.zenoh)
    try:

        def is_taken() -> bool:
            replies = session.get(f"fleet/{ROBOT}/@auth", payload=statement.text().encode(), timeout=2)
            return any(msgspec.msgpack.decode(one.ok.payload.to_bytes())["ok"] for one in replies if one.ok)

        wait_until(is_taken)
    finally:
        session.close()


def speed_mps(robot: Robot) -> float:
    chassis = robot.state().chassis
    return abs(chassis.speed_mps or 0.0) if chassis is not None else 0.0


def drive(settings: Settings, fleet: Fleet, ann: Party) -> None:
    show(settings, fleet.authority.revoke(1))
    with Robot.connect(ROBOT, settings=settings) as robot, robot.lease() as lease:
        wait_until(lambda: robot.state().state.blocked_by == [Reason.NOT_ENGAGED])
        lease.engage()
        lease.unpark()
        wait_until(lambda: speed_mps(robot) > 0.3, lambda: lease.drive(0.6))
        show(settings, fleet.authority.revoke(2, keys=(ann.key,)))
        with pytest.raises(LeaseLost):
            wait_until(lambda: False, lambda: lease.drive(0.6))
        wait_until(lambda: speed_mps(robot) < 0.01)


def test_all_of_the_log_is_proven(recorded: SignedDrive) -> None:
    done = run(["review", "verify", str(recorded.logs), "--authority", str(recorded.authority), "--json"])
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    (holder,) = report["holders"]
    assert holder["grant"] in {grant["id"] for grant in report["grants"] if grant["name"] == "ann"}
    assert {verb["verb"] for verb in report["verbs"]} >= {"acquire", "engage", "unpark"}
    assert all(file["fits"] for file in report["files"])


def test_the_run_comes_out_again_byte_for_byte(recorded: SignedDrive) -> None:
    """The inputs include the end of the lease, and the reasons against engaging."""
    done = run(["review", "rerun", "--json", str(recorded.logs)])
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads(done.stdout)
    assert result["same"]["safety/decision"] > 5
    assert not result["difference_count"]
    inputs = [
        one
        for message in read_log(recorded.logs, topics=["journal"])
        if isinstance(message.message, Journal)
        for one in msgspec.msgpack.decode(message.message.inputs)
    ]
    ends = [one for one in inputs if one[0] == Kind.END_LEASE]
    assert {one[2] for one in ends} == {Reason.GRANT_REVOKED.value}
    events = [one.message for one in read_log(recorded.logs, topics=["safety/event"])]
    stops = [one for one in events if isinstance(one, SafetyEvent) and one.kind is EventKind.STOP]
    assert {one.reason for one in stops} == {Reason.GRANT_REVOKED}
