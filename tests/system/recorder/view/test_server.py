"""The WebSocket server, with real viewers on it."""

import datetime as dt
import ipaddress
import resource
import ssl
from collections.abc import Iterator
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID
from websockets.exceptions import WebSocketException

from recorder.mcap.writer import LogChannel
from recorder.view import RECORDS_WAITING, ViewServer
from schemas.command_line import CommandError, ExitCode
from schemas.messages import Gear
from tests.support.foxglove_client import FoxgloveClient
from tests.support.logs import channel_of
from tests.support.waiting import wait_until

TOPIC = "fleet/cruiser-1/chassis/gear"
CHANNEL: LogChannel = channel_of(Gear, 7, TOPIC)
RECORD_BYTES = 4096


@pytest.fixture
def server() -> Iterator[ViewServer]:
    with ViewServer("bench", "127.0.0.1", 0) as one:
        one.declare(CHANNEL)
        yield one


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * resource.getpagesize()


def test_a_viewer_that_reads_nothing_holds_up_nobody(server: ViewServer) -> None:
    """Of 200 MB it gets the content of its ring; memory does not grow, and another viewer sees the newest."""
    with FoxgloveClient(server.where) as stalled, FoxgloveClient(server.where) as viewer:
        for one in (stalled, viewer):
            one.wait(lambda client: bool(client.channels)).subscribe()
        wait_until(lambda: len(list(server.subscribed())) > 0)
        before = resident_bytes()
        for number in range(50_000):
            server.write(7, number, bytes(RECORD_BYTES))
        assert resident_bytes() - before < 8 * RECORDS_WAITING * RECORD_BYTES
        server.write(7, 1, b"newest")
        viewer.wait(lambda client: any(message.data == b"newest" for message in client.messages))
        assert server.is_wanted(7)


def test_a_port_that_is_taken_is_one_line(server: ViewServer) -> None:
    port = int(server.where.rpartition(":")[2])
    with pytest.raises(CommandError, match=rf"cannot listen on 127\.0\.0\.1:{port}: .*in use") as error:
        ViewServer("bench", "127.0.0.1", port)
    assert error.value.code is ExitCode.UNREACHABLE
    assert "\n" not in str(error.value)


def certified(directory: Path, name: str) -> tuple[Path, Path]:
    """A self-signed certificate of 127.0.0.1, and its key in OpenSSL's old form."""
    key = ec.generate_private_key(ec.SECP256R1())
    named = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = dt.datetime.now(dt.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(named)
        .issuer_name(named)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - dt.timedelta(days=1))
        .not_valid_after(now + dt.timedelta(days=1))
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]), critical=False
        )
        .sign(key, hashes.SHA256())
    )
    files = directory / f"{name}.pem", directory / f"{name}.key"
    files[0].write_bytes(made.public_bytes(Encoding.PEM))
    files[1].write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.TraditionalOpenSSL, NoEncryption()))
    return files


def test_with_a_certificate_it_speaks_tls_alone(tmp_path: Path) -> None:
    files = certified(tmp_path, "desk")
    with ViewServer("bench", "127.0.0.1", 0, files) as server:
        assert server.where.startswith("wss://127.0.0.1:")
        with FoxgloveClient(server.where, ssl.create_default_context(cafile=files[0])) as viewer:
            assert viewer.info["name"] == "bench"
        with pytest.raises(WebSocketException), FoxgloveClient(server.where.replace("wss:", "ws:")):
            pass


def test_files_that_are_no_certificate_with_its_key_are_named(tmp_path: Path) -> None:
    chain, key = certified(tmp_path, "one")
    _, other = certified(tmp_path, "two")
    for files in ((tmp_path / "no.pem", key), (key, chain), (chain, other)):
        with pytest.raises(CommandError, match=r"no certificate with its key|do not match") as error:
            ViewServer("bench", "127.0.0.1", 0, files)
        assert str(files[0]) in str(error.value)
        assert str(files[1]) in str(error.value)
        assert "\n" not in str(error.value)
