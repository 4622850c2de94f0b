"""Somebody on the same Zenoh network answers in a robot's place."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import msgspec
import zenoh

from schemas import keys
from schemas.command_line import ExitCode
from schemas.decisions import Reply
from schemas.reasons import Reason
from schemas.settings import ZenohSettings
from schemas.subjects import BY_VERB
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import ROOT
from tests.support.processes.gateway import Managed, chassis, gateway, run, wait_for_chassis
from tests.support.signed_site import Site
from tests.support.waiting import wait_until

ROBOT = "cruiser-1"
STOP = BY_VERB["stop"]


@contextmanager
def impostor(listen: str, connect: list[str], *, ok: bool) -> Iterator[None]:
    """Answers every stop at once: that it stops, or that it cannot."""
    session = open_session(ZenohSettings(), connect, [listen])
    queries = session.declare_queryable(
        keys.command(ROOT, ROBOT, keys.ALL, STOP.verb), zenoh.handlers.RingChannel(64), complete=True
    )
    ended = threading.Event()
    reason = Reason.NONE if ok else Reason.BUS_DOWN
    reply = msgspec.msgpack.encode(Reply(ok=ok, reason=reason, detail="the robot stands", cure=""))

    def answer() -> None:
        while not ended.wait(0.001):
            while (query := queries.try_recv()) is not None:
                with query:
                    query.reply(query.key_expr, reply, encoding=STOP.reply_encoding)

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        close_session(session)


def test_a_stop_that_only_an_impostor_answers_is_not_believed() -> None:
    """With the gateway dead, the robot is not reported as stopped."""
    endpoint = free_endpoint()
    with chassis() as (_, address), gateway(address, endpoint) as running:
        running.stop(signal.SIGKILL)
        with impostor(endpoint, [], ok=True):
            done = run(["stop", ROBOT, "--connect", endpoint, "--timeout", "2"])
    assert done.returncode == ExitCode.PARTIAL
    assert done.stdout == ""
    assert done.stderr.startswith(f"{ROBOT}: NOT CONFIRMED STOPPED: ")
    assert "button" in done.stderr


def test_replies_that_contradict_each_other_are_said_to() -> None:
    """The robot stops, and the user learns that somebody answers in its place."""
    endpoint = free_endpoint()
    with (
        chassis() as (_, address),
        gateway(address, endpoint),
        impostor(free_endpoint(), [endpoint], ok=False),
    ):
        wait_for_chassis(endpoint)

        def is_contradicted() -> bool:
            done = run(["stop", ROBOT, "--connect", endpoint])
            if done.returncode == ExitCode.OK:
                assert (done.stdout, done.stderr) == (f"{ROBOT}: stopped, latched until a reset\n", "")
                return False
            assert (done.returncode, done.stdout) == (ExitCode.PARTIAL, "")
            return "contradict each other" in done.stderr

        # On a busy machine one of the two may reply when the command has ended.
        wait_until(is_contradicted)


# Somebody else has a robot's name on the network, before the robot's own gateway starts.


INFO: Final = "fleet/cruiser-1/gateway/info"


@contextmanager
def stranger() -> Iterator[tuple[zenoh.Session, str]]:
    """A node that is there first. Yields its session and endpoint."""
    endpoint = free_endpoint()
    session = open_session(ZenohSettings(), [], [endpoint])
    yield session, endpoint
    close_session(session)


@contextmanager
def squatting(session: zenoh.Session) -> Iterator[None]:
    """Somebody has the robot's token, and answers in its place."""

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(INFO, b"\x80", attachment=bytes(73))

    with (
        session.liveliness().declare_token("fleet/cruiser-1/gateway"),
        session.declare_queryable(INFO, answer, complete=True),
    ):
        yield


def test_in_signed_mode_who_answers_without_a_grant_for_the_name_keeps_no_robot_from_starting(
    tmp_path: Path,
) -> None:
    """Another robot's certificate admits it; the gateway starts, also with renewed files."""
    site = Site(tmp_path)
    with (
        stranger() as (session, endpoint),
        chassis() as (_, address),
        squatting(session),
        gateway(
            address, site.endpoint, "--connect", endpoint, "--config", site.robot_settings, kind=Managed
        ) as running,
    ):
        running.wait_says("its owner does not prove that it was granted this name")
        grant = Path(site.robot_settings).with_name("robot.grant")
        grant.write_bytes(grant.read_bytes())
        running.wait_says("the gateway restarts to load them")
        wait_until(lambda: len([line for line in running.said if "does not prove" in line]) >= 2)
        states = session.declare_subscriber("fleet/cruiser-1/safety/state", zenoh.handlers.RingChannel(1))
        wait_until(lambda: states.try_recv() is not None)
        assert running.stop() == ExitCode.OK
