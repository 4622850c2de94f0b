"""A neighbour on the same Zenoh network who wants to drive a robot, or to have its driver lose it.

He reads all that the robot publishes and records, and uses the holder's name. He cannot know the number of the
holder's lease; some tests give it to him, as if he had read the holder's own requests.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import msgspec
import pytest
import zenoh
from mcap.reader import make_reader

from gateway.client.refusal import LeaseLost
from gateway.client.robot import Lease, Robot
from schemas import keys
from schemas.decisions import Decision, Journal, Verdict
from schemas.journal import Kind
from schemas.reasons import Reason
from schemas.settings import Settings, ZenohSettings
from schemas.subjects import BY_NAME
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import ROOT
from tests.support.nights import by_night
from tests.support.processes.gateway import Running, chassis, gateway
from tests.support.processes.holding import hold
from tests.support.waiting import wait_until

ROBOT, HOLDER = "cruiser-1", "holder"
SPEED_MPS, HIS_SPEED_MPS = 0.2, 1.0
FAR_M = 99.0
JOURNAL = msgspec.msgpack.Decoder(Journal)
DECISION = msgspec.msgpack.Decoder(Decision)


class Neighbour:
    """Reads everything, and commands under the holder's name."""

    def __init__(self, endpoint: str) -> None:
        # He listens: so the others connect to him too, and what he forges reaches them.
        self.session = open_session(ZenohSettings(), [endpoint], [free_endpoint()])
        self.read: list[tuple[str, bytes]] = []
        self.forged: set[bytes] = set()
        self._samples = self.session.declare_subscriber("**", zenoh.handlers.FifoChannel(1_000_000))

    def listen(self) -> None:
        while (sample := self._samples.try_recv()) is not None:
            self.read.append((str(sample.key_expr), sample.payload.to_bytes()))

    def of(self, subject: str) -> list[bytes]:
        return [payload for key, payload in self.read if key == f"{ROOT}/{ROBOT}/{subject}"]

    def decisions(self) -> list[Decision]:
        return [DECISION.decode(payload) for payload in self.of("safety/decision")]

    def numbers(self) -> set[int]:
        """Candidates for the lease's number: from decisions and recorded requests, and computed from the run."""
        found = {one.lease for one in self.decisions() if one.lease is not None}
        for payload in self.of("journal"):
            journal = JOURNAL.decode(payload)
            drawn = Random(journal.run)  # noqa: S311 - as the arbiter draws
            drawn.getrandbits(40)
            found |= {drawn.getrandbits(48) + 1 for _ in range(5)}
            for kind, _, *arguments in msgspec.msgpack.decode(journal.inputs):
                if kind == Kind.REQUEST and arguments[3]:
                    found |= set(integers(msgspec.msgpack.decode(arguments[3])))
        return found

    def state(self) -> dict[str, Any]:
        own = [one for one in self.of("safety/state")[-50:] if one not in self.forged]
        return msgspec.msgpack.decode(own[-1])  # type: ignore[no-any-return]

    def has_heard(self, states: int) -> bool:
        return len(self.of("safety/state")) >= states

    def forge(self, **fields: object) -> None:
        """Publish the newest safety/state again with other fields."""
        subject = BY_NAME["safety/state"]
        payload = msgspec.msgpack.encode(self.state() | fields)
        self.forged.add(payload)
        self.session.put(keys.build(ROOT, ROBOT, subject), payload, encoding=subject.encoding)

    def drive(self, lease: int, seq: int) -> None:
        state = self.state()
        payload = msgspec.msgpack.encode(
            {
                "lease": lease,
                "seq": seq,
                "challenge": state["challenge"],
                "speed_mps": HIS_SPEED_MPS,
                "angle_deg": 0.0,
            }
        )
        self.session.put(keys.command(ROOT, ROBOT, HOLDER, "drive"), payload)


def integers(value: Any) -> Iterator[int]:  # noqa: ANN401 - whatever MessagePack holds
    match value:
        case int():
            yield value
        case dict():
            for one in value.values():
                yield from integers(one)
        case list():
            for one in value:
                yield from integers(one)


def forms(number: int) -> list[bytes]:
    """A number as in MessagePack, protobuf and text."""
    varint, rest = bytearray(), number
    while rest:
        varint.append(rest & 0x7F | (0x80 if rest > 0x7F else 0))
        rest >>= 7
    length = (number.bit_length() + 7) // 8
    return [number.to_bytes(length, "big"), number.to_bytes(length, "little"), bytes(varint), str(number).encode()]


def recorded(directory: Path) -> list[bytes]:
    (log,) = (path for path in directory.glob("*.mcap") if ".incident." not in path.name)
    with log.open("rb") as stream:
        return [message.data for _, _, message in make_reader(stream).iter_messages()]


def test_nobody_drives_under_the_holders_name_by_what_is_published_and_recorded(tmp_path: Path) -> None:
    """No number that can be read or computed works, and the true one is nowhere."""
    endpoint = free_endpoint()
    with (
        Running("record", "-o", str(tmp_path), "--connect", endpoint) as recording,
        chassis() as (_, address),
        gateway(address, endpoint) as running,
    ):
        neighbour = Neighbour(endpoint)
        settings = Settings(zenoh=ZenohSettings(connect=[endpoint]))
        with Robot.connect(ROBOT, HOLDER, settings, 30) as robot, robot.lease() as lease:
            tried: set[int] = set()
            refused: list[Decision] = []

            def hijack() -> None:
                neighbour.listen()
                hold(robot, lease, SPEED_MPS)
                accepted = [one.request_sequence for one in neighbour.decisions() if one.request_sequence]
                for number in neighbour.numbers() - tried if accepted else ():
                    tried.add(number)
                    neighbour.drive(number, max(accepted) + 5)
                # Against the drops of a busy moment: those that were given are tried again and again.
                for number in {one.lease for one in neighbour.decisions() if one.lease}:
                    neighbour.drive(number, max(accepted, default=0) + 5)
                refused[:] = [one for one in neighbour.decisions() if one.requested_speed_mps is None]
                refused[:] = [one for one in refused if one.reason is Reason.NO_LEASE]

            wait_until(lambda: len(refused) > 200 and len(tried) > 5, hijack)
            number = lease.number
        wait_until(lambda: any(one.request == "release" for one in neighbour.decisions()), neighbour.listen)
        assert running.stop() == 0, running.said
        neighbour.listen()
        close_session(neighbour.session)
        wait_until(lambda: any(tmp_path.glob("*.mcap*")))
        assert recording.stop(signal.SIGINT) == 0, recording.said
    accepted = [one for one in neighbour.decisions() if one.verdict is Verdict.ACCEPTED]
    assert {one.requested_speed_mps for one in accepted if one.request == "drive"} <= {0.0, SPEED_MPS}
    assert number not in neighbour.numbers()
    said = [*(payload for _, payload in neighbour.read), *recorded(tmp_path), "\n".join(running.said).encode()]
    assert len(neighbour.of("journal")) > 5
    assert not [one for one in said if any(form in one for form in forms(number))]


@contextmanager
def driving() -> Iterator[tuple[Neighbour, Robot, Lease]]:
    endpoint = free_endpoint()
    settings = Settings(zenoh=ZenohSettings(connect=[endpoint]))
    with chassis() as (_, address), gateway(address, endpoint):
        neighbour = Neighbour(endpoint)
        with Robot.connect(ROBOT, HOLDER, settings, 30) as robot, robot.lease() as lease:
            hold(robot, lease, SPEED_MPS)
            wait_until(lambda: bool(neighbour.of("safety/state")), neighbour.listen)
            yield neighbour, robot, lease
        close_session(neighbour.session)


def test_a_holder_whose_lease_somebody_else_uses_loses_it_and_the_robot_stops() -> None:
    """Even if the neighbour goes on: the holder's program ends and releases the lease."""
    with driving() as (neighbour, robot, lease):
        number = lease.number

        def both() -> None:
            neighbour.listen()
            hold(robot, lease, SPEED_MPS)
            neighbour.drive(number, (neighbour.state()["accepted_seq"] or 0) + 3)

        with pytest.raises(LeaseLost, match="did not send"):
            wait_until(lambda: False, both)

        def he_alone() -> None:
            neighbour.listen()
            neighbour.drive(number, (neighbour.state()["accepted_seq"] or 0) + 3)

        wait_until(lambda: not robot.state().state.lease_holder and not robot.state().state.engaged, he_alone)
        assert robot.state().state.stop_reason is Reason.LEASE_RELEASED


@pytest.mark.parametrize(
    "forged",
    [
        by_night({"lease_holder": "", "tick": 2**40}),
        by_night({"lease_holder": "neighbour"}),
        {"state": "stopping", "engaged": False, "stop_reason": "remote_stop"},
        by_night({"accepted_seq": 10**9}),
    ],
)
def test_a_forged_state_a_second_takes_the_robot_from_nobody(forged: dict[str, object]) -> None:
    """The robot's own states refute it."""
    with driving() as (neighbour, robot, lease):

        def drive() -> None:
            neighbour.listen()
            hold(robot, lease, SPEED_MPS)

        def forge() -> None:
            drive()
            neighbour.forge(travel_delay_m=FAR_M)

        wait_until(lambda: robot.state().state.travel_delay_m == FAR_M, forge)
        for _ in range(3):
            neighbour.forge(**forged)
            until = len(neighbour.of("safety/state")) + 40
            wait_until(partial(neighbour.has_heard, until), drive)
        wait_until(lambda: lease.is_engaged, drive)
