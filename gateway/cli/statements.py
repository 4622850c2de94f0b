"""``cruiser provision show``: statements of the authority, shown to robots, and their answers."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, Self

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.authority.enrolment import EnrolmentError, chain_of
from gateway.authority.operator_proof import OperatorProof, new_question
from gateway.provisioning.key_store import KeyStore, read_input
from gateway.provisioning.machine_keys import ZENOH_FILE
from gateway.provisioning.tls_files import check_kinds
from gateway.telemetry.received import Received
from gateway.zenoh.statements import StatementPort
from schemas.authority.identity import AUTHORITY_FILE
from schemas.authority.proof import Revocations, Rotation, Signed, chain_text
from schemas.authority.trust import AuthorityKeys
from schemas.codec import PAYLOAD_ERRORS
from schemas.command_line import CommandError, ExitCode, plain
from schemas.decisions import StatementReply
from schemas.reasons import Reason
from schemas.settings import Settings
from schemas.zenoh_session import place

SENDERS: Final = ("desk", "operator", "viewer")
"""The roles whose certificate is used, in order of preference, if the settings name none."""

Stopped = Callable[[], bool]


class _Answer(msgspec.Struct, frozen=True):
    """The result of a statement at one robot."""

    text: str
    code: ExitCode


def run_show(arguments: argparse.Namespace, settings: Settings, store: KeyStore, stopped: Stopped) -> ExitCode:
    """Show robots a statement, once or again and again.

    Raises:
        CommandError: the file holds no statement, or Zenoh cannot be opened.
    """
    file = Path(arguments.statement)
    try:
        chain = chain_of(read_input(file))
    except EnrolmentError as error:
        raise CommandError(f"{plain(str(file))}: {error}", ExitCode.USAGE) from error

    def show(port: StatementPort, robot: str) -> _Answer:
        return _judge(_Shown.to(port, robot, chain, arguments.timeout), robot, chain, settings, store)

    settings = _reaching(settings, store)
    with StatementPort.open(settings) as port:
        while True:
            robots = arguments.robot or port.robots(arguments.timeout)
            answers = {robot: show(port, robot) for robot in robots if not stopped()}
            for robot, answer in answers.items():
                sys.stdout.write(f"{robot}: {plain(answer.text)}\n")
            if not robots:
                sys.stderr.write(f"no robot is connected at {place(settings.zenoh)}\n")
            if not settings.zenoh.config and all(one.code is ExitCode.UNREACHABLE for one in answers.values()):
                sys.stderr.write(
                    f"no Zenoh file was used: {plain(str(store.directory))} has none of a desk, an operator or a "
                    "viewer; --config names the settings of one, such as viewer.toml\n"
                )
            sys.stdout.flush()
            if arguments.every is None or stopped():
                return _code([answer.code for answer in answers.values()])
            next_s = time.monotonic() + arguments.every
            while time.monotonic() < next_s and not stopped():
                time.sleep(0.1)
            if stopped():
                return ExitCode.OK


def _code(codes: list[ExitCode]) -> ExitCode:
    if not codes:
        return ExitCode.UNREACHABLE
    return codes[0] if len(set(codes)) == 1 else ExitCode.PARTIAL


class _Shown(msgspec.Struct, frozen=True):
    """A robot's answer to a statement, and the question that the answer has to cover."""

    question: bytes
    reply: Received | None

    @classmethod
    def to(cls, port: StatementPort, robot: str, chain: list[Signed], timeout_s: float) -> Self:
        question = new_question()
        return cls(question, port.show(robot, chain_text(chain).encode(), question, timeout_s))


def _judge(shown: _Shown, robot: str, chain: list[Signed], settings: Settings, store: KeyStore) -> _Answer:
    reply = shown.reply
    if reply is None:
        return _Answer("does not answer", ExitCode.UNREACHABLE)
    try:
        said = msgspec.msgpack.decode(reply.payload, type=StatementReply)
    except PAYLOAD_ERRORS as error:
        return _Answer(f"its answer cannot be read: {error}", ExitCode.FAILURE)
    doubt = _doubt(reply, shown.question, robot, chain, said, settings, store)
    if doubt:
        return _Answer(f"{'yes' if said.ok else 'no'}, and the answer is not proven: {doubt}", ExitCode.FAILURE)
    if said.ok:
        return _Answer("taken over", ExitCode.OK)
    if said.reason is Reason.REPLAYED and isinstance(chain[0].statement, Revocations | Rotation):
        return _Answer(f"has it, or a newer one ({said.detail})", ExitCode.OK)
    return _Answer(f"refused: {said.detail}; {said.cure}", ExitCode.REFUSED)


def _doubt(
    reply: Received,
    question: bytes,
    robot: str,
    chain: list[Signed],
    said: StatementReply,
    settings: Settings,
    store: KeyStore,
) -> str:
    """Return why the answer may be somebody else's; empty if the robot signed it."""
    if not store.has(AUTHORITY_FILE):
        return f"{store.path(AUTHORITY_FILE)} is not there"
    trust = store.read_as(AUTHORITY_FILE, AuthorityKeys, "'cruiser provision install' writes it").trust
    # A key of its own: nothing is signed with it.
    proof = OperatorProof(
        Ed25519PrivateKey.generate(), chain, trust, settings.robot.root, lambda: int(time.time())
    )
    refusal = proof.meet(robot, reply, question)
    if refusal is None or (not said.ok and refusal.reason is said.reason and refusal.detail == said.detail):
        return ""
    return refusal.text


def _reaching(settings: Settings, store: KeyStore) -> Settings:
    """The settings, with the Zenoh file of who is provisioned here where they name none."""
    if settings.zenoh.config:
        return settings
    found = [name for who in SENDERS if store.has(name := ZENOH_FILE.format(who=who))]
    if not found:
        return settings
    check_kinds(store.path(found[0]))
    zenoh = msgspec.structs.replace(settings.zenoh, config=str(store.path(found[0])))
    return msgspec.structs.replace(settings, zenoh=zenoh)
