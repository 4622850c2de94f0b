"""``cruiser provision``: keys, certificates, grants and statements. Private keys stay where they are made."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.authority.enrolment import (
    ENROLLED,
    EnrolmentError,
    EnrolmentRequest,
    FleetPlace,
    TransportRole,
    chain_of,
    read_bundle,
    read_request,
    request_fingerprint,
)
from gateway.authority.operator_proof import OperatorProof, new_question
from gateway.provisioning.issuer import (
    ISSUED_FILE,
    ZENOH_FILE,
    Issuer,
    Wanted,
    ask_again,
    install,
    make_authority,
    make_keys,
    make_standby,
    names_here,
    rotate,
)
from gateway.provisioning.key_files import (
    FOR_ALL,
    STANDBY_FILE,
    KeyStore,
    Passphrase,
    check_kinds,
    naming,
    read_input,
    write_file,
)
from gateway.telemetry.samples import Received
from gateway.zenoh.operator import StatementPort
from schemas.arguments import add_zenoh_arguments, number, robot_name, seconds
from schemas.authority.key_files import AUTHORITY_FILE, directory_of
from schemas.authority.proof import Grant, GrantRole, Revocations, Rotation, Signed, chain_text
from schemas.authority.trust import AuthorityKeys, in_utc, key_fingerprint, keys_fingerprint
from schemas.codec import PAYLOAD_ERRORS
from schemas.command_line import CommandError, ExitCode, UsageError, plain
from schemas.decisions import StatementReply
from schemas.reasons import Reason
from schemas.settings import Settings
from schemas.subjects import BY_VERB, STOP_VERB
from schemas.zenoh_session import place

HOUR_S, DAY_S = 3600, 86_400

PERSON_S, OTHERS_S = 12 * HOUR_S, 90 * DAY_S  # the duration of a grant without ``--lasts``, seconds
ROBOT_VERBS: Final = [verb for verb in BY_VERB if verb != STOP_VERB]  # verbs that want a grant: a stop wants none

PERSONS: Final = (GrantRole.OPERATOR, GrantRole.PROGRAM, GrantRole.SUPERVISOR)

_SPEED: Final = number(0.01, 100, "a speed in m/s")
_LIFE_MAX_S: Final = 3653 * DAY_S

_GRANT_FLAGS: Final = ("robots", "verbs", "role", "override", "speed_limit")
_FOR_ALL: Final = {"robots"}


def add_grant_arguments(parser: argparse.ArgumentParser) -> None:
    grant = parser.add_argument_group("grant", "defaults: the key's last grant, or the values in brackets")
    grant.add_argument(
        "--robots",
        action="append",
        type=matching("[a-z0-9*-]{1,64}", "not a pattern of robots: lower case, digits, '-' and '*'"),
        metavar="PATTERN",
        help="robots of the grant, such as 'depot-*'; may be repeated (all)",
    )
    grant.add_argument("--verbs", type=_verbs, metavar="LIST", help="verbs, separated by commas (all)")
    grant.add_argument(
        "--role",
        choices=[role.value for role in PERSONS],
        metavar="ROLE",
        help="operator, program or supervisor (operator)",
    )
    grant.add_argument("--override", action="store_true", help="right to take the lease of a moving robot")
    grant.add_argument("--speed-limit", type=_SPEED, metavar="M/S", help="speed limit for this holder (none)")
    lasts = grant.add_mutually_exclusive_group()
    lasts.add_argument(
        "--hours", dest="lasts", type=_life(HOUR_S, "hours"), metavar="H", help="life of a person's grant (12)"
    )
    lasts.add_argument(
        "--days", dest="lasts", type=_life(DAY_S, "days"), metavar="D", help="life of other grants (90)"
    )


def wanted_grant(arguments: argparse.Namespace, request: EnrolmentRequest, last: Grant | None) -> Wanted:
    """Return the grant of the flags, completed by the key's last grant, or by defaults."""
    given = [name for name in _GRANT_FLAGS if getattr(arguments, name) not in (None, False)]
    if request.role is not TransportRole.OPERATOR and set(given) - _FOR_ALL:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise UsageError(f"{flags}: not for a {request.role.value}")
    usual_s = PERSON_S if request.role in {TransportRole.OPERATOR, TransportRole.VIEWER} else OTHERS_S
    usual = [] if request.role is TransportRole.RECORDER else ROBOT_VERBS
    last_role = last.role if last and last.role in PERSONS else GrantRole.OPERATOR
    return Wanted(
        verbs=arguments.verbs or (last.verbs if last else usual),
        robots=arguments.robots or (last.robots if last else ["*"]),
        lasts_s=usual_s if arguments.lasts is None else round(arguments.lasts),
        role=GrantRole(arguments.role) if arguments.role else last_role,
        override=arguments.override or (last is not None and last.override),
        speed_limit_mps=arguments.speed_limit or (last.speed_limit_mps if last else None),
    )


def unlimited_warning(arguments: argparse.Namespace, request: EnrolmentRequest, last: Grant | None) -> str:
    """Return a warning if a key without an earlier grant gets everything; else empty.

    A new authority does not know the limits that the former one set.
    """
    is_limited = arguments.robots or arguments.verbs or arguments.speed_limit is not None
    if last is not None or is_limited or request.role is not TransportRole.OPERATOR:
        return ""
    return (
        "this key had no grant here before: it gets all robots, all verbs and no speed limit; limit it with "
        "--robots and --speed-limit"
    )


def grant_line(grant: Grant) -> str:
    limit = "" if grant.speed_limit_mps is None else f", at most {grant.speed_limit_mps:g} m/s"
    override = ", may override" if grant.override else ""
    verbs = "all" if set(grant.verbs) >= set(ROBOT_VERBS) else ", ".join(grant.verbs)
    may = f"{grant.role.value} on {', '.join(grant.robots)}" + (f", verbs {verbs}" if verbs else "")
    return f"{may}{limit}{override}, until {in_utc(grant.not_after)}"


def matching(pattern: str, what: str) -> Callable[[str], str]:
    """Return a reader of arguments that match a pattern; ``what`` completes its error."""

    def checked(text: str) -> str:
        if re.fullmatch(pattern, text) is None:
            raise argparse.ArgumentTypeError(f"{text!a} is {what}")
        return text

    return checked


def _verbs(text: str) -> list[str]:
    names = ROBOT_VERBS if text == "all" else list(dict.fromkeys(text.split(",")))
    unknown = [name for name in names if name not in ROBOT_VERBS]
    if unknown:
        raise argparse.ArgumentTypeError(f"{unknown[0]!a} is not a verb; the verbs are {', '.join(ROBOT_VERBS)}")
    return names


def _life(unit_s: int, units: str) -> Callable[[str], float]:
    read = number(0.01, _LIFE_MAX_S // unit_s, f"a number of {units}")
    return lambda text: read(text) * unit_s


SENDERS: Final = ("desk", "operator", "viewer")  # whose certificate is used, if the settings name none

Stopped = Callable[[], bool]


class _Answer(msgspec.Struct, frozen=True):
    """A robot's result for a statement."""

    text: str
    code: ExitCode


def run_show(arguments: argparse.Namespace, settings: Settings, store: KeyStore, stopped: Stopped) -> ExitCode:
    file = Path(arguments.statement)
    try:
        chain = chain_of(read_input(file))
    except EnrolmentError as error:
        raise UsageError(f"{plain(str(file))}: {error}") from error

    def show(port: StatementPort, robot: str) -> _Answer:
        question = new_question()
        reply = port.show(robot, chain_text(chain).encode(), question, arguments.timeout)
        return _judge(reply, question, robot, chain, settings, store)

    settings = _reaching(settings, store)
    with StatementPort.open(settings) as port:
        while True:
            robots = arguments.robot or port.robots(arguments.timeout)
            answers = {robot: show(port, robot) for robot in robots if not stopped()}
            for robot, answer in answers.items():
                line = {"robot": robot, "result": answer.code.name.lower(), "text": plain(answer.text)}
                sys.stdout.write((json.dumps(line) if arguments.json else f"{robot}: {line['text']}") + "\n")
            if not robots:
                sys.stderr.write(f"no robot is connected at {place(settings.zenoh)}\n")
            if not settings.zenoh.config and all(one.code is ExitCode.UNREACHABLE for one in answers.values()):
                sys.stderr.write(
                    f"no Zenoh file was used: {plain(str(store.directory))} has none for a desk, an operator or a "
                    "viewer; name settings with --config, such as viewer.toml\n"
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


def _judge(
    reply: Received | None, question: bytes, robot: str, chain: list[Signed], settings: Settings, store: KeyStore
) -> _Answer:
    """Return a robot's result for a statement, if its reply is signed for this question."""
    if reply is None:
        return _Answer("no reply", ExitCode.UNREACHABLE)
    try:
        said = msgspec.msgpack.decode(reply.payload, type=StatementReply)
    except PAYLOAD_ERRORS as error:
        return _Answer(f"its reply cannot be read: {error}", ExitCode.FAILURE)
    doubt = _doubt(reply, question, robot, chain, said, settings, store)
    if doubt:
        return _Answer(
            f"{'accepted' if said.ok else 'refused'}, but the reply is not verified: {doubt}", ExitCode.FAILURE
        )
    if said.ok:
        return _Answer("accepted", ExitCode.OK)
    if said.reason is Reason.REPLAYED and isinstance(chain[0].statement, Revocations | Rotation):
        return _Answer(f"already has this one or a newer one ({said.detail})", ExitCode.OK)
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
    """Return why the reply may not be the robot's; empty if the robot signed it."""
    if not store.has(AUTHORITY_FILE):
        return f"{store.path(AUTHORITY_FILE)} is missing"
    trust = store.read_as(AUTHORITY_FILE, AuthorityKeys, "'cruiser provision install' writes it").trust
    # A throw-away key: nothing is signed with it.
    proof = OperatorProof(
        Ed25519PrivateKey.generate(), chain, trust, settings.robot.root, lambda: int(time.time())
    )
    refusal = proof.meet(robot, reply, question)
    if refusal is None or (not said.ok and refusal.reason is said.reason and refusal.detail == said.detail):
        return ""
    return refusal.text


def _reaching(settings: Settings, store: KeyStore) -> Settings:
    """Return settings with a Zenoh file from this directory, if they name none."""
    if settings.zenoh.config:
        return settings
    found = [name for who in SENDERS if store.has(name := ZENOH_FILE.format(who=who))]
    if not found:
        return settings
    check_kinds(store.path(found[0]))
    zenoh = msgspec.structs.replace(settings.zenoh, config=str(store.path(found[0])))
    return msgspec.structs.replace(settings, zenoh=zenoh)


EXAMPLE: Final = """\
  cruiser provision robot cruiser-1                         on the robot: make keys and a request
  cruiser provision sign robot-cruiser-1.request            at the authority: make a bundle
  cruiser provision install robot-cruiser-1.bundle          on the robot
  cruiser provision revoke ann                              at the authority: make a statement
  cruiser provision show revocations.statement --all        on a machine that reaches the robots
docs/authority.md describes how to start a fleet, and what to do about lost or stolen keys."""

TIMEOUT_S: Final = 3.0

ABOUT: Final = {
    TransportRole.ROBOT: "make keys and a request for a robot",
    TransportRole.OPERATOR: "make keys and a request for a person or program that commands robots",
    TransportRole.VIEWER: "make keys and a request for a person who sees robots and may stop one",
    TransportRole.RECORDER: "make keys and a request for a recorder",
    TransportRole.ROUTER: "make keys and a request for the fleet's router",
    TransportRole.DESK: "make keys and a request for a control room's machine",
}


_EXAMPLES: Final = {
    "authority": "--standby standby.pub --router tls/router.example:7447",
    "robot": "cruiser-1",
    "operator": "ann",
    "viewer": "hall",
    "recorder": "depot",
    "router": "router.example",
    "desk": "desk.example",
    "renew": "robot",
    "sign": "operator-ann.request --robots 'depot-*' --hours 12",
    "install": "robot-cruiser-1.bundle --fingerprint F",
    "revoke": "ann",
    "rotate": "authority.json",
    "show": "revocations.statement --all",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(title="actions", dest="action", metavar="ACTION", required=True)

    def add(name: str, about: str) -> argparse.ArgumentParser:
        action = actions.add_parser(
            name,
            help=about,
            description=f"{about[0].upper()}{about[1:]}.",
            epilog=f"example: cruiser provision {name} {_EXAMPLES.get(name, '')}".rstrip(),
        )
        action.add_argument(
            "--directory",
            dest="authority.directory",
            metavar="DIR",
            help="directory of keys, certificates and grants (~/.config/cruiser)",
        )
        return action

    _add_makers(add)
    _add_signers(add)
    _add_statements(add)


Add = Callable[[str, str], argparse.ArgumentParser]


def _add_output(action: argparse.ArgumentParser, what: str) -> None:
    action.add_argument("-o", "--out", metavar="FILE", help=f"file of the {what}")
    _add_replace(action)


def _add_replace(action: argparse.ArgumentParser) -> None:
    action.add_argument("--replace", action="store_true", help="overwrite existing files")


def _add_makers(add: Add) -> None:
    standby = add("standby", "make the key that replaces a lost or stolen authority; store it elsewhere")
    _add_replace(standby)
    _add_passphrase(standby, makes_keys=True)
    authority = add("authority", "make the keys that sign all certificates and grants; keep them offline")
    authority.add_argument("--standby", required=True, metavar="FILE", help=f"{STANDBY_FILE} of the standby")
    authority.add_argument(
        "--router",
        action="append",
        required=True,
        metavar="ENDPOINT",
        help="endpoint of the fleet's router, tls/HOST:PORT; may be repeated",
    )
    authority.add_argument("--root", dest="robot.root", metavar="ROOT", help="root of all keys (default fleet)")
    _add_replace(authority)
    _add_passphrase(authority, makes_keys=True)

    for role, about in ABOUT.items():
        action = add(role.value, about)
        if role in _HOSTS:
            action.add_argument("names", nargs="+", metavar="HOST", help="its host name or address")
        else:
            action.add_argument("names", nargs=1, metavar="NAME", help="name in the fleet")
        _add_output(action, "request")
    renew = add("renew", "request a new certificate and grant for the keys that are here")
    renew.add_argument("role", choices=[role.value for role in ENROLLED], metavar="ROLE", help="role to renew")
    _add_output(renew, "request")


def _add_signers(add: Add) -> None:
    sign = add("sign", "sign a request, at the authority: makes a bundle")
    sign.add_argument("request", metavar="REQUEST", help="file of the request")
    sign.add_argument("--fingerprint", metavar="F", help="expected fingerprint of the request")
    add_grant_arguments(sign)
    _add_output(sign, "bundle")
    _add_passphrase(sign)

    install_ = add("install", "install a bundle, on the machine that has its keys")
    install_.add_argument("bundle", metavar="BUNDLE", help="file of the bundle")
    install_.add_argument("--fingerprint", metavar="F", help="expected fingerprint of the authority")
    _add_replace(install_)


def _add_statements(add: Add) -> None:
    revoke = add("revoke", "end grants at once: makes a list of all revocations, for the robots")
    revoke.add_argument("names", nargs="*", metavar="NAME", help=f"holder, as in {ISSUED_FILE}")
    revoke.add_argument(
        "--public-key",
        action="append",
        default=[],
        type=matching("[0-9a-f]{64}", "not 64 hexadecimal digits"),
        metavar="HEX",
        help="key of a holder; may be repeated",
    )
    revoke.add_argument("--epoch", action="store_true", help="end all grants, including the robots' own")
    _add_output(revoke, "statement")
    _add_passphrase(revoke)
    rotation = add("rotate", "replace a lost or stolen authority, at its standby")
    rotation.add_argument("authority", metavar="FILE", help="authority.json of the new authority")
    rotation.add_argument("--fingerprint", metavar="F", help="expected fingerprint of its keys")
    _add_output(rotation, "statement")
    _add_passphrase(rotation)

    show = add("show", "send robots a statement: revocations, a rotation or a grant")
    show.add_argument("statement", metavar="FILE", help="statement, or bundle that holds a grant")
    whom = show.add_mutually_exclusive_group(required=True)
    whom.add_argument("--robot", action="append", type=robot_name, metavar="NAME", help="robot; may be repeated")
    whom.add_argument("--all", action="store_true", help="all connected robots")
    show.add_argument("--every", type=seconds, metavar="S", help="period of repeats, until Ctrl-C")
    show.add_argument(
        "--timeout", type=seconds, default=TIMEOUT_S, metavar="S", help=f"wait for a reply ({TIMEOUT_S:g})"
    )
    show.add_argument("--json", action="store_true", help="one JSON object for each answer")
    add_zenoh_arguments(show)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Stopped) -> int:
    passphrase = Passphrase(
        getattr(arguments, "passphrase_file", None), is_wanted=not getattr(arguments, "no_passphrase", False)
    )
    store = KeyStore(directory_of(settings.authority).absolute(), passphrase)
    match arguments.action:
        case "standby":
            _standby(arguments, store)
        case "authority":
            _authority(arguments, store, settings)
        case "sign":
            _sign(arguments, store)
        case "install":
            _install(arguments, store, settings)
        case "revoke":
            _revoke(arguments, store)
        case "rotate":
            _rotate(arguments, store)
        case "show":
            return int(run_show(arguments, settings, store, stopped))
        case _:
            _request(arguments, store)
    return int(ExitCode.OK)


def _standby(arguments: argparse.Namespace, store: KeyStore) -> None:
    public = make_standby(store, replace=arguments.replace)
    _say(f"standby {key_fingerprint(public)}: give {store.path(STANDBY_FILE)} to 'cruiser provision authority'")
    _say("store the other files away from the authority and its copies")


def _authority(arguments: argparse.Namespace, store: KeyStore, settings: Settings) -> None:
    text = (
        read_input(Path(arguments.standby), "'cruiser provision standby' makes it")
        .decode(errors="replace")
        .strip()
    )
    if re.fullmatch("[0-9a-f]{64}", text) is None:
        raise UsageError(f"{plain(arguments.standby)} is not the {STANDBY_FILE} of a standby key")
    try:
        fleet = msgspec.convert({"root": settings.robot.root, "routers": arguments.router}, FleetPlace)
    except msgspec.ValidationError as error:
        shown = plain(", ".join(arguments.router))
        raise UsageError(f"--router {shown}: an endpoint has the form tls/HOST:PORT ({error})") from error
    authority = make_authority(store, text, fleet, _now_s(), replace=arguments.replace)
    _say(f"authority {Issuer.open(store).fingerprint} in {store.directory}")
    _say("compare this fingerprint wherever a bundle is installed")
    _say(f"keys {keys_fingerprint(authority)}: compare at 'cruiser provision rotate'")
    _say(f"standby {key_fingerprint(authority.standby)}: compare with the output of 'cruiser provision standby'")


class _Output:
    """A file to write; checked before anything is made, signed or numbered for it."""

    def __init__(self, arguments: argparse.Namespace, usual: Path) -> None:
        self.path = Path(arguments.out) if arguments.out else usual
        self._replace = arguments.replace
        shown = plain(str(self.path))
        if os.path.lexists(self.path) and not self._replace:
            raise UsageError(f"{shown} is there already; --replace overwrites it")
        if not os.access(self.path.parent, os.W_OK | os.X_OK):
            raise UsageError(f"{shown} cannot be written: no such directory, or no permission")

    def write(self, text: str) -> None:
        write_file(self.path, text, FOR_ALL, replace=self._replace)


def _request(arguments: argparse.Namespace, store: KeyStore) -> None:
    is_new = arguments.action != "renew"
    role = TransportRole(arguments.action if is_new else arguments.role)
    names = list(arguments.names) if is_new else names_here(store, role)
    output = _Output(arguments, Path(f"{role.value}-{re.sub(r'[^A-Za-z0-9_.-]', '-', names[0])}.request"))
    request = make_keys(store, role, names, replace=arguments.replace) if is_new else ask_again(store, role, names)
    output.write(msgspec.json.format(msgspec.json.encode(request), indent=1).decode() + "\n")
    _say(f"{output.path}: {role.value} {', '.join(names)}, fingerprint {request_fingerprint(request)}")
    _say(f"next, at the authority: 'cruiser provision sign {output.path.name}'")


def _sign(arguments: argparse.Namespace, store: KeyStore) -> None:
    file = Path(arguments.request)
    text = read_input(file)
    with naming(file):
        request = read_request(text)
    fingerprint = request_fingerprint(request)
    if arguments.fingerprint not in (None, fingerprint):
        raise UsageError(f"{plain(str(file))} has the fingerprint {fingerprint}: another request than expected")
    issuer = Issuer.open(store)
    with naming(file):
        known = issuer.others(request)
    if known and not arguments.replace:
        raise UsageError(f"{plain(str(file))}: {known}. --replace signs this key as well")
    last = issuer.last_grant(request)
    wanted = wanted_grant(arguments, request, last)
    output = _Output(arguments, file.with_suffix(".bundle"))
    try:
        bundle, grant = issuer.sign(request, wanted, _now_s())
    except EnrolmentError as error:
        # All else that may be wrong is the issuer's own, and named there.
        raise CommandError(f"{plain(str(file))}: {error}", error.code) from error
    output.write(bundle.decode())
    _say(f"{output.path}: {request.role.value} {', '.join(request.names)}, fingerprint {fingerprint}")
    _say(f"  from authority {issuer.fingerprint}")
    if grant is not None:
        _say(f"  {grant_line(grant)}")
    warnings = (known and f"{known}; this key was signed as well", unlimited_warning(arguments, request, last))
    sys.stderr.writelines(f"{warning}\n" for warning in warnings if warning)


def _install(arguments: argparse.Namespace, store: KeyStore, _settings: Settings) -> None:
    text = read_input(Path(arguments.bundle))
    with naming(arguments.bundle):
        bundle = read_bundle(text, _now_s())
    if arguments.fingerprint not in (None, bundle.fingerprint):
        raise UsageError(
            f"{plain(arguments.bundle)} is from the authority {bundle.fingerprint}, not from the one given"
        )
    try:
        files, until_s = install(
            store, bundle, replace=arguments.replace, is_compared=arguments.fingerprint is not None
        )
    except ValueError as error:
        raise UsageError(f"{plain(arguments.bundle)}: {error}") from error
    _say(f"{store.directory}: {', '.join(files)}")
    _say(f"{bundle.role.value} {plain(bundle.name)}, from authority {bundle.fingerprint}")
    after = _AFTER.get(bundle.role, f"export CRUISER_CONFIG={{}}/{bundle.role.value}.toml").format(store.directory)
    _say(f"certificate until {in_utc(until_s)}; {after}")


def _revoke(arguments: argparse.Namespace, store: KeyStore) -> None:
    if not (arguments.names or arguments.public_key or arguments.epoch):
        raise UsageError("nothing to revoke: give NAME, --public-key or --epoch")
    issuer = Issuer.open(store)
    issued, keys = issuer.issued(), list(arguments.public_key)
    revoked: list[str] = []
    for name in arguments.names:
        found = {one.holder.hex(): one.role for one in issued if one.name == name and one.key}
        if not found:
            raise UsageError(f"no grant for {name!a} was made here: see {store.path(ISSUED_FILE)} for all names")
        keys += sorted(found)
        revoked += [f"{found[key]} {name}, key {key_fingerprint(key)}" for key in sorted(found)]
    output = _Output(arguments, Path("revocations.statement"))
    signed = issuer.revoke(keys, _now_s(), raise_epoch=arguments.epoch)
    for line in revoked:
        _say(f"revoked: {line}")
    _write_statement(output, signed)


def _rotate(arguments: argparse.Namespace, store: KeyStore) -> None:
    try:
        authority = msgspec.json.decode(read_input(Path(arguments.authority)), type=AuthorityKeys)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        shown = plain(arguments.authority)
        raise UsageError(f"{shown} is not the authority.json of a new authority: {error}") from error
    fingerprint = keys_fingerprint(authority)
    if arguments.fingerprint not in (None, fingerprint):
        raise UsageError(
            f"{plain(arguments.authority)} has the keys {fingerprint}: another authority than expected"
        )
    output = _Output(arguments, Path("rotation.statement"))
    signed = rotate(store, authority, _now_s())
    _say(f"keys {fingerprint}: compare with 'cruiser provision authority' before you send this to a robot")
    _write_statement(output, signed)


def _write_statement(output: _Output, signed: Signed) -> None:
    output.write(signed.text())
    _say(f"{output.path}: send it to the robots with 'cruiser provision show {output.path.name} --all'")


def _add_passphrase(parser: argparse.ArgumentParser, *, makes_keys: bool = False) -> None:
    parser.add_argument("--passphrase-file", metavar="FILE", help="passphrase in its first line (default: ask)")
    if makes_keys:
        parser.add_argument("--no-passphrase", action="store_true", help="keys without a passphrase")


_HOSTS: Final = {TransportRole.ROUTER, TransportRole.DESK}
_AFTER: Final = {
    TransportRole.ROBOT: "cruiser gateway --config {}/robot.toml",
    TransportRole.RECORDER: "cruiser record --config {}/recorder.toml",
    TransportRole.ROUTER: "cruiser router --directory {}",
}
"""The next step after ``install``, by role; a person's commands find their settings by the environment."""


def _now_s() -> int:
    return int(time.time())


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
