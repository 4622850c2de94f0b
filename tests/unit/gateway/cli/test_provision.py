"""``cruiser provision``: who gets in, what is written, and one clear line for everything wrong."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self

import msgspec
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from gateway.authority.enrolment import TransportRole, bundle_text, new_request, read_request
from gateway.command.rulings import RawRequest
from gateway.provisioning.issuer import Issuer, Wanted, ask_again
from gateway.provisioning.key_files import KeyStore, expires_s, read_certificates
from gateway.telemetry.samples import Received
from gateway.zenoh.operator import StatementPort
from schemas.authority.key_files import read_identity
from schemas.authority.proof import GrantRole, Revocations, Signed, chain_text
from schemas.authority.trust import HeldGrant, Objection, Trust, key_fingerprint, keys_fingerprint
from schemas.command_line import CommandError, ExitCode
from schemas.reasons import Reason
from schemas.requests import Role
from schemas.subjects import STATEMENT_REPLY_ENCODING
from tests.support.authority import NOW_S, AuthorityBench, Fleet
from tests.support.provisioned import write_authority
from tests.support.provisioning import ENDPOINT, ProvisionedFleet, bundle_of, chain, run

DAY_S = 86_400


@pytest.fixture
def fleet(tmp_path: Path) -> ProvisionedFleet:
    """A standby and an authority that has signed nothing."""
    return ProvisionedFleet(tmp_path)


@pytest.fixture(autouse=True)
def _home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Touch nothing outside of the test's directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


def refused(*words: str | Path) -> str:
    """Return the line with which it ends."""
    with pytest.raises(CommandError) as caught:
        run(*words)
    assert caught.value.code in {ExitCode.USAGE, ExitCode.FAILURE}
    text = str(caught.value)
    assert "\n" not in text
    return text


def revoked(fleet: ProvisionedFleet, *words: str | Path) -> Signed:
    """Return the newest list of revocations, after this."""
    run("revoke", *words, "--directory", fleet.authority)
    return chain(fleet.place / "revocations.statement")[0]


def said(signed: Signed) -> Revocations:
    assert isinstance(signed.statement, Revocations)
    return signed.statement


def judged(trust: Trust | Objection, directory: Path) -> HeldGrant | Objection:
    """Judge an operator's grant as a robot of this trust does."""
    assert isinstance(trust, Trust)
    return trust.judge(chain(directory / "operator.grant"), int(time.time()))


# What is made.


def test_a_robot_and_a_person_hold_grants_of_the_authority(fleet: ProvisionedFleet) -> None:
    robot, ann = fleet.let_in("robot", "cruiser-1"), fleet.let_in("operator", "ann", "--speed-limit", "0.8")
    identity = read_identity(robot, "robot")
    held = identity.trust.judge(identity.chain, int(time.time()))
    assert isinstance(held, HeldGrant)
    assert (held.grant.role, held.grant.name, held.grant.robots) == (GrantRole.ROBOT, "cruiser-1", ["cruiser-1"])
    person = read_identity(ann, "operator")
    held = identity.trust.judge(person.chain, int(time.time()))
    assert isinstance(held, HeldGrant)
    assert (held.grant.role, held.grant.name, held.grant.speed_limit_mps) == (GrantRole.OPERATOR, "ann", 0.8)
    assert abs(held.grant.not_after - time.time() - DAY_S / 2) < 600
    for name, days in (("robot-tls.pem", 30), ("ca.pem", 3653)):
        assert abs(expires_s(read_certificates((robot / name).read_text())[0]) - time.time() - days * DAY_S) < 600


def test_everything_is_its_owners_alone(fleet: ProvisionedFleet) -> None:
    """Files 0600, directories 0700. What travels or is copied is readable, and has no private key."""
    for role, name in (("robot", "cruiser-1"), ("operator", "ann"), ("router", "127.0.0.1")):
        fleet.let_in(role, name)
    directories = [path for path in fleet.place.iterdir() if path.is_dir() and path.name != "config"]
    assert len(directories) == 5
    assert {path.stat().st_mode & 0o777 for path in directories} == {0o700}
    files = [file for directory in directories for file in directory.iterdir()]
    public = {file for file in files if file.name in {"standby.pub", "authority.json", "ca.pem"}}
    assert len(public) == 9
    assert {file.stat().st_mode & 0o777 for file in public} == {0o644}
    assert {file.stat().st_mode & 0o777 for file in set(files) - public} == {0o600}
    travel = [*fleet.place.glob("*.request"), *fleet.place.glob("*.bundle")]
    assert len(travel) == 6
    assert not [file for file in travel if b"PRIVATE" in file.read_bytes()]
    assert {file.stat().st_mode & 0o777 for file in travel} == {0o644}
    assert not [file for file in files if "unfinished" in file.name]


def test_settings_that_somebody_added_to_stay(fleet: ProvisionedFleet) -> None:
    robot = fleet.let_in("robot", "cruiser-1")
    file = robot / "robot.toml"
    file.write_text(file.read_text() + '\n[can]\nchannel = "can1"\n')
    run("renew", "robot", "--directory", robot, "-o", "again.request")
    run("install", fleet.sign(fleet.place / "again.request"), "--directory", robot, "--replace")
    assert 'channel = "can1"' in file.read_text()


def test_a_router_listens_where_the_fleet_finds_it(fleet: ProvisionedFleet) -> None:
    router = fleet.let_in("router", "127.0.0.1")
    assert json.loads((router / "router.json5").read_text())["listen"]["endpoints"] == [ENDPOINT]
    bundle = fleet.sign(fleet.request("router", "other.example"))
    assert "ask with one of these hosts" in refused(
        "install", bundle, "--directory", fleet.place / "other.example"
    )
    named = ProvisionedFleet(fleet.place / "named", "tls/router.example:7447")
    file = named.let_in("router", "router.example") / "router.json5"
    assert json.loads(file.read_text())["listen"]["endpoints"] == ["tls/[::]:7447"]


def test_the_authoritys_keys_are_under_a_passphrase(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("correct horse\n")
    key = ("--passphrase-file", secret)
    run("standby", "--directory", tmp_path / "s", *key)
    run("authority", "--directory", tmp_path / "a", "--standby", "s/standby.pub", "--router", ENDPOINT, *key)
    for name in ("s/standby.key", "a/authority.key", "a/ca.key"):
        assert b"BEGIN ENCRYPTED PRIVATE KEY" in (tmp_path / name).read_bytes()
    run("viewer", "hall", "--directory", tmp_path / "hall")
    run("sign", "viewer-hall.request", "--directory", tmp_path / "a", *key)
    sign = ("sign", "viewer-hall.request", "--directory", tmp_path / "a", "--replace")
    assert "--passphrase-file" in refused(*sign)
    secret.write_text("wrong\n")
    assert "passphrase is wrong" in refused(*sign, *key)
    secret.write_text("\n")
    assert "an empty passphrase" in refused("standby", "--directory", tmp_path / "t", *key)
    assert "cannot be read" in refused(
        "standby", "--directory", tmp_path / "t", "--passphrase-file", tmp_path / "no"
    )


# Grants.


def test_what_is_said_is_granted(fleet: ProvisionedFleet) -> None:
    fleet.let_in(
        *("operator", "ann", "--robots", "depot-*", "--robots", "hall-1", "--verbs", "acquire,drive"),
        *("--role", "supervisor", "--override", "--speed-limit", "0.5", "--hours", "2"),
    )
    grant = fleet.grant("ann")
    assert (grant.robots, grant.verbs, grant.role) == (
        ["depot-*", "hall-1"],
        ["acquire", "drive"],
        GrantRole.SUPERVISOR,
    )
    assert (grant.override, grant.speed_limit_mps) == (True, 0.5)
    assert abs(grant.not_after - time.time() - 7200) < 600
    assert {role.value for role in Role} == {"program", "operator", "supervisor"}


def test_a_renewal_grants_the_same_again(fleet: ProvisionedFleet) -> None:
    ann = fleet.let_in("operator", "ann", "--verbs", "acquire,drive", "--speed-limit", "0.5")
    before = fleet.grant("ann")
    run("renew", "operator", "--directory", ann, "-o", "again.request")
    bundle = fleet.sign(fleet.place / "again.request", "--robots", "depot-*")
    assert "is there already" in refused("install", bundle, "--directory", ann)
    run("install", bundle, "--directory", ann, "--replace")
    after = fleet.grant("ann")
    assert (after.key, after.verbs, after.speed_limit_mps) == (before.key, before.verbs, 0.5)
    assert (after.robots, after.serial) == (["depot-*"], before.serial + 1)


def test_who_is_not_known_here_is_not_let_in_without_limits_in_silence(
    fleet: ProvisionedFleet, capsys: pytest.CaptureFixture[str]
) -> None:
    ann = fleet.let_in("operator", "ann", "--speed-limit", "0.5")
    assert capsys.readouterr().err == ""
    run("renew", "operator", "--directory", ann, "-o", "again.request")
    request = fleet.place / "again.request"
    fleet.sign(request)
    assert capsys.readouterr().err == ""
    new = ProvisionedFleet(fleet.place / "new")
    again = ("--directory", new.place / "authority", "-o")
    capsys.readouterr()
    run("sign", request, *again, "wide.bundle")
    warning = "this key had no grant here before: it gets all robots, all verbs and no speed limit; "
    assert capsys.readouterr().err == f"{warning}limit it with --robots and --speed-limit\n"
    robot = fleet.request("robot", "cruiser-1")
    run("sign", robot, *again, "robot.bundle")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("content", [None, "damaged"])
def test_a_grant_that_is_lost_is_asked_for_again(fleet: ProvisionedFleet, content: str | None) -> None:
    ann = fleet.let_in("operator", "ann", "--speed-limit", "0.5")
    grant = ann / "operator.grant"
    grant.unlink() if content is None else grant.write_text(content)
    run("renew", "operator", "--directory", ann, "-o", "again.request")
    run("install", fleet.sign(fleet.place / "again.request"), "--directory", ann, "--replace")
    assert fleet.grant("ann").speed_limit_mps == 0.5


def test_a_name_that_has_a_key_gets_no_other_in_silence(
    fleet: ProvisionedFleet, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nor a key another name: the request may have been replaced on its way. A revoked one is free."""
    authority = ("--directory", fleet.authority)
    for role, name in (("operator", "ann"), ("robot", "cruiser-1"), ("viewer", "hall"), ("router", "one")):
        fleet.sign(fleet.request(role, name))
        assert run("sign", f"{role}-{name}.request", *authority, "-o", f"{name}-again.bundle") == 0
        run(role, name, "--directory", fleet.place / f"other-{name}", "-o", f"other-{name}.request")
        other = ("sign", f"other-{name}.request", *authority)
        assert f"{role} {name} has another key already" in refused(*other)
        capsys.readouterr()
        assert run(*other, "--replace") == 0
        assert f"{role} {name} has another key already" in capsys.readouterr().err
        assert run(*other, "--replace") == 0
        assert "another key" not in capsys.readouterr().err
    renamed = ask_again(KeyStore(fleet.place / "ann"), TransportRole.OPERATOR, ["bea"])
    (fleet.place / "bea.request").write_bytes(msgspec.json.encode(renamed))
    assert "its key was enrolled as operator ann" in refused("sign", "bea.request", *authority)
    run("revoke", "cruiser-1", *authority)
    run("robot", "cruiser-1", "--directory", fleet.place / "third", "-o", "third.request")
    assert run("sign", "third.request", *authority) == 0


@pytest.mark.parametrize("change", [lambda key: f"{key}\n", str.upper])
def test_a_key_is_the_same_however_it_is_written(fleet: ProvisionedFleet, change: Callable[[str], str]) -> None:
    run("sign", fleet.request("operator", "ann"), "--directory", fleet.authority, "--robots", "cruiser-1")
    request = read_request((fleet.place / "operator-ann.request").read_bytes())
    issuer, other = (
        Issuer.open(KeyStore(fleet.authority)),
        msgspec.structs.replace(request, key=change(request.key or "")),
    )
    last = issuer.last_grant(other)
    assert last is not None
    assert last.robots == ["cruiser-1"]
    issuer.revoke([request.key or ""], int(time.time()), raise_epoch=False)
    with pytest.raises(CommandError, match="the key of operator ann was revoked"):
        issuer.sign(other, Wanted([], ["*"], 60), int(time.time()))


def test_who_carries_the_files_of_an_authority_changes_no_key_in_them_unseen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = ProvisionedFleet(tmp_path)
    shown = keys_fingerprint(Issuer.open(KeyStore(fleet.authority)).authority)
    standby = key_fingerprint((fleet.place / "standby" / "standby.pub").read_text().strip())
    file, directory = fleet.authority / "authority.json", ("--directory", fleet.place / "standby")
    said = capsys.readouterr().out
    assert said.count(f"standby {standby}") == 2
    assert f"keys {shown}" in said
    run("rotate", file, *directory, "--fingerprint", shown)
    assert f"keys {shown}" in capsys.readouterr().out
    keys = json.loads(file.read_text())
    for field in keys:
        (fleet.place / "changed.json").write_text(json.dumps(keys | {field: "00" * 32}))
        assert "another authority than" in refused("rotate", "changed.json", *directory, "--fingerprint", shown)


# Revocation and rotation.


def test_a_list_of_revocations_holds_all_of_before(fleet: ProvisionedFleet) -> None:
    ann, bea = fleet.let_in("operator", "ann"), fleet.let_in("operator", "bea")
    first, second = revoked(fleet, "ann"), revoked(fleet, "bea", "--replace")
    assert said(second).serial > said(first).serial
    assert set(said(second).keys) == {fleet.grant(name).key for name in ("ann", "bea")}
    trust = read_identity(ann, "operator").trust.revoke(first)
    refusal = judged(trust, ann)
    assert isinstance(refusal, Objection)
    assert refusal.reason is Reason.GRANT_REVOKED
    assert isinstance(judged(trust, bea), HeldGrant)
    assert isinstance(trust, Trust)
    assert isinstance(trust.revoke(first), Objection)


def test_a_revoked_key_is_let_in_nowhere(fleet: ProvisionedFleet) -> None:
    ann = fleet.let_in("operator", "ann")
    newest = said(revoked(fleet, "ann"))
    run("renew", "operator", "--directory", ann, "-o", "again.request")
    text = refused("sign", "again.request", "--directory", fleet.authority)
    assert "the key of operator ann was revoked" in text
    assert f"list {newest.serial} of {time.strftime('%Y-%m-%d %H:%M', time.gmtime(newest.at))} UTC" in text
    assert text.endswith(
        "'cruiser provision operator NAME --replace' makes another and a request to the authority"
    )
    run("operator", "ann", "--directory", ann, "-o", "new.request", "--replace")
    run("install", fleet.sign(fleet.place / "new.request"), "--directory", ann, "--replace")


def test_a_serial_survives_a_lost_file_and_a_clock_set_back(
    fleet: ProvisionedFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the last list only a new epoch makes another: it would lift the former revocations."""
    fleet.let_in("operator", "ann")
    serials: list[int] = []
    for forget in ("", "serials.json", "revocations.statement"):
        if forget:
            (fleet.authority / forget).unlink()
        monkeypatch.setattr(time, "time", lambda: 1_000_000_000.0 - len(serials))
        epoch = ["--epoch"] if forget == "revocations.statement" else []
        if epoch:
            with pytest.raises(CommandError, match=r"revocations\.statement is not the newest list"):
                revoked(fleet, "ann", "--replace")
        serials.append(said(revoked(fleet, "ann", "--replace", *epoch)).serial)
    assert serials == sorted(set(serials))


def test_a_list_is_no_longer_than_a_robot_takes(fleet: ProvisionedFleet) -> None:
    many = [word for number in range(300) for word in ("--public-key", f"{number:064x}")]
    revoked(fleet, *many[:200])
    with pytest.raises(CommandError, match="longer than robots accept"):
        revoked(fleet, *many, "--replace")
    statement = said(revoked(fleet, "--epoch", *many[:2], "--replace"))
    assert (statement.keys, statement.epoch) == ([f"{0:064x}"], 1)


def test_a_machine_changes_over_to_another_authority_only_when_it_is_said(fleet: ProvisionedFleet) -> None:
    """By --replace and the fingerprint: the renewal may have been replaced on its way."""
    robot = fleet.let_in("robot", "cruiser-1")
    run("renew", "robot", "--directory", robot, "-o", "again.request")
    again = fleet.sign(fleet.place / "again.request")
    run("install", again, "--directory", robot, "--replace")
    new = ProvisionedFleet(fleet.place / "new")
    run("sign", "again.request", "--directory", new.place / "authority", "-o", "new.bundle")
    assert "belongs to another authority" in refused("install", "new.bundle", "--directory", robot)
    before = {file: file.read_bytes() for file in robot.iterdir()}
    text = refused("install", "new.bundle", "--directory", robot, "--replace")
    assert f"--fingerprint installs it, if 'provision authority' or 'sign' printed {new.fingerprint} there" in text
    assert "not from the one given" in refused(
        "install", "new.bundle", "--directory", robot, "--replace", "--fingerprint", fleet.fingerprint
    )
    assert {file: file.read_bytes() for file in robot.iterdir()} == before
    run("install", "new.bundle", "--directory", robot, "--replace", "--fingerprint", new.fingerprint)


# Nothing is overwritten.


def test_nothing_is_written_over(fleet: ProvisionedFleet) -> None:
    ann = fleet.let_in("operator", "ann")
    request, bundle = fleet.place / "operator-ann.request", fleet.place / "operator-ann.bundle"
    authority = ("--directory", fleet.authority)
    run("revoke", "ann", *authority)
    standby = fleet.place / "standby" / "standby.pub"
    before = {file: file.read_bytes() for file in fleet.place.rglob("*") if file.is_file()}
    for words in (
        ("standby", "--directory", fleet.place / "standby", "--no-passphrase"),
        ("authority", *authority, "--standby", standby, "--router", ENDPOINT, "--no-passphrase"),
        ("operator", "ann", "--directory", ann, "-o", request),
        ("renew", "operator", "--directory", ann, "-o", request),
        ("sign", request, *authority),
        ("install", bundle, "--directory", ann),
        ("revoke", "ann", *authority),
    ):
        assert "is there already" in refused(*words)
    assert {file: file.read_bytes() for file in fleet.place.rglob("*") if file.is_file()} == before


def test_what_cannot_be_written_is_seen_before_keys_are_made(fleet: ProvisionedFleet) -> None:
    nowhere = fleet.place / "no" / "file"
    assert "cannot be written" in refused("operator", "ann", "--directory", fleet.place / "ann", "-o", nowhere)
    assert not (fleet.place / "ann").exists()
    request, authority = fleet.request("operator", "ann"), fleet.place / "authority"
    before = {file: file.read_bytes() for file in authority.iterdir()}
    assert "cannot be written" in refused("sign", request, "--directory", authority, "-o", nowhere)
    fleet.sign(request)
    signed = {file: file.read_bytes() for file in authority.iterdir()}
    assert signed != before
    assert "cannot be written" in refused("revoke", "ann", "--directory", authority, "-o", nowhere)
    assert {file: file.read_bytes() for file in authority.iterdir()} == signed


def test_nothing_is_written_through_a_link(fleet: ProvisionedFleet, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / "link.request").symlink_to(victim)
    assert "is there already" in refused("viewer", "hall", "--directory", tmp_path / "hall", "-o", "link.request")
    assert victim.read_text() == "mine"
    assert fleet.place == tmp_path


# What is wrong.


def test_a_changed_request_is_refused(fleet: ProvisionedFleet) -> None:
    file = fleet.request("robot", "cruiser-1")
    changed, sign = fleet.place / "changed.request", ("--directory", fleet.authority)
    for one in ({"names": ["cruiser-2"]}, {"more": 1}):
        changed.write_text(json.dumps(json.loads(file.read_text()) | one))
        assert refused("sign", changed, *sign).startswith(str(changed))
    for text in ("", "no", "[]", "\0", "{}", "x" * 100_000):
        changed.write_text(text)
        assert "not a request" in refused("sign", changed, *sign)
    assert "another request" in refused("sign", file, *sign, "--fingerprint", "0000")
    assert not (fleet.authority / "issued.jsonl").exists()


def test_a_request_without_a_grant_is_held_against_its_certificates(fleet: ProvisionedFleet) -> None:
    """A viewer's only key is that of its certificate."""
    file = fleet.request("viewer", "hall")
    request, tls = read_request(file.read_bytes()), KeyStore(fleet.place / "hall").p256("viewer-tls.key", "")
    changes: list[dict[str, object]] = [
        {"names": ["yard"]},
        {"names": ["hall", "yard"]},
        {"role": TransportRole.DESK},
    ]
    for wrong in changes:
        said = msgspec.structs.replace(request, **wrong)
        file.write_bytes(msgspec.json.encode(said))
        assert "not signed by the key of its certificate" in refused("sign", file, "--directory", fleet.authority)
        file.write_bytes(msgspec.json.encode(new_request(said.role, said.names, said.csr, None, tls)))
        assert "name different people" in refused("sign", file, "--directory", fleet.authority)


def test_a_bundle_is_held_against_both_keys(fleet: ProvisionedFleet) -> None:
    authority = read_key(fleet.authority / "authority.key")
    mine = fleet.sign(fleet.request("operator", "ann"))
    run("operator", "ann", "--directory", fleet.place / "other", "-o", fleet.place / "other.request")
    others = fleet.sign(fleet.place / "other.request", "--replace")
    one, two = bundle_of(mine), bundle_of(others)
    for mixed in (
        msgspec.structs.replace(one, chain=two.chain),
        msgspec.structs.replace(one, certificate=two.certificate),
    ):
        mine.write_bytes(bundle_text(mixed, authority))
        assert "answers another request" in refused("install", mine, "--directory", fleet.place / "ann")


def read_key(file: Path) -> Ed25519PrivateKey:
    key = load_pem_private_key(file.read_bytes(), None)
    assert isinstance(key, Ed25519PrivateKey)
    return key


def test_a_bundle_for_other_keys_is_refused(fleet: ProvisionedFleet) -> None:
    one, two = fleet.request("robot", "cruiser-1"), fleet.request("robot", "cruiser-2")
    fleet.sign(two)
    bundle = fleet.sign(one)
    other = refused("install", bundle, "--directory", fleet.place / "cruiser-2")
    assert other.startswith("the bundle is for robot cruiser-1, and answers another request than that of ")
    assert str(fleet.place / "cruiser-2" / "robot-tls.key") in other
    nobodys = refused("install", bundle, "--directory", fleet.place / "nobody")
    assert nobodys.startswith(
        f"the bundle is for robot cruiser-1, whose keys are not in {fleet.place / 'nobody'}: "
    )
    assert "install it where the request was made" in nobodys
    assert not (fleet.place / "cruiser-2" / "robot.grant").exists()


def test_a_key_that_others_may_read_is_refused(fleet: ProvisionedFleet) -> None:
    robot = fleet.let_in("robot", "cruiser-1")
    again = ("renew", "robot", "--directory", robot, "-o", "again.request")
    key = robot / "robot.key"
    key.chmod(0o640)
    assert f"chmod 600 {key}" in refused(*again)
    key.chmod(0o600)
    key.write_bytes((robot / "robot-tls.key").read_bytes())
    assert "another kind of key" in refused(*again)
    key.write_text("no key")
    assert re.search(
        r"robot\.key: not a private key; 'cruiser provision robot NAME --replace' makes", refused(*again)
    )
    bundle = fleet.sign(fleet.request("viewer", "hall"))
    (fleet.place / "hall").chmod(0o770)
    assert "chmod 700" in refused("install", bundle, "--directory", fleet.place / "hall")


@pytest.mark.parametrize("name", ["serials.json", "authority.json", "fleet.json", "ca.pem", "issued.jsonl"])
def test_a_damaged_file_of_the_authority_is_named(fleet: ProvisionedFleet, name: str) -> None:
    request = fleet.request("operator", "ann")
    (fleet.place / "authority" / name).write_text("damaged")
    assert name in refused("sign", request, "--directory", fleet.authority)


def test_flags_that_a_role_has_no_use_for_are_refused(fleet: ProvisionedFleet) -> None:
    request = fleet.request("viewer", "hall")
    text = refused("sign", request, "--directory", fleet.authority, "--speed-limit", "1", "--override")
    assert text == "--override, --speed-limit: not for a viewer"


# Robots that are shown a statement.


class FakePort:
    """A robot's authority that answers at once; ``kept`` is answered in place of any other question."""

    def __init__(self, fleet: Fleet) -> None:
        self.bench = AuthorityBench(fleet)
        self.kept = b""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def robots(self, _timeout_s: float) -> list[str]:
        return ["cruiser-1"]

    def show(self, robot: str, text: bytes, question: bytes, _timeout_s: float) -> Received | None:
        if robot != "cruiser-1":
            return None
        raw = RawRequest(1, "", "", text, len(text), attachment=self.kept or question)
        reply = self.bench.authority.receive(raw, self.bench.now_ns)
        return Received("fleet/cruiser-1/@auth", STATEMENT_REPLY_ENCODING, reply.payload, reply.attachment)


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> FakePort:
    """A robot of a fleet whose authority is known in ann's directory."""
    found = FakePort(Fleet())
    write_authority(tmp_path / "ann", found.bench.fleet)
    monkeypatch.setattr(StatementPort, "open", lambda _: found)
    monkeypatch.setattr(time, "time", lambda: float(NOW_S))
    return found


def shown(text: str, *robots: str) -> int:
    """Return the exit code after these robots, or all, were sent a statement."""
    (file := Path("one.statement")).write_text(text)
    whom = [word for robot in robots for word in ("--robot", robot)] or ["--all"]
    return run("show", file, *whom, "--directory", "ann")


def test_each_robot_says_what_became_of_a_statement(port: FakePort, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = port.bench.fleet
    ann = fleet.operator()
    revoked = fleet.authority.revoke(1, keys=(ann.key,)).text()
    for text, robots, code, says in (
        (chain_text(ann.chain), (), ExitCode.OK, "cruiser-1: accepted"),
        (revoked, (), ExitCode.OK, "cruiser-1: accepted"),
        (revoked, (), ExitCode.OK, "cruiser-1: already has this one or a newer one (this request was"),
        (chain_text(ann.chain), (), ExitCode.REFUSED, "cruiser-1: refused: the grant was revoked; by list 1; ask"),
        (revoked, ("cruiser-9",), ExitCode.UNREACHABLE, "cruiser-9: no reply"),
        (revoked, ("cruiser-1", "cruiser-9"), ExitCode.PARTIAL, "cruiser-1: already has"),
        (Fleet().authority.revoke(9).text(), (), ExitCode.REFUSED, "cruiser-1: refused: the signature"),
    ):
        assert shown(text, *robots) == code
        assert capsys.readouterr().out.startswith(says)
    assert run("show", "one.statement", "--all", "--directory", "ann", "--json") == ExitCode.REFUSED
    answer = json.loads(capsys.readouterr().out)
    assert (answer["robot"], answer["result"]) == ("cruiser-1", "refused")


def test_an_answer_of_before_is_not_believed(port: FakePort, capsys: pytest.CaptureFixture[str]) -> None:
    """Otherwise an attacker who withholds a revocation could make the robot seem to have it."""
    port.kept = b"asked yesterday."
    assert shown(port.bench.fleet.authority.revoke(1).text()) == ExitCode.FAILURE
    assert capsys.readouterr().out.startswith("cruiser-1: accepted, but the reply is not verified")
