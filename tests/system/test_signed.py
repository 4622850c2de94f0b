"""A robot in signed mode, with its operators and attackers: real processes, Zenoh and keys."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Self

import msgspec
import pytest
import zenoh

from gateway.authority.session import Unmet
from gateway.client import remote_stop
from gateway.client.refusal import LeaseLost, Refused, Unreachable, is_idle
from gateway.client.robot import Lease, Robot
from gateway.zenoh.operator import StatementPort
from schemas import codec, keys
from schemas.authority.proof import chain_text
from schemas.command_line import ExitCode
from schemas.decisions import Journal, Reply, SafetyState, StatementReply
from schemas.journal import Kind
from schemas.messages import RobotState
from schemas.reasons import Reason
from schemas.requests import Drive, Renew
from schemas.settings import ZenohSettings
from schemas.subjects import BY_NAME, BY_VERB
from schemas.zenoh_session import close_session, open_session
from tests.support.authority import DAY_S, Fleet, Party
from tests.support.fakes.peer import free_endpoint
from tests.support.nights import by_night
from tests.support.processes.gateway import Managed, Running, chassis, gateway, run
from tests.support.provisioned import write_authority
from tests.support.signed_site import LIMIT_MPS, OPERATOR, ROBOT, ROOT, WANTED_MPS, Site, driving
from tests.support.waiting import DEADLINE_S, wait_until


@contextmanager
def running(site: Site) -> Iterator[Running]:
    words = ("--config", site.robot_settings)
    with chassis() as (_, address), gateway(address, site.endpoint, *words, kind=Managed) as process:
        yield process


@contextmanager
def stranger(site: Site) -> Iterator[zenoh.Session]:
    session = open_session(ZenohSettings(), [site.endpoint], [])
    try:
        yield session
    finally:
        close_session(session)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


def test_an_operator_drives_within_the_grant_until_it_is_revoked(site: Site) -> None:
    """The speed limit is the grant's. A revocation in mid-drive stops the robot, and outlives a restart."""
    revoked = site.fleet.authority.revoke(1, keys=(site.operator.key,)).text()
    with running(site) as process, stranger(site) as session:
        with driving(site) as (robot, lease):
            assert robot.operator == OPERATOR
            assert robot.state().state.speed_limit_mps == LIMIT_MPS
            assert site.show(session, revoked).ok
            with pytest.raises(LeaseLost) as lost:
                wait_until(lambda: False, lambda: lease.drive(WANTED_MPS))
            assert lost.value.reason is Reason.GRANT_REVOKED
        process.wait_says("stopping: the grant was revoked")
        process.wait_says("stopped: at standstill, no commands sent")
    with running(site), pytest.raises(Refused, match="it refuses the grant: the grant was revoked") as refused:
        Robot.connect(ROBOT, settings=site.settings)
    assert refused.value.reason is Reason.GRANT_REVOKED


class Flood:
    """Queries of a stranger, as many as one Python thread sends."""

    def __init__(self, site: Site, send: Callable[[zenoh.Session], None]) -> None:
        self.sent = 0
        self._site, self._send = site, send
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        wait_until(lambda: self.sent > 2000)
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()

    def _run(self) -> None:
        with stranger(self._site) as session:
            while not self._ends.is_set():
                self._send(session)
                self.sent += 1


def showing(forge: Callable[[], bytes]) -> Callable[[zenoh.Session], None]:
    def send(session: zenoh.Session) -> None:
        session.get(
            keys.authority(ROOT, ROBOT),
            zenoh.handlers.RingChannel(1),
            payload=forge(),
            attachment=os.urandom(16),
            timeout=0.3,
            congestion_control=zenoh.CongestionControl.DROP,
        )

    return send


@pytest.mark.parametrize("flood", [by_night("junk"), "lists in the authority's name"])
def test_no_flood_of_statements_keeps_a_revocation_out(site: Site, flood: str) -> None:
    """Shown as ``cruiser provision show`` does it, until the robot answers."""
    revoked = site.fleet.authority.revoke(1, keys=(site.operator.key,))

    def forge() -> bytes:
        if flood == "junk":
            return b"xxx"
        return msgspec.structs.replace(revoked, signature=os.urandom(64)).text().encode()

    with (
        running(site),
        StatementPort(open_session(ZenohSettings(), [site.endpoint], []), ROOT) as port,
        Robot.connect(ROBOT, settings=site.settings),
    ):
        with Flood(site, showing(forge)):
            said = port.show(ROBOT, revoked.text().encode(), os.urandom(16), DEADLINE_S)
            assert said is not None
            assert msgspec.msgpack.decode(said.payload, type=StatementReply).ok
        with pytest.raises(Refused, match="the grant was revoked"):
            Robot.connect(ROBOT, settings=site.settings)


@pytest.mark.parametrize("flood", [by_night("junk"), "the operator's grant, forged"])
def test_no_flood_of_statements_keeps_operators_out(site: Site, flood: str) -> None:
    """A robot answers those with a grant of its authority in their turn."""
    forged = msgspec.structs.replace(site.operator.chain[0], signature=bytes(64)).text().encode()
    with (
        running(site),
        Flood(site, showing(lambda: forged if "forged" in flood else b"xxx")),
        Robot.connect(ROBOT, settings=site.settings, timeout_s=DEADLINE_S) as robot,
    ):
        assert robot.operator == OPERATOR


def test_no_flood_of_wrongly_signed_verbs_keeps_the_holder_from_its_robot(site: Site) -> None:
    """They name the holder's grant and lease and the newest challenge. The lease can still be acquired."""
    grant, held = site.operator.chain[0].id, [0]
    with running(site) as process, Robot.connect(ROBOT, settings=site.settings) as robot:

        def send(session: zenoh.Session) -> None:
            session.get(
                keys.command(ROOT, ROBOT, OPERATOR, "renew"),
                zenoh.handlers.RingChannel(1),
                payload=msgspec.msgpack.encode({"lease": held[0]}),
                encoding=BY_VERB["renew"].encoding,
                attachment=b"\1" + grant + robot.state().state.challenge + os.urandom(8 + 64 + 16),
                timeout=0.3,
                congestion_control=zenoh.CongestionControl.DROP,
            )

        robot.wait_for(lambda state: is_idle(state.blocked_by), 30)
        leases: list[Lease] = []
        with Flood(site, send), ExitStack() as stack:

            def acquire() -> None:
                # A machine that falls behind drops some unread, whoever sent them; none is refused as busy.
                with suppress(Unreachable):
                    leases.append(stack.enter_context(robot.lease()))

            wait_until(lambda: leases, acquire)
            lease = leases[0]
            held[0] = lease.number
            renewed = 0
            for _ in range(40):
                with suppress(Unreachable):
                    renewed += robot.ask(Renew(lease=lease.number), 1.0).ok
            assert renewed > 20
            assert robot.state().state.lease_holder == OPERATOR
        assert process.stop() == 0


def test_nothing_that_a_stranger_sends_moves_the_robot_but_a_stop(site: Site) -> None:
    """Verbs and drives without proof, and replays of the holder's; anybody's stop works."""
    with running(site) as process, stranger(site) as session, driving(site) as (robot, lease):
        kept = session.declare_subscriber(f"{ROOT}/{ROBOT}/@cmd/*/drive", zenoh.handlers.RingChannel(64))
        wait_until(lambda: bool(refusals(session, "release", lease)))
        assert refusals(session, "release", lease) <= {Reason.PROOF_MISSING}
        for _ in range(50):
            payload = msgspec.msgpack.encode(
                Drive(
                    lease=lease.number,
                    seq=10**6,
                    challenge=robot.state().state.challenge,
                    speed_mps=2.0,
                    angle_deg=20.0,
                )
            )
            key = keys.command(ROOT, ROBOT, OPERATOR, "drive")
            session.put(key, payload, encoding=BY_VERB["drive"].encoding)
            while (heard := kept.try_recv()) is not None:
                if heard.attachment is not None:
                    session.put(key, heard.payload, encoding=heard.encoding, attachment=heard.attachment)
            lease.drive(WANTED_MPS)
            state = robot.state().state
            assert abs(state.target_speed_mps) <= WANTED_MPS
            assert state.target_angle_deg == 0.0
        session.put(keys.command(ROOT, ROBOT, "anybody", "stop"), b"")
        process.wait_says(r"a remote stop was received; by anybody \(unproven\)")


def test_states_that_somebody_repeats_are_not_believed(site: Site) -> None:
    """Of this run or of a former one; a restarted robot is believed."""
    between = free_endpoint()
    settings = msgspec.structs.replace(
        site.settings, zenoh=ZenohSettings(connect=[*site.settings.zenoh.connect, between])
    )
    state_key = f"{ROOT}/{ROBOT}/safety/state"
    subject = BY_NAME["safety/state"]
    session = open_session(ZenohSettings(), [site.endpoint], [between])
    try:
        states = session.declare_subscriber(
            state_key, zenoh.handlers.RingChannel(64), allowed_origin=zenoh.Locality.REMOTE
        )
        kept: list[zenoh.Sample] = []

        def keep() -> bool:
            while (heard := states.try_recv()) is not None:
                kept.append(heard)
            return len(kept) >= 20

        seen: list[SafetyState] = []

        def look(robot: Robot) -> None:
            for one in kept:
                session.put(state_key, one.payload, encoding=subject.encoding, attachment=one.attachment)
            # What nobody signed arrives too: who repeats is on the way, and is heard.
            session.put(state_key, b"", encoding=subject.encoding)
            seen.append(robot.state().state)

        with running(site) as process, Robot.connect(ROBOT, settings=settings) as robot:
            wait_until(keep)
            wait_until(lambda: len({one.tick for one in seen}) > 20, lambda: look(robot))
            assert [one.tick for one in seen] == sorted(one.tick for one in seen)
            assert "is not signed by the robot" in robot._link.unreadable
            process.stop()
            ended_ns = time.time_ns()
            with running(site):
                wait_until(lambda: is_heard_since(robot, ended_ns))
                del seen[:]
                wait_until(lambda: len({one.tick for one in seen}) > 20, lambda: look(robot))
                assert [one.tick for one in seen] == sorted(one.tick for one in seen)
                assert min(one.time_ns for one in seen) > ended_ns
    finally:
        close_session(session)


def is_heard_since(robot: Robot, time_ns: int) -> bool:
    try:
        return robot.state().state.time_ns > time_ns
    except Unreachable:
        return False


def refusals(session: zenoh.Session, verb: str, lease: Lease) -> set[Reason]:
    """The robot's reasons to refuse an unsigned verb in the holder's name."""
    payload = msgspec.msgpack.encode({"lease": lease.number})
    replies = session.get(keys.command(ROOT, ROBOT, OPERATOR, verb), payload=payload, timeout=1.0)
    return {
        msgspec.msgpack.decode(reply.ok.payload.to_bytes(), type=Reply).reason
        for reply in replies
        if reply.ok is not None
    }


def test_an_impostor_is_not_believed(site: Site) -> None:
    """A gateway of another fleet under the robot's name, or an operator of one."""
    (site.directory / "other").mkdir()
    other = Site(site.directory / "other")
    other.endpoint = site.endpoint
    with (
        running(other),
        pytest.raises(
            Refused, match="not verified: the robot's own grant is signed by the authority's key"
        ) as unmet,
    ):
        Robot.connect(ROBOT, settings=site.settings, timeout_s=3.0)
    assert unmet.value.reason is Reason.GRANT_UNKNOWN
    with running(site):
        settings = msgspec.structs.replace(other.settings, zenoh=site.settings.zenoh)
        with pytest.raises(Refused, match="not verified"):
            Robot.connect(ROBOT, settings=settings, timeout_s=3.0)


def test_a_stop_of_somebody_with_a_grant_is_signed(site: Site) -> None:
    """Besides unsigned ones, which wait for nothing: the journal has the operator and the proof."""
    with standing(site) as session:
        report = remote_stop.stop_from_here(site.settings, ROBOT, "", 30)
        assert (report.stopped, report.refused, report.unconfirmed) == ([ROBOT], {}, {})
        reasons = stops_in_the_journal(session)
        assert set(reasons) == {OPERATOR}
        # Those that were put before the robot's subscription was known here never left.
        assert {Reason.NONE} <= set(reasons[OPERATOR]) <= {Reason.NONE, Reason.PROOF_MISSING}


@contextmanager
def standing(site: Site) -> Iterator[zenoh.Session]:
    """The robot at standstill, and a session of a stranger."""
    with running(site), stranger(site) as session:
        states = session.declare_subscriber(f"{ROOT}/{ROBOT}/state", zenoh.handlers.RingChannel(1))

        def stands() -> bool:
            sample = states.try_recv()
            state = None if sample is None else codec.decode(BY_NAME["state"], sample.payload.to_bytes())
            return isinstance(state, RobotState) and state.speed_mps == 0.0

        wait_until(stands)
        yield session


def stops_in_the_journal(session: zenoh.Session) -> dict[str, list[Reason]]:
    """The rulings on the proofs of all stops received, in order, by operator."""
    found: dict[str, list[Reason]] = {}
    first = 0
    while pieces := journal_from(session, first):
        first = pieces[-1].sequence + 1
        for journal in pieces:
            for kind, *said in msgspec.msgpack.decode(journal.inputs):
                if kind == Kind.REQUEST and said[2] == "stop":
                    found.setdefault(said[3], []).append(Reason(said[-1][0]))
    return found


def journal_from(session: zenoh.Session, first: int) -> list[Journal]:
    """A piece of the journal from this sequence on; empty at its end."""
    key = f"{ROOT}/{ROBOT}/journal?first={first}"
    replies = session.get(key, consolidation=zenoh.ConsolidationMode.NONE, timeout=5.0)
    payloads = [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
    return [found for one in payloads if isinstance(found := codec.decode(BY_NAME["journal"], one), Journal)]


def _in_other_hands(files: Path) -> None:
    (files / "operator.grant").write_text(chain_text(Party("bob").grant(Party("bob"))))


@pytest.mark.parametrize(
    "damage",
    [
        lambda files: (files / "operator.key").unlink(),
        by_night(lambda files: (files / "operator.key").chmod(0o644)),
        by_night(lambda files: (files / "operator.key").write_text("x")),
        by_night(lambda files: (files / "operator.grant").unlink()),
        by_night(lambda files: (files / "operator.grant").write_text("x")),
        _in_other_hands,
    ],
)
def test_a_stop_fails_for_no_file(site: Site, damage: Callable[[Path], None]) -> None:
    """It is sent, stops the robot, and is confirmed."""
    damage(Path(site.settings.authority.directory))
    with standing(site) as session:
        assert remote_stop.stop_from_here(site.settings, ROBOT, "desk", 30).stopped == [ROBOT]
        reasons = stops_in_the_journal(session)
        assert set(reasons) == {"desk"}
        assert Reason.NONE not in reasons["desk"]


def test_a_stop_whose_answer_cannot_be_verified_is_said_to_be_that(site: Site) -> None:
    """The operator's own files are wrong: the robot stops, and cannot be verified."""
    write_authority(Path(site.settings.authority.directory), Fleet())
    with standing(site) as session:
        assert "the robot's own grant is signed by the authority's key" in doubt_of_a_stop(site, "desk").text
        assert stops_in_the_journal(session)


@pytest.mark.night
@pytest.mark.parametrize("name", ["robot.key", "robot.grant"])
def test_a_stop_of_a_robot_without_its_own_files_is_no_silence(site: Site, name: str) -> None:
    """It stops, and cannot sign that. ``cruiser why`` shows file and cure as unverified."""
    (Path(site.robot_settings).parent / name).unlink()
    configuration = str(Path(site.settings.authority.directory) / "cruiser.toml")
    with standing(site):
        word = doubt_of_a_stop(site, "")
        assert word.text.startswith("it does not prove its identity: its keys may be missing or damaged")
        done = run(["why", ROBOT, "--connect", site.endpoint, "--config", configuration, "--timeout", "3"])
        assert done.returncode == ExitCode.FAILURE, done.stderr
        first, *lines = done.stdout.splitlines()
        assert first.startswith(f"{ROBOT}: UNVERIFIED: it does not prove its identity")
        assert any(f"{name} is not there; 'cruiser provision " in line for line in lines), done.stdout
        assert any(line.startswith("  remote_stop: ") for line in lines), done.stdout
        listed = run(["list", "--connect", site.endpoint, "--config", configuration])
        assert f"{name} is not there" in listed.stdout


def doubt_of_a_stop(site: Site, operator: str) -> Unmet:
    """Why the answer of a stopped robot cannot be verified."""
    report = remote_stop.stop_from_here(site.settings, ROBOT, operator, 3)
    assert (report.stopped, report.refused, report.unconfirmed, report.silent) == ([], {}, {}, [])
    return report.unverified[ROBOT]


@pytest.mark.parametrize(("from_s", "until_s"), [(-DAY_S, -60), by_night(3600, DAY_S)])
def test_a_stop_fails_for_no_grant_that_is_over_and_for_no_clock(site: Site, from_s: int, until_s: int) -> None:
    """Its proof is refused, and the robot stops."""
    now_s = int(time.time())
    site.fleet.authority.grant(site.operator, not_before=now_s + from_s, not_after=now_s + until_s)
    grant = Path(site.settings.authority.directory) / "operator.grant"
    grant.write_text(chain_text(site.operator.chain[:1]))
    with standing(site) as session:
        assert remote_stop.stop_from_here(site.settings, ROBOT, "", 30).stopped == [ROBOT]
        assert Reason.NONE not in stops_in_the_journal(session)[OPERATOR]


def test_a_robot_whose_files_are_wrong_publishes_and_does_not_arm(site: Site) -> None:
    """Its log and its refusal to engage name file and cure."""
    (Path(site.robot_settings).parent / "robot.key").unlink()
    with running(site) as process, stranger(site) as session:
        process.wait_says("robot.key is not there")
        state = session.declare_subscriber(f"{ROOT}/{ROBOT}/state", zenoh.handlers.RingChannel(1))
        wait_until(lambda: state.try_recv() is not None)
        with pytest.raises(Refused, match="not verified"):
            Robot.connect(ROBOT, settings=site.settings, timeout_s=2.0)
