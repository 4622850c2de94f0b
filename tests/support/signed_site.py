"""A fleet in signed mode for system tests: one robot, one operator, their files and processes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import msgspec
import zenoh

from gateway.client.refusal import LeaseLost, Refused, Stopped, Unreachable, is_idle
from gateway.client.robot import Lease, Robot
from schemas import keys
from schemas.authority.proof import GrantRole
from schemas.decisions import StatementReply
from schemas.settings import AuthoritySettings, Settings, ZenohSettings
from tests.support.authority import DAY_S, Fleet, Party
from tests.support.fakes.peer import free_endpoint
from tests.support.provisioned import provision
from tests.support.waiting import wait_until

ROOT, ROBOT, OPERATOR = "fleet", "cruiser-1", "ann"
LIMIT_MPS, WANTED_MPS = 0.4, 0.8


class Site:
    def __init__(self, directory: Path) -> None:
        self.fleet = Fleet()
        self.directory = directory
        self.endpoint = free_endpoint()
        self.robot, self.operator = Party(ROBOT), Party(OPERATOR)
        now_s = int(time.time())
        self.holds = {"not_before": now_s - 60, "not_after": now_s + DAY_S}
        self.fleet.authority.grant(self.robot, role=GrantRole.ROBOT, robots=[ROBOT], **self.holds)
        self.fleet.authority.grant(self.operator, speed_limit_mps=LIMIT_MPS, **self.holds)
        self.robot_settings = self.write("robot", self.robot)
        self.settings = self.settings_of("operator", self.operator)

    def write(self, who: str, party: Party) -> str:
        """Write a party's files and configuration. Returns its path."""
        directory = provision(self.directory / f"{who}-{party.name}", who, party, self.fleet)
        configuration = directory / "cruiser.toml"
        configuration.write_text(
            f'[authority]\nmode = "signed"\ndirectory = "{directory}"\n'
            f'[gateway]\nstate_dir = "{self.directory / "state"}"\n'
        )
        return str(configuration)

    def settings_of(self, who: str, party: Party) -> Settings:
        directory = str(Path(self.write(who, party)).parent)
        return Settings(
            zenoh=ZenohSettings(connect=[self.endpoint]),
            authority=AuthoritySettings(mode="signed", directory=directory),
        )

    def show(self, session: zenoh.Session, text: str) -> StatementReply:
        replies: list[StatementReply] = []

        def answered() -> bool:
            asked = session.get(keys.authority(ROOT, ROBOT), payload=text, timeout=1.0)
            payloads = [reply.ok.payload.to_bytes() for reply in asked if reply.ok is not None]
            replies.extend(msgspec.msgpack.decode(payload, type=StatementReply) for payload in payloads)
            return bool(replies)

        wait_until(answered)
        return replies[0]


@contextmanager
def driving(site: Site) -> Iterator[tuple[Robot, Lease]]:
    """The operator drives; engages again where a busy machine stopped the robot first."""
    found: list[tuple[Robot, Lease]] = []
    with ExitStack() as stack:

        def begin() -> None:
            with suppress(Stopped, Unreachable, LeaseLost, Refused):
                found.append(stack.enter_context(_driving(site)))

        wait_until(lambda: bool(found), begin)
        yield found[0]


@contextmanager
def _driving(site: Site) -> Iterator[tuple[Robot, Lease]]:
    with Robot.connect(ROBOT, settings=site.settings) as robot, robot.lease() as lease:
        # Its guard, its self-test, and what it knows of the chassis, come a moment after its Zenoh.
        robot.wait_for(lambda state: is_idle(state.blocked_by), 30)
        lease.engage()
        lease.unpark()
        wait_until(lambda: speed_of(robot) > LIMIT_MPS / 2, lambda: lease.drive(WANTED_MPS))
        yield robot, lease


def speed_of(robot: Robot) -> float:
    seen = robot.state().chassis
    return 0.0 if seen is None or seen.speed_mps is None else seen.speed_mps
