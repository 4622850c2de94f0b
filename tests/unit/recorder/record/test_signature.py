"""The signature beside a log, as text."""

from __future__ import annotations

import pytest

from recorder.record.signed_mode import LogSignature, LogSigner
from schemas.authority.key_files import Identity
from schemas.authority.proof import GrantRole
from tests.support.authority import Fleet, Party

FLEET = Fleet()
RECORDER, OTHER = Party("depot-1"), Party("depot-2")
for party in (RECORDER, OTHER):
    FLEET.authority.grant(party, role=GrantRole.RECORDER)
SHA256 = "0123456789abcdef" * 4
TEXT = LogSigner(Identity(RECORDER.private, RECORDER.chain, FLEET.trust)).sign(SHA256, "x.mcap")
ANOTHER = LogSigner(Identity(OTHER.private, OTHER.chain, FLEET.trust)).sign(SHA256, "x.mcap")
LINES, OTHERS = TEXT.splitlines(keepends=True), ANOTHER.splitlines(keepends=True)


def test_it_is_read_as_it_was_written() -> None:
    found = LogSignature.read(TEXT)
    assert found is not None
    assert (found.sha256, found.file, found.key) == (SHA256, "x.mcap", RECORDER.key)
    assert found.fits


@pytest.mark.parametrize("line", [1, 2])
def test_lines_of_two_signatures_do_not_fit(line: int) -> None:
    other = LogSigner(Identity(RECORDER.private, RECORDER.chain, FLEET.trust)).sign(SHA256[::-1], "x.mcap")
    found = LogSignature.read(b"".join([*LINES[:line], other.splitlines(keepends=True)[line], *LINES[line + 1 :]]))
    assert found is not None
    assert not found.fits


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\xff\x00",
        TEXT[:-1],
        TEXT + b"\n",
        TEXT.replace(b"cruiser-log-1", b"cruiser-log-2"),
        TEXT.replace(b"x.mcap", b"../x.mcap"),
        b"".join(LINES[:6]),
        # A stranger would check by this key, and Cruiser by that of the grant.
        b"".join([*LINES[:3], *OTHERS[3:6], *LINES[6:]]),
        b"".join([*LINES[:6], *OTHERS[6:]]),
    ],
)
def test_what_is_in_another_form_is_none(text: bytes) -> None:
    assert LogSignature.read(text) is None
