"""``cruiser provision`` in this process, and fleets that it makes."""

from __future__ import annotations

import argparse
import os
from functools import cache
from pathlib import Path

import msgspec

from gateway.authority.enrolment import Bundle
from gateway.cli import provision
from gateway.cli.configuration_file import load_settings
from gateway.provisioning.issuer import Issuer
from gateway.provisioning.key_files import KeyStore
from schemas.authority.proof import Grant, Signed, StatementFault, read_chain

ENDPOINT = "tls/127.0.0.1:47447"


@cache
def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="cruiser provision")
    provision.add_arguments(parser)
    return parser


def run(*words: str | Path) -> int:
    arguments = _parser().parse_args(list(map(str, words)))
    flags = {key: value for key, value in vars(arguments).items() if "." in key and value is not None}
    return provision.run(arguments, load_settings(None, os.environ, flags), lambda: False)


class ProvisionedFleet:
    """Standby, authority and enrolled parties of a fleet below one directory."""

    def __init__(self, place: Path, endpoint: str = ENDPOINT) -> None:
        self.place = place
        self.authority = place / "authority"
        run("standby", "--directory", place / "standby", "--no-passphrase")
        standby = place / "standby" / "standby.pub"
        run(
            *("authority", "--directory", place / "authority", "--standby", standby),
            *("--router", endpoint, "--no-passphrase"),
        )

    @property
    def fingerprint(self) -> str:
        return Issuer.open(KeyStore(self.authority)).fingerprint

    def request(self, role: str, name: str, place: str = "") -> Path:
        """The request of a new party, whose keys are in a directory of its own, or in that place."""
        file = self.place / f"{role}-{name}.request"
        run(role, name, "--directory", self.place / (place or name), "-o", file)
        return file

    def sign(self, request: Path, *words: str, by: str = "authority") -> Path:
        run("sign", request, "--directory", self.place / by, *words)
        return request.with_suffix(".bundle")

    def let_in(self, role: str, name: str, *words: str, by: str = "authority") -> Path:
        """Enrol a new party. Returns the directory of its keys."""
        bundle = self.sign(self.request(role, name), *words, by=by)
        run("install", bundle, "--directory", self.place / name, "--fingerprint", self.fingerprint)
        return self.place / name

    def grant(self, name: str, role: str = "operator") -> Grant:
        statement = chain(self.place / name / f"{role}.grant")[0].statement
        assert isinstance(statement, Grant)
        return statement


def chain(file: Path) -> list[Signed]:
    found = read_chain(file.read_bytes())
    assert not isinstance(found, StatementFault), found
    return found


def bundle_of(file: Path) -> Bundle:
    return msgspec.json.decode(file.read_bytes().partition(b"\n")[0], type=Bundle)
