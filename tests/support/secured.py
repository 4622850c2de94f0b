"""A network with certificates and access control, as ``cruiser provision`` would make it."""

from __future__ import annotations

import json
import time
from pathlib import Path

import zenoh
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from gateway.authority.enrolment import (
    CA_FILE,
    CERTIFICATE_FILE,
    SHUT_OUT_FILE,
    TLS_KEY_FILE,
    TransportRole,
    tls_configuration,
    zenoh_configuration,
)
from gateway.provisioning.key_files import (
    issue,
    new_authority,
    new_key,
    new_request,
)

ROOT = "fleet"


class Network:
    """A transport authority, and directories of nodes below one directory."""

    def __init__(self, directory: Path, endpoint: str = "") -> None:
        self.directory = directory
        self.endpoint = endpoint
        self.key = new_key()
        self.certificate = new_authority(self.key, int(time.time()))

    def node(self, role: TransportRole, name: str, robot: str = "", born_s: int | None = None) -> Path:
        place = self._certified(role, name, int(time.time()) if born_s is None else born_s)
        file = zenoh_configuration(role, ROOT, place, [self.endpoint], robot)
        write(place / f"{role.value}.json5", json.dumps(file))
        return place

    def tls_file(self, name: str, role: TransportRole = TransportRole.DESK, **entries: object) -> str:
        """A Zenoh file of a node with mutual TLS and no rules."""
        place = self._certified(role, name, int(time.time()))
        link = {"protocols": ["tls"], "tls": tls_configuration(role, place)}
        file = place / "tls.json5"
        write(file, json.dumps({"transport": {"link": link}, **entries}))
        return str(file)

    def _certified(self, role: TransportRole, name: str, now_s: int) -> Path:
        place = self.directory / f"{role.value}-{name}"
        place.mkdir(exist_ok=True)
        key = new_key()
        request = new_request(key, role.value, [name])
        certificate = issue(request, role, self.certificate, self.key, now_s)
        if role is TransportRole.ROBOT:
            shut_out = issue(request, TransportRole.NOTHING, self.certificate, self.key, now_s)
            write(place / SHUT_OUT_FILE, shut_out)
        write(place / TLS_KEY_FILE.format(who=role.value), pem(key))
        write(place / CERTIFICATE_FILE.format(who=role.value), certificate)
        write(place / CA_FILE, self.certificate)
        return place

    def session(self, role: TransportRole, name: str, robot: str = "", **entries: object) -> zenoh.Session:
        """A session of a new node, with entries of its Zenoh configuration by path (``__`` for a slash)."""
        config = zenoh.Config.from_file(str(self.node(role, name, robot) / f"{role.value}.json5"))
        for path, value in entries.items():
            config.insert_json5(path.replace("__", "/"), json.dumps(value))
        return zenoh.open(config)


def pem(key: ec.EllipticCurvePrivateKey) -> str:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()


def write(path: Path, text: str) -> None:
    path.write_text(text, "utf-8")
    path.chmod(0o600)
