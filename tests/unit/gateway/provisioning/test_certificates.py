"""Certificates of nodes: content, usage, and refused requests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from gateway.authority.enrolment import EnrolmentError, TransportRole
from gateway.provisioning.key_files import (
    RENEW_S,
    begins_s,
    check_kinds,
    check_tls_files,
    expires_s,
    issue,
    names_of,
    new_authority,
    new_key,
    new_request,
    read_certificates,
    read_request,
    why_shut_out,
)
from schemas.command_line import CommandError
from tests.support.secured import Network

NOW_S = 1_795_000_000
DAY_S = 86_400


@pytest.mark.parametrize("role", list(TransportRole))
def test_a_certificate_says_role_and_name_and_what_it_is_for(role: TransportRole) -> None:
    ca, key = new_key(), new_key()
    authority = new_authority(ca, NOW_S)
    made = issue(new_request(key, role.value, ["one.example", "10.0.0.5", "::1"]), role, authority, ca, NOW_S)
    (certificate,) = read_certificates(made)
    commons = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    assert [common.value for common in commons] == [role.value]
    assert names_of(certificate) == ["one.example", "10.0.0.5", "::1"]
    usage = set(certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
    serves = role in {TransportRole.ROUTER, TransportRole.DESK}
    expected = {ExtendedKeyUsageOID.CLIENT_AUTH} | ({ExtendedKeyUsageOID.SERVER_AUTH} if serves else set())
    assert usage == expected
    assert certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca is False
    assert expires_s(certificate) == NOW_S + 30 * DAY_S
    certificate.verify_directly_issued_by(read_certificates(authority)[0])


def test_a_certificate_does_not_outlive_its_authority() -> None:
    ca, key = new_key(), new_key()
    authority = new_authority(ca, NOW_S)
    end_s = expires_s(read_certificates(authority)[0])
    request = new_request(key, "viewer", ["hall"])
    late = issue(request, TransportRole.VIEWER, authority, ca, end_s - DAY_S)
    assert expires_s(read_certificates(late)[0]) == end_s
    with pytest.raises(EnrolmentError, match="has expired"):
        issue(request, TransportRole.VIEWER, authority, ca, end_s)


def made_by_hand(key: ec.EllipticCurvePrivateKey | ed25519.Ed25519PrivateKey, *, named: bool) -> str:
    builder = x509.CertificateSigningRequestBuilder().subject_name(
        x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "viewer")])
    )
    if named:
        builder = builder.add_extension(x509.SubjectAlternativeName([x509.DNSName("hall")]), critical=False)
    algorithm = None if isinstance(key, ed25519.Ed25519PrivateKey) else SHA256()
    return builder.sign(key, algorithm).public_bytes(Encoding.PEM).decode()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no certificate request in"),
        ("-----BEGIN CERTIFICATE REQUEST-----\nAAAA\n-----END CERTIFICATE REQUEST-----\n", "no certificate"),
        (made_by_hand(new_key(), named=False), "no name"),
        (made_by_hand(ed25519.Ed25519PrivateKey.generate(), named=True), "P-256"),
        (made_by_hand(ec.generate_private_key(ec.SECP384R1()), named=True), "P-256"),
    ],
)
def test_a_request_that_is_none_is_refused(text: str, says: str) -> None:
    with pytest.raises(EnrolmentError, match=says):
        read_request(text)


def test_a_request_is_signed_by_its_own_key() -> None:
    der = bytearray(
        x509.load_pem_x509_csr(new_request(new_key(), "viewer", ["hall"]).encode()).public_bytes(Encoding.DER)
    )
    assert b"hall" in der
    der[der.index(b"hall")] = ord("b")
    text = x509.load_der_x509_csr(bytes(der)).public_bytes(Encoding.PEM).decode()
    with pytest.raises(EnrolmentError, match="not signed by its own key"):
        read_request(text)


# The files that a Zenoh file names.


def router_of(place: Path) -> Path:
    place.mkdir(exist_ok=True)
    return Network(place, "tls/127.0.0.1:47447").node(TransportRole.ROUTER, "127.0.0.1") / "router.json5"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return router_of(tmp_path)


def ends_s(file: Path) -> int:
    return expires_s(read_certificates(file.with_name("router-tls.pem").read_text())[0])


def refused(file: Path, now_s: float, says: str) -> None:
    with pytest.raises(CommandError, match=says):
        check_tls_files(file, "router", now_s)


def test_files_that_fit_are_taken_and_an_end_that_is_near_is_said(file: Path) -> None:
    assert check_tls_files(file, "router", ends_s(file) - RENEW_S - 60) == ""
    assert "'cruiser provision renew router'" in check_tls_files(file, "router", ends_s(file) - RENEW_S + 60)


@pytest.mark.parametrize("name", ["router-tls.key", "router-tls.pem", "ca.pem"])
def test_a_file_that_is_missing_or_damaged_is_named(file: Path, name: str) -> None:
    """Zenoh's own error names no file."""
    wrong, now_s = file.with_name(name), ends_s(file) - DAY_S
    wrong.write_text("damaged")
    wrong.chmod(0o600)
    refused(file, now_s, name)
    wrong.unlink()
    refused(file, now_s, f"{name} is not there; 'cruiser provision")


def test_a_certificate_of_another_key_and_one_that_is_over_are_named(file: Path, tmp_path: Path) -> None:
    """Zenoh opens with both, and no session connects."""
    refused(file, ends_s(file) + DAY_S, r"router-tls\.pem ended 1\.0 days ago; 'cruiser provision renew router'")
    other = router_of(tmp_path / "other").parent
    file.with_name("router-tls.pem").write_bytes((other / "router-tls.pem").read_bytes())
    refused(file, ends_s(file) - DAY_S, "is not the certificate of")
    file.with_name("router-tls.key").chmod(0o644)
    refused(file, ends_s(file) - DAY_S, "chmod 600")


def test_why_no_session_opened_is_looked_for_in_its_files(file: Path) -> None:
    begins = begins_s(read_certificates(file.with_name("router-tls.pem").read_text())[0])
    assert why_shut_out(file, begins + 1) == ""
    assert "begins in 2.0 days by this computer's clock: the clock is behind, set it" in why_shut_out(
        file, begins - 2 * DAY_S
    )
    file.with_name("router-tls.key").unlink()
    assert why_shut_out(file, begins + 1).startswith(f"{file.with_name('router-tls.key')} is not there; ")


@pytest.mark.parametrize("name", ["router.json5", "router-tls.key", "router-tls.pem", "ca.pem"])
def test_a_fifo_is_not_waited_for(file: Path, name: str) -> None:
    check_kinds(file)
    wrong = file.with_name(name)
    wrong.unlink()
    check_kinds(file)
    os.mkfifo(wrong, 0o600)
    with pytest.raises(CommandError, match=f"{name} is a FIFO"):
        check_kinds(file)
    refused(file, NOW_S, f"{name} is a FIFO")
