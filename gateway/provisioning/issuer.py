"""Create keys and requests on each machine, sign them at the authority, and install the answers."""

from __future__ import annotations

import json
import re
from typing import Final, Self

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.authority.enrolment import (
    CA_FILE,
    CERTIFICATE_FILE,
    SHUT_OUT_FILE,
    TLS_KEY_FILE,
    Bundle,
    EnrolmentError,
    EnrolmentRequest,
    FleetPlace,
    TransportRole,
    authority_fingerprint,
    bundle_text,
    new_request,
    zenoh_configuration,
)
from gateway.provisioning.key_files import (
    NAME_PATTERN,
    STANDBY_FILE,
    KeyStore,
    expires_s,
    fits,
    issue,
    names_of,
    naming,
    new_authority,
    new_key,
    read_certificates,
    read_request,
)
from gateway.provisioning.key_files import new_request as certificate_request
from schemas.authority.key_files import AUTHORITY_FILE, GRANT_FILE, INSTALLED, KEY_FILE, remade
from schemas.authority.proof import (
    Grant,
    GrantRole,
    ProofKind,
    Revocations,
    Rotation,
    Signed,
    Statement,
    StatementFault,
    body_of,
    read_chain,
    signed_bytes,
)
from schemas.authority.trust import AuthorityKeys, Objection, in_utc
from schemas.command_line import CommandError, UsageError, plain
from schemas.configuration import write_string
from schemas.subjects import TEXT_MAX_BYTES

FLEET_FILE: Final = "fleet.json"
ZENOH_FILE, SETTINGS_FILE = "{who}.json5", "{who}.toml"

SHARED: Final = (AUTHORITY_FILE, CA_FILE, FLEET_FILE)  # the same files on every machine of a fleet


def make_keys(store: KeyStore, role: TransportRole, names: list[str], *, replace: bool) -> EnrolmentRequest:
    """Make the keys of a machine or a person. Returns the request for enrolment."""
    wrong = next((name for name in names if re.fullmatch(NAME_PATTERN, name) is None), None)
    if wrong is not None:
        raise UsageError(f"{wrong!a} cannot be a name: names match {NAME_PATTERN}")
    tls, tls_name = new_key(), tls_key_name(role)
    keys = {tls_name: store.pem(tls, is_protected=False)}
    private = None
    if role.is_granted:
        private = Ed25519PrivateKey.generate()
        keys[KEY_FILE.format(who=role.value)] = store.pem(private, is_protected=False)
    try:
        request = new_request(role, names, certificate_request(tls, role.value, names), private, tls)
    except (EnrolmentError, ValueError) as error:
        raise UsageError(f"{', '.join(names)!a}: {error}") from error
    cure = f"'cruiser provision renew {role.value}' requests again with these keys, --replace makes new ones"
    store.write(keys, replace=replace, cure=cure)
    return request


def names_here(store: KeyStore, role: TransportRole) -> list[str]:
    """The names in the certificate that is installed here."""
    name = CERTIFICATE_FILE.format(who=role.value)
    text = store.read(name, INSTALLED).decode(errors="replace")
    with naming(store.path(name), remade(role.value)):
        return names_of(read_certificates(text)[0])


def ask_again(store: KeyStore, role: TransportRole, names: list[str]) -> EnrolmentRequest:
    cure = remade(role.value)
    tls = store.p256(tls_key_name(role), cure)
    private = store.ed25519(KEY_FILE.format(who=role.value), cure) if role.is_granted else None
    return new_request(role, names, certificate_request(tls, role.value, names), private, tls)


def install(store: KeyStore, bundle: Bundle, *, replace: bool, is_compared: bool) -> tuple[list[str], int]:
    """Write the files of a bundle, if it is for the keys that are here.

    Returns their names, and the end of the certificate, seconds since 1970.

    Args:
        is_compared: the authority's fingerprint was compared. Otherwise an installed authority is not replaced.
    """
    role, who = bundle.role, bundle.role.value
    until_s = _check_certificate(store, bundle)
    if role.is_granted:
        _check_grant(store, bundle)
    unknown = unknown_of(store, bundle)
    changed = [name for name in unknown if store.has(name)]
    cure = f"--fingerprint installs it, if 'provision authority' or 'sign' printed {bundle.fingerprint} there"
    if AUTHORITY_FILE in changed and not (replace and is_compared):
        shown = store.shown(AUTHORITY_FILE)
        raise UsageError(f"{shown} belongs to another authority; --replace with {cure}")
    if changed and not replace:
        raise UsageError(f"{store.shown(changed[0])} differs from the bundle's; --replace overwrites it")
    own = _own_files(store, bundle)
    if store.has(settings := SETTINGS_FILE.format(who=who)):
        own.pop(settings, None)  # The user may have edited it.
    store.write(own, replace=replace)
    store.write(_shared(bundle), replace=True)
    return [*own, *SHARED], until_s


def unknown_of(store: KeyStore, bundle: Bundle) -> list[str]:
    """Return the names of the bundle's shared files that are missing or different here."""
    shared = _shared(bundle)
    return [name for name in SHARED if not store.has(name) or store.read(name, "") != shared[name].encode()]


def _shared(bundle: Bundle) -> dict[str, str]:
    return {AUTHORITY_FILE: _json(bundle.authority), CA_FILE: bundle.ca, FLEET_FILE: _json(bundle.fleet)}


def tls_key_name(role: TransportRole) -> str:
    return TLS_KEY_FILE.format(who=role.value)


def _check_certificate(store: KeyStore, bundle: Bundle) -> int:
    with naming("the bundle's certificate"):
        certificate = read_certificates(bundle.certificate)[0]
        read_certificates(bundle.ca)
    name = tls_key_name(bundle.role)
    if not store.has(name):
        raise UsageError(
            f"the bundle is for {_bundle_holder(bundle)}, whose keys are not in {plain(str(store.directory))}: "
            "install it where the request was made; --directory says where the keys are"
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
    return UsageError(
        f"the bundle is for {_bundle_holder(bundle)}, and answers another request than that of "
        f"{store.shown(name)}: install it where its request was made, or request one with these keys "
        f"('cruiser provision renew {bundle.role.value}')"
    )


def _bundle_holder(bundle: Bundle) -> str:
    return f"{bundle.role.value} {plain(bundle.name)}"


def _own_files(store: KeyStore, bundle: Bundle) -> dict[str, str]:
    role, who = bundle.role, bundle.role.value
    files = {CERTIFICATE_FILE.format(who=who): bundle.certificate}
    if role is TransportRole.ROBOT:
        files[SHUT_OUT_FILE] = bundle.shut_out
    if role.is_granted:
        files[GRANT_FILE.format(who=who)] = bundle.chain
    endpoints = bundle.fleet.routers
    if role is TransportRole.ROUTER:
        endpoints = _listening(endpoints, names_of(read_certificates(bundle.certificate)[0]))
    robot = bundle.name if role is TransportRole.ROBOT else ""
    zenoh = zenoh_configuration(role, bundle.fleet.root, store.directory, endpoints, robot)
    files[ZENOH_FILE.format(who=who)] = json.dumps(zenoh, indent=1) + "\n"
    if role is not TransportRole.ROUTER:
        files[SETTINGS_FILE.format(who=who)] = _settings(store, bundle)
    return files


def _listening(routers: list[str], names: list[str]) -> list[str]:
    """Return the endpoints that a router listens on: any address, with the ports of the fleet's endpoints for it.

    For a loopback endpoint it listens on that address only.
    """
    found: list[str] = []
    for endpoint in routers:
        protocol, _, place = endpoint.partition("/")
        host, _, port = place.rpartition(":")
        if host.strip("[]") in names:
            own = host if host in _LOOPBACK else "[::]"
            found.append(f"{protocol}/{own}:{port}")
    if not found:
        raise UsageError(
            f"the fleet's routers are {', '.join(routers)}, and the certificate is for {', '.join(names)}: "
            "ask with one of these hosts"
        )
    return list(dict.fromkeys(found))


_LOOPBACK: Final = ("127.0.0.1", "[::1]", "localhost")


def _settings(store: KeyStore, bundle: Bundle) -> str:
    """The settings file of a role, for ``--config`` or CRUISER_CONFIG."""
    role, who = bundle.role, bundle.role.value
    robot = f"name = {write_string(bundle.name)}\n" if role is TransportRole.ROBOT else ""
    # Roles without a key sign nothing, but verify what robots sign.
    mode = "" if role is TransportRole.ROUTER else 'mode = "signed"\n'
    return (
        "# Written by 'cruiser provision install', which does not overwrite it: you may edit it.\n"
        f"[robot]\nroot = {write_string(bundle.fleet.root)}\n{robot}\n"
        f"[authority]\n{mode}directory = {write_string(str(store.directory))}\n\n"
        f"[zenoh]\nconfig = {write_string(str(store.path(ZENOH_FILE.format(who=who))))}\n"
    )


def _json(struct: msgspec.Struct) -> str:
    return msgspec.json.encode(struct).decode() + "\n"


AUTHORITY_KEY, CA_KEY = "authority.key", "ca.key"
STANDBY_KEY: Final = "standby.key"
SERIALS_FILE, ISSUED_FILE, REVOCATIONS_FILE = "serials.json", "issued.jsonl", "revocations.statement"

BACKDATED_S: Final = 300  # a grant begins so much earlier, since clocks differ

_ROLES: Final = {
    TransportRole.ROBOT: GrantRole.ROBOT,
    TransportRole.RECORDER: GrantRole.RECORDER,
}
_AUTHORITY_CURE: Final = "'cruiser provision authority' makes it"


class Serials(msgspec.Struct, frozen=True):
    """The last numbers that were used. They never decrease."""

    grant: int = 0
    revocations: int = 0
    rotation: int = 0
    epoch: int = 0


class Issued(msgspec.Struct, frozen=True):
    """A line of ``issued.jsonl``: one enrolment."""

    at: int
    role: str
    name: str
    key: str = ""
    grant: str = ""
    until: int = 0
    body: str = ""
    tls: str = ""

    def __post_init__(self) -> None:
        bytes.fromhex(self.key)

    @property
    def holder(self) -> bytes:
        """The identity of the party: the grant's key, or else the fingerprint of the certificate's key."""
        return bytes.fromhex(self.key) or self.tls.encode()


class Wanted(msgspec.Struct, frozen=True):
    """The terms of a grant to be issued.

    Attributes:
        lasts_s: seconds.
    """

    verbs: list[str]
    robots: list[str]
    lasts_s: int
    role: GrantRole = GrantRole.OPERATOR
    override: bool = False
    speed_limit_mps: float | None = None


class Issuer:
    """An authority with its keys."""

    def __init__(self, store: KeyStore, private: Ed25519PrivateKey) -> None:
        self.store = store
        self._private = private

    @classmethod
    def open(cls, store: KeyStore) -> Self:
        if not store.has(AUTHORITY_KEY):
            raise UsageError(f"no authority's key is in {store.directory}: give its directory with --directory")
        return cls(store, store.ed25519(AUTHORITY_KEY, _AUTHORITY_CURE))

    @property
    def authority(self) -> AuthorityKeys:
        return self.store.read_as(AUTHORITY_FILE, AuthorityKeys, _AUTHORITY_CURE)

    @property
    def fleet(self) -> FleetPlace:
        return self.store.read_as(FLEET_FILE, FleetPlace, _AUTHORITY_CURE)

    @property
    def ca(self) -> str:
        return self.store.read(CA_FILE, _AUTHORITY_CURE).decode()

    @property
    def fingerprint(self) -> str:
        return authority_fingerprint(self.authority, self.fleet, self.ca)

    def sign(self, request: EnrolmentRequest, wanted: Wanted, now_s: int) -> tuple[bytes, Grant | None]:
        """Answer a request. Returns the bundle and the grant in it."""
        name, role = request.names[0], request.role
        applicant = read_request(request.csr) if request.csr else None
        if applicant and (applicant.role != role.value or sorted(applicant.names) != sorted(request.names)):
            raise EnrolmentError("the request and its certificate's request name different people")
        self._refuse_revoked(request)
        signed = self._grant(request, wanted, now_s) if role.is_granted else None
        bundle = Bundle(
            role=role,
            name=name,
            authority=self.authority,
            fleet=self.fleet,
            certificate=self._certify(request, role, now_s) if request.csr else "",
            shut_out=self._certify(request, TransportRole.NOTHING, now_s) if role is TransportRole.ROBOT else "",
            ca=self.ca,
            chain=signed.text() if signed else "",
        )
        grant = signed.statement if signed else None
        entry = Issued(
            now_s,
            role.value,
            name,
            request.key or "",
            signed.id.hex() if signed else "",
            getattr(grant, "not_after", 0),
            signed.body.decode() if signed else "",
            applicant.key if applicant else "",
        )
        self.store.append(ISSUED_FILE, msgspec.json.encode(entry).decode())
        return bundle_text(bundle, self._private), grant if isinstance(grant, Grant) else None

    def _refuse_revoked(self, request: EnrolmentRequest) -> None:
        """Refuse a request with a revoked key: robots would refuse its grant too."""
        revoked = self._revoked()
        if request.key and bytes.fromhex(request.key) in map(bytes.fromhex, revoked.keys):
            who = request.role.value
            raise UsageError(
                f"the key of {who} {request.names[0]} was revoked: {self.store.shown(REVOCATIONS_FILE)}, list "
                f"{revoked.serial} of {in_utc(revoked.at)}; {remade(who)}"
            )

    def last_grant(self, request: EnrolmentRequest) -> Grant | None:
        """Return the last grant for the same key, role and name; None if there is none."""
        holder = _holder(request)
        found = [
            one for one in self.issued() if one.holder == holder and one.role == request.role.value and one.body
        ]
        if not found or found[-1].name != request.names[0]:
            return None
        return msgspec.json.decode(found[-1].body, type=Grant)

    def others(self, request: EnrolmentRequest) -> str:
        """Return the earlier enrolment of this name or key under another key or name; else empty.

        Revoked keys do not count.
        """
        role, name, holder = request.role.value, request.names[0], _holder(request)
        revoked = set(map(bytes.fromhex, self._revoked().keys))
        let_in = [one for one in self.issued() if one.role == role and one.holder and one.holder not in revoked]
        if any(one.name == name and one.holder == holder for one in let_in):
            return ""
        for one in reversed(let_in):
            if one.holder == holder:
                return f"its key was enrolled as {role} {plain(one.name)}"
            if one.name == name:
                ends = f" ('cruiser provision revoke --public-key {one.holder.hex()}' ends it)" if one.key else ""
                return f"{role} {name} has another key already, enrolled {in_utc(one.at)}{ends}"
        return ""

    def issued(self) -> list[Issued]:
        if not self.store.has(ISSUED_FILE):
            return []
        lines = self.store.read(ISSUED_FILE, "").splitlines()
        try:
            return [msgspec.json.decode(line, type=Issued) for line in lines]
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise UsageError(f"{self.store.shown(ISSUED_FILE)} is damaged: {error}") from error

    def revoke(self, keys: list[str], now_s: int, *, raise_epoch: bool) -> Signed:
        """Sign a new list of revocations: the last one and these keys. Raising the epoch begins an empty list."""
        before, serials = self._revoked(), serials_of(self.store)
        if serials.revocations > before.serial and not raise_epoch:
            raise UsageError(
                f"{self.store.shown(REVOCATIONS_FILE)} is not the newest list: signing one now would cancel "
                "revocations. Restore the newest from a backup or from a desk that shows it, or end all earlier "
                "grants with --epoch"
            )
        serial = max(serials.revocations, before.serial, now_s) + 1
        epoch = max(serials.epoch, before.epoch) + raise_epoch
        signed = state(
            self._private,
            Revocations(
                serial=serial,
                at=now_s,
                grants=[] if raise_epoch else before.grants,
                keys=sorted({*(() if raise_epoch else before.keys), *keys}),
                epoch=epoch,
            ),
        )
        if len(signed.text()) > TEXT_MAX_BYTES:
            raise UsageError(
                "the list is longer than robots accept. --epoch ends all earlier grants, and empties the list"
            )
        save_serials(self.store, msgspec.structs.replace(serials, revocations=serial, epoch=epoch))
        self.store.write({REVOCATIONS_FILE: signed.text()}, replace=True)
        return signed

    def _grant(self, request: EnrolmentRequest, wanted: Wanted, now_s: int) -> Signed:
        serials, name = serials_of(self.store), request.names[0]
        is_robot = request.role is TransportRole.ROBOT
        grant = Grant(
            serial=serials.grant + 1,
            name=name,
            key=request.key or "",
            role=_ROLES.get(request.role, wanted.role),
            robots=[name] if is_robot else wanted.robots,
            verbs=[] if is_robot else wanted.verbs,
            override=wanted.override,
            speed_limit_mps=wanted.speed_limit_mps,
            not_before=now_s - BACKDATED_S,
            not_after=now_s + wanted.lasts_s,
            epoch=serials.epoch,
        )
        signed = state(self._private, grant)
        held = self.authority.trust.judge([signed], now_s)
        if isinstance(held, Objection):
            raise UsageError(f"this grant would not be valid: {held.text}")
        save_serials(self.store, msgspec.structs.replace(serials, grant=grant.serial))
        return signed

    def _certify(self, request: EnrolmentRequest, role: TransportRole, now_s: int) -> str:
        key, ca = self.store.p256(CA_KEY, _AUTHORITY_CURE), self.ca
        try:
            return issue(request.csr, role, ca, key, now_s)
        except EnrolmentError as error:
            raise UsageError(f"{self.store.shown(CA_FILE)}: {error}") from error

    def _revoked(self) -> Revocations:
        if not self.store.has(REVOCATIONS_FILE):
            return Revocations(serial=0, at=0)
        chain = read_chain(self.store.read(REVOCATIONS_FILE, ""))
        statement = None if isinstance(chain, StatementFault) else chain[0].statement
        if not isinstance(statement, Revocations):
            raise UsageError(
                f"{self.store.shown(REVOCATIONS_FILE)} is damaged: restore it from a backup to lose no revocations"
            )
        return statement


def make_standby(store: KeyStore, *, replace: bool) -> str:
    """Make the standby key of an authority. Returns its public half, hexadecimal."""
    private = Ed25519PrivateKey.generate()
    public = private.public_key().public_bytes_raw().hex()
    files = {STANDBY_KEY: store.pem(private, is_protected=True), STANDBY_FILE: f"{public}\n"}
    store.write(files, replace=replace)
    return public


def make_authority(
    store: KeyStore, standby: str, fleet: FleetPlace, now_s: int, *, replace: bool
) -> AuthorityKeys:
    private, ca = Ed25519PrivateKey.generate(), new_key()
    authority = AuthorityKeys(private.public_key().public_bytes_raw().hex(), standby)
    store.write(
        {
            AUTHORITY_KEY: store.pem(private, is_protected=True),
            CA_KEY: store.pem(ca, is_protected=True),
            CA_FILE: new_authority(ca, now_s),
            AUTHORITY_FILE: _json(authority),
            FLEET_FILE: _json(fleet),
        },
        replace=replace,
        cure="--replace makes another authority, which existing robots do not trust",
    )
    return authority


def _holder(request: EnrolmentRequest) -> bytes:
    return bytes.fromhex(request.key) if request.key else read_request(request.csr).key.encode()


def rotate(store: KeyStore, authority: AuthorityKeys, now_s: int) -> Signed:
    private = store.ed25519(STANDBY_KEY, "'cruiser provision standby' makes it")
    serials = serials_of(store)
    serial = max(serials.rotation, now_s) + 1
    rotation = Rotation(serial=serial, at=now_s, active=authority.active, standby=authority.standby)
    save_serials(store, msgspec.structs.replace(serials, rotation=serial))
    return state(private, rotation)


def state(private: Ed25519PrivateKey, statement: Statement) -> Signed:
    body = body_of(statement)
    signature = private.sign(signed_bytes(ProofKind.STATEMENT, body))
    return Signed(body, private.public_key().public_bytes_raw(), signature, statement)


def serials_of(store: KeyStore) -> Serials:
    if not store.has(SERIALS_FILE):
        return Serials()
    return store.read_as(SERIALS_FILE, Serials, "restore it from a backup: numbers must not decrease")


def save_serials(store: KeyStore, serials: Serials) -> None:
    store.write({SERIALS_FILE: _json(serials)}, replace=True)
