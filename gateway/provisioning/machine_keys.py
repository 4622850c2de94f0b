"""The keys of a machine or a person: made where they stay, with a request; certified and granted by a bundle."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.authority.enrolment import (
    Bundle,
    EnrolmentError,
    EnrolmentRequest,
    EnrolmentRole,
    new_request,
)
from gateway.authority.transport import (
    CA_FILE,
    CERTIFICATE_FILE,
    SHUT_OUT_FILE,
    TLS_KEY_FILE,
    TransportRole,
    zenoh_configuration,
)
from gateway.provisioning.certificates import (
    NAME_PATTERN,
    expires_s,
    fits,
    names_of,
    new_key,
    read_certificates,
)
from gateway.provisioning.certificates import new_request as certificate_request
from gateway.provisioning.key_store import KeyStore, naming
from schemas.authority.identity import AUTHORITY_FILE, GRANT_FILE, INSTALLED, KEY_FILE, remade
from schemas.authority.proof import Grant, StatementFault, read_chain
from schemas.authority.trust import AuthorityKeys
from schemas.command_line import CommandError, ExitCode, plain

FLEET_FILE: Final = "fleet.json"
ZENOH_FILE, SETTINGS_FILE = "{who}.json5", "{who}.toml"

SHARED: Final = (AUTHORITY_FILE, CA_FILE, FLEET_FILE)
"""Files that are the same for all of a fleet. One machine may be several: a desk, and a recorder."""


def make_keys(store: KeyStore, role: EnrolmentRole, names: list[str], *, replace: bool) -> EnrolmentRequest:
    """Make the keys of a machine or a person. Returns the request to be let in.

    Raises:
        CommandError: keys are there already and not to be replaced, or a name is not of its form.
    """
    wrong = next((name for name in names if re.fullmatch(NAME_PATTERN, name) is None), None)
    if wrong is not None:
        raise CommandError(f"{wrong!a} cannot be a name: it is not of the form {NAME_PATTERN}", ExitCode.USAGE)
    tls, tls_name = new_key(), tls_key_name(role)
    keys = {tls_name: store.pem(tls, is_protected=False)}
    private = None
    if role.is_granted:
        private = Ed25519PrivateKey.generate()
        keys[KEY_FILE.format(who=role.value)] = store.pem(private, is_protected=False)
    try:
        request = new_request(role, names, certificate_request(tls, role.value, names), private, tls)
    except (EnrolmentError, ValueError) as error:
        raise CommandError(f"{', '.join(names)!a}: {error}", ExitCode.USAGE) from error
    cure = f"'cruiser provision renew {role.value}' asks anew with these keys, --replace makes new ones"
    store.write(keys, replace=replace, cure=cure)
    return request


def names_here(store: KeyStore, role: EnrolmentRole) -> list[str]:
    """The names under which somebody was let in here: of the grant, or else of the certificate.

    Raises:
        CommandError: the grant or the certificate is missing or wrong.
    """
    if role.is_granted:
        try:
            return [_granted_name(store, role)]
        except CommandError:
            # A grant that is lost or damaged is what a renewal cures.
            if not store.has(CERTIFICATE_FILE.format(who=role.value)):
                raise
    return _certified_names(store, role)


def _granted_name(store: KeyStore, role: EnrolmentRole) -> str:
    name = GRANT_FILE.format(who=role.value)
    statement = store.chain(name, INSTALLED)[0].statement
    if not isinstance(statement, Grant):
        raise CommandError(f"{plain(str(store.path(name)))} is no grant; {remade(role.value)}", ExitCode.USAGE)
    return statement.name


def _certified_names(store: KeyStore, role: EnrolmentRole) -> list[str]:
    name = CERTIFICATE_FILE.format(who=role.value)
    text = store.read(name, INSTALLED).decode(errors="replace")
    with naming(plain(str(store.path(name))), remade(role.value)):
        return names_of(read_certificates(text)[0])


def ask_again(store: KeyStore, role: EnrolmentRole, names: list[str]) -> EnrolmentRequest:
    """A request with the keys that are there.

    Raises:
        CommandError: a key is missing or wrong.
    """
    cure = remade(role.value)
    tls = store.p256(tls_key_name(role), cure)
    private = store.ed25519(KEY_FILE.format(who=role.value), cure) if role.is_granted else None
    return new_request(role, names, certificate_request(tls, role.value, names), private, tls)


class Installed(msgspec.Struct, frozen=True):
    """The result of an installation.

    Attributes:
        files: names of the files.
        certificate_until_s: seconds since 1970.
    """

    files: list[str]
    certificate_until_s: int


def install(store: KeyStore, bundle: Bundle, *, replace: bool, is_compared: bool) -> Installed:
    """Write what a bundle holds, if it is for the keys that are here.

    Args:
        store: the place of the keys.
        bundle: was checked against the authority that it names.
        replace: over what is there.
        is_compared: somebody compared the authority's fingerprint. Without that no other authority takes the
            place of the one that is here, whoever carried the bundle.

    Raises:
        CommandError: it is for other keys, of another authority, or something is there already.
    """
    role, who = bundle.role, bundle.role.value
    until_s = _check_certificate(store, bundle)
    if role.is_granted:
        _check_grant(store, bundle)
    unknown = unknown_of(store, bundle)
    changed = [name for name in unknown if store.has(name)]
    cure = f"--fingerprint takes it over, if 'provision authority' or 'sign' showed {bundle.fingerprint} there"
    if AUTHORITY_FILE in changed and not (replace and is_compared):
        shown = plain(str(store.path(AUTHORITY_FILE)))
        raise CommandError(f"{shown} is another authority's; --replace with {cure}", ExitCode.USAGE)
    if changed and not replace:
        raise CommandError(
            f"{plain(str(store.path(changed[0])))} is different; --replace changes over to that of the bundle",
            ExitCode.USAGE,
        )
    own = dict(_own_files(store, bundle))
    settings = SETTINGS_FILE.format(who=who)
    if store.has(settings):
        # Whoever has it may have added to it.
        own.pop(settings, None)
    store.write(own, replace=replace)
    store.write(_shared(bundle), replace=True)
    return Installed([*own, *SHARED], until_s)


def unknown_of(store: KeyStore, bundle: Bundle) -> list[str]:
    """Return what a bundle brings of its authority that is not so here: names of files."""
    shared = _shared(bundle)
    return [name for name in SHARED if not store.has(name) or store.read(name, "") != shared[name].encode()]


def _shared(bundle: Bundle) -> dict[str, str]:
    return {AUTHORITY_FILE: _json(bundle.authority), CA_FILE: bundle.ca, FLEET_FILE: _json(bundle.fleet)}


def tls_key_name(role: EnrolmentRole) -> str:
    """The file of the key of its certificate."""
    return TLS_KEY_FILE.format(who=role.value)


def _check_certificate(store: KeyStore, bundle: Bundle) -> int:
    with naming("the bundle's certificate"):
        certificate = read_certificates(bundle.certificate)[0]
        read_certificates(bundle.ca)
    name = tls_key_name(bundle.role)
    if not store.has(name):
        raise CommandError(
            f"the bundle is for {_holder(bundle)}, whose keys are not in {plain(str(store.directory))}: "
            "install it where the request was made; --directory says where the keys are",
            ExitCode.USAGE,
        )
    if not fits(certificate, store.p256(name, remade(bundle.role.value))):
        raise _other_request(store, name, bundle)
    return expires_s(certificate)


def _check_grant(store: KeyStore, bundle: Bundle) -> None:
    name = KEY_FILE.format(who=bundle.role.value)
    public = store.ed25519(name, remade(bundle.role.value)).public_key().public_bytes_raw().hex()
    chain = read_chain(bundle.chain.encode())
    if isinstance(chain, StatementFault) or getattr(chain[0].statement, "key", "") != public:
        raise _other_request(store, name, bundle)


def _other_request(store: KeyStore, name: str, bundle: Bundle) -> CommandError:
    return CommandError(
        f"the bundle is for {_holder(bundle)}, and answers another request than that of "
        f"{plain(str(store.path(name)))}: install it where that one was made, or ask with these keys "
        f"('cruiser provision renew {bundle.role.value}')",
        ExitCode.USAGE,
    )


def _holder(bundle: Bundle) -> str:
    return f"{bundle.role.value} {plain(bundle.name)}"


def _own_files(store: KeyStore, bundle: Bundle) -> Mapping[str, str]:
    role, who = bundle.role, bundle.role.value
    files = {CERTIFICATE_FILE.format(who=who): bundle.certificate}
    if role is EnrolmentRole.ROBOT:
        files[SHUT_OUT_FILE] = bundle.shut_out
    if role.is_granted:
        files[GRANT_FILE.format(who=who)] = bundle.chain
    transport, endpoints = role.transport, bundle.fleet.routers
    if transport is TransportRole.ROUTER:
        endpoints = _listening(endpoints, names_of(read_certificates(bundle.certificate)[0]))
    robot = bundle.name if role is EnrolmentRole.ROBOT else ""
    zenoh = zenoh_configuration(transport, bundle.fleet.root, store.directory, endpoints, robot)
    files[ZENOH_FILE.format(who=who)] = json.dumps(zenoh, indent=1) + "\n"
    if transport is not TransportRole.ROUTER:
        files[SETTINGS_FILE.format(who=who)] = _settings(store, bundle)
    return files


def _listening(routers: list[str], names: list[str]) -> list[str]:
    """Return a router's endpoints to listen on: its machine's addresses, with the ports of the fleet's endpoints.

    If the fleet reaches it by a loopback address, it listens on that address only.
    """
    found: list[str] = []
    for endpoint in routers:
        protocol, _, place = endpoint.partition("/")
        host, _, port = place.rpartition(":")
        if host.strip("[]") in names:
            own = host if host in _LOOPBACK else "[::]"
            found.append(f"{protocol}/{own}:{port}")
    if not found:
        raise CommandError(
            f"the fleet's routers are {', '.join(routers)}, and the certificate is for {', '.join(names)}: "
            "ask with one of these hosts",
            ExitCode.USAGE,
        )
    return list(dict.fromkeys(found))


_LOOPBACK: Final = ("127.0.0.1", "[::1]", "localhost")


def _settings(store: KeyStore, bundle: Bundle) -> str:
    """Settings by which every command is this machine's or this person's: ``--config``, or CRUISER_CONFIG."""
    role, who = bundle.role, bundle.role.value
    robot = f"name = {_quoted(bundle.name)}\n" if role is EnrolmentRole.ROBOT else ""
    # Who has no key signs nothing, and believes what robots sign all the same.
    mode = "" if role is EnrolmentRole.ROUTER else 'mode = "signed"\n'
    return (
        "# Written by 'cruiser provision install', which leaves it alone once it is there: add what you like.\n"
        f"[robot]\nroot = {_quoted(bundle.fleet.root)}\n{robot}\n"
        f"[authority]\n{mode}directory = {_quoted(str(store.directory))}\n\n"
        f"[zenoh]\nconfig = {_quoted(str(store.path(ZENOH_FILE.format(who=who))))}\n"
    )


def _quoted(text: str) -> str:
    """A basic string of TOML, whose escapes are those of JSON."""
    return json.dumps(text, ensure_ascii=False)


def _json(struct: AuthorityKeys | msgspec.Struct) -> str:
    return msgspec.json.encode(struct).decode() + "\n"
