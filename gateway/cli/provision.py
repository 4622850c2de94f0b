"""``cruiser provision``: keys, certificates and grants. Keys are made where they stay; only requests travel."""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import msgspec

from gateway.authority.enrolment import (
    BY_SITES,
    Bundle,
    EnrolmentRequest,
    EnrolmentRole,
    FleetPlace,
    key_fingerprint,
    read_bundle,
    read_request,
    request_fingerprint,
)
from gateway.cli.statements import run_show, run_time
from gateway.host.authority_note import note_path
from gateway.provisioning.issuer import (
    ISSUED_FILE,
    STANDBY_FILE,
    Issuer,
    Wanted,
    make_authority,
    make_standby,
    rotate,
)
from gateway.provisioning.key_files import directory_of
from gateway.provisioning.key_store import KeyStore, Passphrase, naming, read_input, write_private
from gateway.provisioning.machine_keys import ask_again, install, make_keys, names_here
from schemas.arguments import add_zenoh_arguments, robot_name, seconds
from schemas.authority.statement import STATEMENTS_MAX, Grant, GrantRole, Signed
from schemas.authority.trust import AuthorityKeys
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.settings import Settings
from schemas.subjects import BY_VERB, RECORDER_BY_VERB, STOP_VERB

EXAMPLE: Final = """\
  cruiser provision robot cruiser-1                         on the robot: keys, and a request
  cruiser provision sign robot-cruiser-1.request            at the authority: a bundle
  cruiser provision install robot-cruiser-1.bundle          on the robot
  cruiser provision revoke ann                              at the authority: a statement
  cruiser provision show revocations.statement --all        from where the robots are reached
docs/authority.md begins a fleet, and says what to do about what was lost or stolen."""

HOUR_S, DAY_S = 3600, 86_400

PERSON_S, OTHERS_S = 12 * HOUR_S, 90 * DAY_S
"""How long a grant lasts unless it is said."""

ROBOT_VERBS: Final = [verb for verb in BY_VERB if verb != STOP_VERB]
"""Verbs that want a grant: a stop wants none."""

ALL_VERBS: Final = [*ROBOT_VERBS, *RECORDER_BY_VERB]

USUAL_VERBS: Final = [*ROBOT_VERBS, "mark"]
"""What a person may do unless it is said: all of a robot's, and marking an incident at a recorder."""

PERSONS: Final = (GrantRole.OPERATOR, GrantRole.PROGRAM, GrantRole.SUPERVISOR)

TIMEOUT_S: Final = 3.0

ABOUT: Final = {
    EnrolmentRole.SITE: "a place that lets people in for up to 12 h, without the authority",
    EnrolmentRole.ROBOT: "a robot",
    EnrolmentRole.OPERATOR: "a person, or a program, that commands robots",
    EnrolmentRole.VIEWER: "somebody who sees robots, and may stop one",
    EnrolmentRole.RECORDER: "a recorder",
    EnrolmentRole.ROUTER: "where robots and people meet",
    EnrolmentRole.DESK: "a control room's machine",
}

Stopped = Callable[[], bool]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the actions and their flags."""
    actions = parser.add_subparsers(title="actions", dest="action", metavar="ACTION", required=True)

    def add(name: str, about: str) -> argparse.ArgumentParser:
        action = actions.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
        action.add_argument(
            "--directory",
            dest="authority.directory",
            metavar="DIR",
            help="of keys, certificates and grants (~/.config/cruiser)",
        )
        return action

    _add_makers(add)
    _add_signers(add)
    _add_statements(add)


Add = Callable[[str, str], argparse.ArgumentParser]


def _add_output(action: argparse.ArgumentParser, what: str) -> None:
    action.add_argument("-o", "--output", metavar="FILE", help=f"where the {what} goes")
    _add_replace(action)


def _add_replace(action: argparse.ArgumentParser) -> None:
    action.add_argument("--replace", action="store_true", help="write over what is there")


def _add_makers(add: Add) -> None:
    """What makes keys."""
    standby = add("standby", "the key that replaces a lost or stolen authority; made first, kept elsewhere")
    _add_replace(standby)
    _add_passphrase(standby, makes_keys=True)
    authority = add("authority", "the keys that everything else hangs on; keep them offline")
    authority.add_argument("--standby", required=True, metavar="FILE", help=f"its {STANDBY_FILE}")
    authority.add_argument(
        "--router",
        action="append",
        required=True,
        metavar="ENDPOINT",
        help="where robots and people find the router, tls/HOST:PORT; may be repeated",
    )
    authority.add_argument("--root", dest="robot.root", metavar="ROOT", help="first chunks of every key")
    _add_replace(authority)
    _add_passphrase(authority, makes_keys=True)

    for role, about in ABOUT.items():
        action = add(role.value, about)
        if role.transport is not None and role in _HOSTS:
            action.add_argument("names", nargs="+", metavar="HOST", help="by which it is reached: name or address")
        else:
            action.add_argument("names", nargs=1, metavar="NAME", help="under which it is known")
        _add_output(action, "request")
    renew = add("renew", "ask again with the keys that are here, before a certificate or grant ends")
    renew.add_argument(
        "role", choices=[role.value for role in EnrolmentRole], metavar="ROLE", help="who is renewed"
    )
    _add_output(renew, "request")


def _add_signers(add: Add) -> None:
    """What lets somebody in."""
    sign = add("sign", "let somebody in, at the authority or at a site: a bundle answers the request")
    sign.add_argument("request", metavar="REQUEST", help="the file")
    sign.add_argument("--fingerprint", metavar="F", help="refuse a request of another one")
    _add_grant(sign)
    _add_output(sign, "bundle")
    _add_passphrase(sign)

    install_ = add("install", "take over a bundle, where the keys are that it is for")
    install_.add_argument("bundle", metavar="BUNDLE", help="the file")
    install_.add_argument("--fingerprint", metavar="F", help="refuse the bundle of another authority")
    _add_replace(install_)


def _add_statements(add: Add) -> None:
    """What is said to robots."""
    revoke = add("revoke", "end grants at once: a list of all that is revoked, for the robots")
    revoke.add_argument("names", nargs="*", metavar="NAME", help=f"holders, as in {ISSUED_FILE}")
    revoke.add_argument("--key", action="append", default=[], type=_hex(64), metavar="HEX", help="of a holder")
    revoke.add_argument(
        "--grant", action="append", default=[], type=_hex(16), metavar="ID", help="one grant alone"
    )
    revoke.add_argument("--epoch", action="store_true", help="end everybody's grants, also the robots' own")
    _add_output(revoke, "statement")
    _add_passphrase(revoke)
    rotation = add("rotate", "replace a lost or stolen authority, at its standby")
    rotation.add_argument("authority", metavar="FILE", help="authority.json of the new one")
    _add_output(rotation, "statement")
    _add_passphrase(rotation)

    show = add("show", "show robots a statement: revocations, a rotation, a grant")
    show.add_argument("statement", metavar="FILE", help="a statement, or a bundle for the grant that is in it")
    tell = add("time", "tell robots the time, at the authority or at a site: it answers their challenges")
    _add_passphrase(tell)
    for action in (show, tell):
        whom = action.add_mutually_exclusive_group(required=True)
        whom.add_argument("--robot", action="append", type=robot_name, metavar="NAME", help="may be repeated")
        whom.add_argument("--all", action="store_true", help="every robot that is connected")
        action.add_argument("--every", type=seconds, metavar="S", help="again and again, until Ctrl-C")
        action.add_argument(
            "--timeout", type=seconds, default=TIMEOUT_S, metavar="S", help=f"for an answer ({TIMEOUT_S:g})"
        )
        add_zenoh_arguments(action)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Stopped) -> int:
    """Do it.

    Raises:
        CommandError: a file is missing or wrong, or something may not be done.
    """
    passphrase = Passphrase(
        getattr(arguments, "passphrase_file", None), is_wanted=not getattr(arguments, "no_passphrase", False)
    )
    store = KeyStore(directory_of(settings.authority).absolute(), passphrase)
    match arguments.action:
        case "standby":
            _standby(arguments, store)
        case "authority":
            _authority(arguments, store, settings)
        case "renew":
            role = EnrolmentRole(arguments.role)
            names = names_here(store, role)
            output = _request_file(arguments, role, names)
            _write_request(output, ask_again(store, role, names), arguments)
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
        case "time":
            return int(run_time(arguments, settings, store, stopped))
        case action:
            role, names = EnrolmentRole(action), list(arguments.names)
            output = _request_file(arguments, role, names)
            _write_request(output, make_keys(store, role, names, replace=arguments.replace), arguments)
    return int(ExitCode.OK)


def _standby(arguments: argparse.Namespace, store: KeyStore) -> None:
    public = make_standby(store, replace=arguments.replace)
    _say(f"standby {key_fingerprint(public)}: {store.path(STANDBY_FILE)} is for 'cruiser provision authority'")
    _say("keep the rest where neither the authority nor its copies are")


def _authority(arguments: argparse.Namespace, store: KeyStore, settings: Settings) -> None:
    text = (
        read_input(Path(arguments.standby), "'cruiser provision standby' makes it")
        .decode(errors="replace")
        .strip()
    )
    if re.fullmatch("[0-9a-f]{64}", text) is None:
        raise CommandError(f"{plain(arguments.standby)} is no {STANDBY_FILE} of a standby key", ExitCode.USAGE)
    try:
        fleet = msgspec.convert({"root": settings.robot.root, "routers": arguments.router}, FleetPlace)
    except msgspec.ValidationError as error:
        shown = plain(", ".join(arguments.router))
        raise CommandError(f"--router {shown}: an endpoint is tls/HOST:PORT ({error})", ExitCode.USAGE) from error
    authority = make_authority(store, text, fleet, _now_s(), replace=arguments.replace)
    _say(f"authority {key_fingerprint(authority.active)} in {store.directory}")
    _say("its fingerprint is the first thing to compare wherever a bundle is installed")


def _request_file(arguments: argparse.Namespace, role: EnrolmentRole, names: Sequence[str]) -> Path:
    """Where the request goes: it can be written there, before keys are made for it."""
    name = re.sub(r"[^A-Za-z0-9_.-]", "-", names[0])
    file = Path(arguments.output or f"{role.value}-{name}.request")
    _check_free(file, arguments)
    return file


def _write_request(file: Path, request: EnrolmentRequest, arguments: argparse.Namespace) -> None:
    text = msgspec.json.format(msgspec.json.encode(request), indent=1).decode()
    write_private(file, f"{text}\n", replace=arguments.replace)
    _say(f"{file}: {request.role.value} {', '.join(request.names)}, fingerprint {request_fingerprint(request)}")
    _say(f"'cruiser provision sign {file.name}' at the authority answers it")


def _sign(arguments: argparse.Namespace, store: KeyStore) -> None:
    file = Path(arguments.request)
    text = read_input(file)
    with naming(file):
        request = read_request(text)
    fingerprint = request_fingerprint(request)
    if arguments.fingerprint not in (None, fingerprint):
        raise CommandError(
            f"{plain(str(file))} has the fingerprint {fingerprint}: it is another request", ExitCode.USAGE
        )
    issuer = Issuer.open(store)
    wanted = _wanted(arguments, request, issuer.last_grant(request))
    output = Path(arguments.output) if arguments.output else file.with_suffix(".bundle")
    _check_free(output, arguments)
    with naming(file):
        bundle, grant = issuer.sign(request, wanted, _now_s())
    write_private(output, bundle.decode(), replace=arguments.replace)
    _say(f"{output}: {request.role.value} {', '.join(request.names)}, fingerprint {fingerprint}")
    if grant is not None:
        _say(f"  {_words(grant)}")


def _install(arguments: argparse.Namespace, store: KeyStore, settings: Settings) -> None:
    text = read_input(Path(arguments.bundle))
    with naming(arguments.bundle):
        bundle = read_bundle(text, _now_s())
    fingerprint = key_fingerprint(bundle.authority.active)
    if arguments.fingerprint not in (None, fingerprint):
        raise CommandError(
            f"{plain(arguments.bundle)} is of the authority {fingerprint}, not of that one", ExitCode.USAGE
        )
    try:
        done = install(store, bundle, replace=arguments.replace)
    except ValueError as error:
        raise CommandError(f"{plain(arguments.bundle)}: {error}", ExitCode.USAGE) from error
    if done.is_new_authority and bundle.role is EnrolmentRole.ROBOT:
        _forget(settings, bundle)
    _say(f"{store.directory}: {', '.join(done.files)}")
    _say(f"{bundle.role.value} {plain(bundle.name)} of authority {fingerprint}")
    after = _AFTER.get(bundle.role, f"export CRUISER_CONFIG={{}}/{bundle.role.value}.toml").format(store.directory)
    _say(f"certificate until {_utc(done.certificate_until_s)}; {after}")


def _forget(settings: Settings, bundle: Bundle) -> None:
    """What a robot learnt of a former authority says nothing of this one, and would keep it from starting."""
    robot = msgspec.structs.replace(settings.robot, root=bundle.fleet.root, name=bundle.name)
    note = note_path(msgspec.structs.replace(settings, robot=robot), os.environ)
    if note is None or not note.exists():
        return
    try:
        note.unlink()
    except OSError as error:
        raise CommandError(
            f"{note} is of the former authority, and cannot be deleted: {error.strerror}"
        ) from error
    _say(f"{note}, of the former authority, is deleted")


def _revoke(arguments: argparse.Namespace, store: KeyStore) -> None:
    if not (arguments.names or arguments.key or arguments.grant or arguments.epoch):
        raise CommandError("what is to be revoked? NAME, --key, --grant or --epoch says it", ExitCode.USAGE)
    issuer = Issuer.open(store)
    issued, keys = issuer.issued(), list(arguments.key)
    revoked: list[str] = []
    for name in arguments.names:
        found = {one.key: one.role.value for one in issued if one.name == name and one.key}
        if not found:
            raise CommandError(
                f"nobody called {name!a} was granted anything here: {store.path(ISSUED_FILE)} has all names. "
                "Who was let in by a site is in the site's: --key says whom",
                ExitCode.USAGE,
            )
        keys += sorted(found)
        revoked += [f"{found[key]} {name}, key {key_fingerprint(key)}" for key in sorted(found)]
    output = Path(arguments.output or "revocations.statement")
    _check_free(output, arguments)
    signed = issuer.revoke(keys, list(arguments.grant), _now_s(), raise_epoch=arguments.epoch)
    for line in revoked:
        _say(f"revoked: {line}")
    _write_statement(output, signed, arguments)


def _rotate(arguments: argparse.Namespace, store: KeyStore) -> None:
    try:
        authority = msgspec.json.decode(read_input(Path(arguments.authority)), type=AuthorityKeys)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        shown = plain(arguments.authority)
        raise CommandError(f"{shown} is no authority.json of a new authority: {error}", ExitCode.USAGE) from error
    output = Path(arguments.output or "rotation.statement")
    _check_free(output, arguments)
    _write_statement(output, rotate(store, authority, _now_s()), arguments)


def _write_statement(output: Path, signed: Signed, arguments: argparse.Namespace) -> None:
    write_private(output, signed.text(), replace=arguments.replace)
    _say(f"{output}: 'cruiser provision show {output.name} --all' shows it to the robots")


def _wanted(arguments: argparse.Namespace, request: EnrolmentRequest, last: Grant | None) -> Wanted:
    """What is to be granted: what is said; of what is not, what the same key had, or else what is usual."""
    given = [name for name in _GRANT_FLAGS if getattr(arguments, name) not in (None, False)]
    if request.role not in {EnrolmentRole.OPERATOR, EnrolmentRole.SITE} and set(given) - _FOR_ALL:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise CommandError(f"{flags}: nothing of that is for a {request.role.value}", ExitCode.USAGE)
    is_site = request.role is EnrolmentRole.SITE
    lasts_s = round(arguments.lasts) if arguments.lasts is not None else _usual_s(request.role)
    usual = ALL_VERBS if is_site else [] if request.role is EnrolmentRole.RECORDER else USUAL_VERBS
    last_role = last.role if last and last.role in PERSONS else GrantRole.OPERATOR
    return Wanted(
        verbs=arguments.verbs or (last.verbs if last else usual),
        robots=arguments.robots or (last.robots if last else ["*"]),
        lasts_s=lasts_s,
        role=GrantRole(arguments.role) if arguments.role else last_role,
        override=arguments.override or (last is not None and last.override),
        speed_limit_mps=arguments.speed_limit or (last.speed_limit_mps if last else None),
        may_delegate=(arguments.delegate or (last.may_delegate if last else 0) or 1) if is_site else 0,
    )


def _usual_s(role: EnrolmentRole) -> int:
    return PERSON_S if role in BY_SITES else OTHERS_S


_GRANT_FLAGS: Final = ("robots", "verbs", "role", "override", "speed_limit", "delegate")
_FOR_ALL: Final = {"robots"}


def _add_grant(parser: argparse.ArgumentParser) -> None:
    grant = parser.add_argument_group(
        "grant", "what is not said is as in the last grant of the same key, or usual"
    )
    grant.add_argument(
        "--robots",
        action="append",
        type=_matching("[a-z0-9*-]{1,64}", "no pattern of robots: lower case, digits, '-' and '*'"),
        metavar="PATTERN",
        help="such as 'depot-*'; may be repeated (all)",
    )
    grant.add_argument(
        "--verbs", type=_verbs, metavar="LIST", help="with commas; 'all' (all of a robot's, and a recorder's mark)"
    )
    grant.add_argument(
        "--role",
        choices=[role.value for role in PERSONS],
        metavar="ROLE",
        help="operator (the default), program or supervisor",
    )
    grant.add_argument("--override", action="store_true", help="may take the lease of a robot that moves")
    grant.add_argument("--speed-limit", type=_speed, metavar="M/S", help="no robot drives faster for this holder")
    lasts = grant.add_mutually_exclusive_group()
    lasts.add_argument("--hours", dest="lasts", type=_times(HOUR_S), metavar="H", help="a person's life (12)")
    lasts.add_argument("--days", dest="lasts", type=_times(DAY_S), metavar="D", help="all others' (90)")
    grant.add_argument(
        "--delegate",
        type=int,
        choices=range(1, STATEMENTS_MAX),
        metavar="N",
        help="of a site: how many grants may stand below it (1)",
    )


def _add_passphrase(parser: argparse.ArgumentParser, *, makes_keys: bool = False) -> None:
    parser.add_argument("--passphrase-file", metavar="FILE", help="its first line; else the terminal is asked")
    if makes_keys:
        parser.add_argument("--no-passphrase", action="store_true", help="the keys have none")


def _matching(pattern: str, what: str) -> Callable[[str], str]:
    def checked(text: str) -> str:
        if re.fullmatch(pattern, text) is None:
            raise argparse.ArgumentTypeError(f"{text!a} is {what}")
        return text

    return checked


def _verbs(text: str) -> list[str]:
    names = ALL_VERBS if text == "all" else list(dict.fromkeys(text.split(",")))
    unknown = [name for name in names if name not in ALL_VERBS]
    if unknown:
        raise argparse.ArgumentTypeError(f"{unknown[0]!a} is no verb; there are {', '.join(ALL_VERBS)}")
    return names


def _speed(text: str) -> float:
    value = seconds(text)
    if value > _SPEED_MAX_MPS:
        raise argparse.ArgumentTypeError(f"{text!r} is no speed in m/s")
    return value


_SPEED_MAX_MPS: Final = 100
_LIFE_MAX_S: Final = 3653 * DAY_S
_HOSTS: Final = {EnrolmentRole.ROUTER, EnrolmentRole.DESK}
_AFTER: Final = {
    EnrolmentRole.SITE: "'cruiser provision sign' lets people in",
    EnrolmentRole.ROBOT: "cruiser gateway --config {}/robot.toml",
    EnrolmentRole.RECORDER: "cruiser record --config {}/recorder.toml",
    EnrolmentRole.ROUTER: "cruiser router --directory {}",
}
"""What is done next; a person's commands find their settings by the environment."""


def _times(unit_s: int) -> Callable[[str], float]:
    def life(text: str) -> float:
        value = seconds(text) * unit_s
        if not 1 <= value <= _LIFE_MAX_S:
            raise argparse.ArgumentTypeError(f"{text!r} is longer than anything is granted")
        return value

    return life


def _hex(length: int) -> Callable[[str], str]:
    return _matching(f"[0-9a-f]{{{length}}}", f"not {length} hexadecimal digits")


def _words(grant: Grant) -> str:
    limit = "" if grant.speed_limit_mps is None else f", at most {grant.speed_limit_mps:g} m/s"
    override = ", may override" if grant.override else ""
    verbs = "" if not grant.verbs else f", verbs {_verb_words(grant.verbs)}"
    until = _utc(grant.not_after)
    return f"{grant.role.value} on {', '.join(grant.robots)}{verbs}{limit}{override}, until {until}"


def _verb_words(verbs: Sequence[str]) -> str:
    return "all" if set(verbs) == set(ALL_VERBS) else ", ".join(verbs)


def _check_free(output: Path, arguments: argparse.Namespace) -> None:
    """Before anything is signed or numbered."""
    if os.path.lexists(output) and not arguments.replace:
        raise CommandError(f"{plain(str(output))} is there already; --replace writes over", ExitCode.USAGE)
    if not os.access(output.parent, os.W_OK | os.X_OK):
        raise CommandError(
            f"{plain(str(output))} cannot be written: no such directory, or not yours", ExitCode.USAGE
        )


def _utc(time_s: int) -> str:
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _now_s() -> int:
    return int(time.time())


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
