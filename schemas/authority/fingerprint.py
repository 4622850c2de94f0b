"""Fingerprints of keys and requests: the one form in which people compare them. Pure."""

from __future__ import annotations

import hashlib


def fingerprint(data: bytes) -> str:
    """Return a text that two people compare by voice: the first half of a SHA-256, in groups."""
    digest = hashlib.sha256(data).hexdigest()[:32]
    return "-".join(digest[start : start + 4] for start in range(0, len(digest), 4))


def key_fingerprint(key: str) -> str:
    """The fingerprint of a public key, hexadecimal."""
    return fingerprint(bytes.fromhex(key))
