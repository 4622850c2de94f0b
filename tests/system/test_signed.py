"""A robot in signed mode, as its people and its enemies meet it: real processes, real Zenoh, real keys."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
import zenoh

from gateway.client import remote_stop
from gateway.client.refusal import LeaseLost, Refused, Unreachable
from gateway.client.robot import Lease, Robot
from gateway.zenoh.client import close_session, open_session
from schemas import codec, keys
from schemas.authority.statement import chain_text
from schemas.decisions import Journal, Reply, SafetyState
from schemas.exit_codes import CommandError
from schemas.journal import Kind
from schemas.messages import RobotState
from schemas.reasons import Reason
from schemas.requests import Drive
from schemas.settings import AuthoritySettings, Settings, ZenohSettings
from schemas.subjects import BY_NAME, BY_VERB
from tests.support.authority import DAY_S, Party
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, chassis, gateway
from tests.support.signed_site import LIMIT_MPS, OPERATOR, ROBOT, ROOT, WANTED_MPS, Site, driving
from tests.support.waiting import wait_until


@contextmanager
def running(site: Site) -> Iterator[Running]:
    """The robot's gateway, on a virtual chassis."""
    with chassis() as (_, address), gateway(address, site.endpoint, "--config", site.robot_settings) as process:
        yield process


@contextmanager
def stranger(site: Site) -> Iterator[zenoh.Session]:
    """A session of somebody who is on the network and has no key."""
    session = open_session(ZenohSettings(), [site.endpoint], [])
    try:
        yield session
    finally:
        close_session(session)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    """A fleet of this test."""
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
        process.wait_says("stopped: the robot is told nothing, and stands")
    with running(site), pytest.raises(Unreachable, match="the grant was revoked"):
        Robot.connect(ROBOT, settings=site.settings)


def test_nothing_that_a_stranger_sends_moves_the_robot_but_a_stop(site: Site) -> None:
    """Verbs and drives without proof, and those of the holder again; the stop of anybody is served."""
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
    """Neither those of before, nor those of a former run; a robot that was restarted is believed."""
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
    """Is a state believed that was published after this time?"""
    try:
        return robot.state().state.time_ns > time_ns
    except Unreachable:
        return False


def refusals(session: zenoh.Session, verb: str, lease: Lease) -> set[Reason]:
    """The reasons for which the robot refuses a verb that nobody signed, in the holder's name."""
    payload = msgspec.msgpack.encode({"lease": lease.number})
    replies = session.get(keys.command(ROOT, ROBOT, OPERATOR, verb), payload=payload, timeout=1.0)
    return {
        msgspec.msgpack.decode(reply.ok.payload.to_bytes(), type=Reply).reason
        for reply in replies
        if reply.ok is not None
    }


def test_an_impostor_is_not_believed(site: Site) -> None:
    """Neither a gateway of another fleet under the robot's name, nor an operator of one."""
    (site.directory / "other").mkdir()
    other = Site(site.directory / "other")
    other.endpoint = site.endpoint
    with running(other), pytest.raises(Unreachable, match="not met"):
        Robot.connect(ROBOT, settings=site.settings, timeout_s=3.0)
    with running(site):
        settings = msgspec.structs.replace(other.settings, zenoh=site.settings.zenoh)
        with pytest.raises(Unreachable, match="not met"):
            Robot.connect(ROBOT, settings=settings, timeout_s=3.0)


def test_a_grant_without_a_verb_gets_the_others(site: Site) -> None:
    """A viewer-like grant may hold no lease; what it lacks is named."""
    bob = Party("bob")
    site.fleet.authority.grant(bob, verbs=["acquire", "release", "renew"], **site.holds)
    with running(site), Robot.connect(ROBOT, settings=site.settings_of("operator", bob)) as robot:
        assert robot.operator == "bob"
        with robot.lease() as lease, pytest.raises(Refused) as refused:
            lease.engage()
        assert refused.value.reason is Reason.NOT_GRANTED


def test_a_stop_of_somebody_with_a_grant_is_signed(site: Site) -> None:
    """After one without a proof, which waits for nothing: the journal says who it was, and what proves it."""
    with standing(site) as session:
        report = remote_stop.stop_from_here(site.settings, ROBOT, "", 30)
        assert (report.stopped, report.refused, report.unconfirmed) == ([ROBOT], {}, {})
        reasons = stops_in_the_journal(session)
        assert set(reasons) == {OPERATOR}
        assert reasons[OPERATOR][0] is Reason.PROOF_MISSING
        assert Reason.NONE in reasons[OPERATOR]


@contextmanager
def standing(site: Site) -> Iterator[zenoh.Session]:
    """The robot, whose wheels are seen to stand, and a session of somebody without a key."""
    with running(site), stranger(site) as session:
        states = session.declare_subscriber(f"{ROOT}/{ROBOT}/state", zenoh.handlers.RingChannel(1))

        def stands() -> bool:
            sample = states.try_recv()
            state = None if sample is None else codec.decode(BY_NAME["state"], sample.payload.to_bytes())
            return isinstance(state, RobotState) and state.speed_mps == 0.0

        wait_until(stands)
        yield session


def stops_in_the_journal(session: zenoh.Session) -> dict[str, list[Reason]]:
    """What became of the proofs of the stops that the robot received, in their order, by operator."""
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
    """A piece of the journal, from this sequence on; empty where it ends."""
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
        lambda files: (files / "operator.key").chmod(0o644),
        lambda files: (files / "operator.key").write_text("x"),
        lambda files: (files / "operator.grant").unlink(),
        lambda files: (files / "operator.grant").write_text("x"),
        _in_other_hands,
        lambda files: (files / "authority.json").unlink(),
        lambda files: (files / "authority.json").write_text("{}"),
    ],
)
def test_a_stop_fails_for_no_file(site: Site, damage: Callable[[Path], None]) -> None:
    """It goes out, stops the robot, and is seen to."""
    damage(Path(site.settings.authority.directory))
    with standing(site) as session:
        assert remote_stop.stop_from_here(site.settings, ROBOT, "desk", 30).stopped == [ROBOT]
        reasons = stops_in_the_journal(session)
        assert set(reasons) == {"desk"}
        assert Reason.NONE not in reasons["desk"]


@pytest.mark.parametrize(("from_s", "until_s"), [(-DAY_S, -60), (3600, DAY_S)])
def test_a_stop_fails_for_no_grant_that_is_over_and_for_no_clock(site: Site, from_s: int, until_s: int) -> None:
    """Its proof is refused, and the robot stops."""
    now_s = int(time.time())
    site.fleet.authority.grant(site.operator, not_before=now_s + from_s, not_after=now_s + until_s)
    grant = Path(site.settings.authority.directory) / "operator.grant"
    grant.write_text(chain_text(site.operator.chain[:1]))
    with standing(site) as session:
        assert remote_stop.stop_from_here(site.settings, ROBOT, "", 30).stopped == [ROBOT]
        assert Reason.NONE not in stops_in_the_journal(session)[OPERATOR]


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda files: (files / "robot.key").unlink(), "robot.key is not there"),
        (lambda files: (files / "robot.key").chmod(0o644), "can be read by others: chmod 600"),
        (lambda files: (files / "robot.grant").write_text("x"), "robot.grant is no grant"),
        (lambda files: (files / "authority.json").write_text("{}"), "authority.json is damaged"),
    ],
)
def test_a_robot_whose_files_are_wrong_publishes_and_does_not_arm(site: Site, damage: object, said: str) -> None:
    """The line in its log names the file and the cure; so does the refusal to engage."""
    assert callable(damage)
    damage(Path(site.robot_settings).parent)
    with running(site) as process, stranger(site) as session:
        process.wait_says(said)
        state = session.declare_subscriber(f"{ROOT}/{ROBOT}/state", zenoh.handlers.RingChannel(1))
        wait_until(lambda: state.try_recv() is not None)
        with pytest.raises(Unreachable, match="not met"):
            Robot.connect(ROBOT, settings=site.settings, timeout_s=2.0)


def test_an_operator_without_a_key_is_told_which_file_is_missing(tmp_path: Path) -> None:
    """Before anything is sent."""
    settings = Settings(authority=AuthoritySettings(mode="signed", directory=str(tmp_path)))
    with pytest.raises(CommandError, match=r"operator\.key is not there; 'cruiser provision operator' makes it"):
        Robot.connect(ROBOT, settings=settings)
