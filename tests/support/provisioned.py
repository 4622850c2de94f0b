"""Files of a fleet in signed mode, as ``cruiser provision`` leaves them on each machine."""

from __future__ import annotations

import json
from pathlib import Path

from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from schemas.authority.proof import chain_text
from tests.support.authority import Fleet, Party


def provision(directory: Path, who: str, party: Party, fleet: Fleet) -> Path:
    """Write a party's key, grant and authority to a directory. Returns the directory."""
    directory.mkdir(parents=True, exist_ok=True)
    key = directory / f"{who}.key"
    key.write_bytes(party.private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    key.chmod(0o600)
    (directory / f"{who}.grant").write_text(chain_text(party.chain))
    return write_authority(directory, fleet)


def write_authority(directory: Path, fleet: Fleet) -> Path:
    directory.mkdir(exist_ok=True)
    said = {"active": fleet.authority.key.hex(), "standby": fleet.standby.key.hex()}
    (directory / "authority.json").write_text(json.dumps(said))
    return directory
