"""The statements that are verified in a tick. What anybody may send must not keep out what the authority says."""

from __future__ import annotations

import os
from random import Random

import msgspec
import pytest

from gateway.authority.admission import KEPT_WAITING, WORDS_PER_TICK, StatementKind, StatementSieve
from schemas.authority.proof import Signed, chain_text
from tests.support.authority import AuthorityBench, Fleet, Party

FLOOD = 250
"""Statements that arrive in one tick: 25,000 a second."""

SEEDED = Random(1)  # noqa: S311 - chance that comes again


class Sieve:
    """A robot's sieve; each statement stands for itself."""

    def __init__(self) -> None:
        self.bench = AuthorityBench()
        self.fleet = self.bench.fleet
        self.sieve: StatementSieve[bytes] = StatementSieve(self.bench.authority.admission, SEEDED.sample)

    def tick(self, *texts: bytes) -> list[bytes]:
        return self.sieve.choose((text, text) for text in texts)

    def kind(self, text: str | bytes) -> StatementKind:
        return self.sieve.kind_of(text.encode() if isinstance(text, str) else text)


def forged(signed: Signed) -> bytes:
    """The same, under a signature that does not fit: whoever knows a public key can name it."""
    return msgspec.structs.replace(signed, signature=os.urandom(64)).text().encode()


def floods(fleet: Fleet) -> dict[str, list[bytes]]:
    """Everything that anybody with a certificate can send, each so often that it fills a tick."""
    ann, stranger = fleet.operator(), Fleet()
    return {
        "junk": [os.urandom(3) for _ in range(FLOOD)],
        "nothing": [b""] * FLOOD,
        "large": [bytes(16_384)] * FLOOD,
        "a grant that holds": [chain_text(ann.chain).encode()] * FLOOD,
        "forged grants": [forged(ann.chain[0]) for _ in range(FLOOD)],
        "lists of another authority": [stranger.authority.revoke(9).text().encode()] * FLOOD,
        "rotations of the active key": [forged(fleet.authority.rotate(9, Party(), Party())) for _ in range(FLOOD)],
        "lists of before": [fleet.authority.revoke(1).text().encode()] * FLOOD,
        "rotations of before": [fleet.standby.rotate(0, Party(), Party()).text().encode()] * FLOOD,
    }


@pytest.mark.parametrize("flood", floods(Fleet()))
def test_no_flood_keeps_a_revocation_or_a_rotation_waiting(flood: str) -> None:
    """Each is chosen in the tick in which it arrives, whatever else does."""
    sieve = Sieve()
    assert sieve.bench.show(sieve.fleet.authority.revoke(1).text()).ok
    sent = floods(sieve.fleet)[flood]
    for signed in (
        sieve.fleet.authority.revoke(2),
        sieve.fleet.standby.revoke(2),
        sieve.fleet.standby.rotate(1, Party(), Party()),
    ):
        word = signed.text().encode()
        assert word in sieve.tick(*sent[:100], word, *sent[100:])


def test_a_flood_in_the_authoritys_name_lets_each_through_by_chance() -> None:
    """It takes a signature to find these out. Who sends the true one again gets it through; no order helps."""
    sieve = Sieve()
    word = sieve.fleet.authority.revoke(1)
    for place in (0, FLOOD):
        through = 0
        for _ in range(300):
            sent = [forged(word) for _ in range(FLOOD)]
            sent.insert(place, word.text().encode())
            through += word.text().encode() in sieve.tick(*sent)
        # Of 251, four are verified, and sixteen wait for the next tick: 1.6 to 1.7 in a hundred.
        assert 0 < through < 20


def test_so_many_are_chosen_in_a_tick() -> None:
    """Each of them costs signatures."""
    sieve = Sieve()
    assert sieve.bench.show(sieve.fleet.authority.revoke(1).text()).ok
    forgeries = [forged(sieve.fleet.authority.revoke(2)) for _ in range(FLOOD)]
    others = [one for flood in floods(sieve.fleet).values() for one in flood]
    chosen = sieve.tick(*forgeries, *others)
    assert [one in forgeries for one in chosen] == [True] * WORDS_PER_TICK + [False]


def test_each_kind_has_its_turn() -> None:
    """A flood of one kind leaves the others their share."""
    sieve = Sieve()
    known = chain_text(sieve.fleet.operator().chain).encode()
    assert sieve.bench.show(known.decode()).ok
    new = chain_text(sieve.fleet.operator("bob").chain).encode()
    chosen = sieve.tick(*[b"x"] * FLOOD, known, new, b"")
    for _ in range(3):
        chosen += sieve.tick(*[b"x"] * FLOOD)
    assert sorted(chosen) == sorted([b"x", known, new, b""])


def test_what_is_not_chosen_waits_for_the_next_tick() -> None:
    """Two people who ask in one tick are both answered; of a flood only so many are kept."""
    sieve = Sieve()
    people = [chain_text(sieve.fleet.operator(name).chain).encode() for name in ("ann", "bob", "cyd")]
    chosen = sieve.tick(*people)
    for _ in range(3):
        chosen += sieve.tick()
    assert sorted(chosen) == sorted(people)
    chosen = sieve.tick(*[b"x"] * FLOOD)
    for _ in range(FLOOD):
        chosen += sieve.tick()
    assert len(chosen) == KEPT_WAITING + 1


def test_a_kind_is_known_by_the_text_alone() -> None:
    """By its beginning, who is said to have signed it, and what the robot knows already."""
    sieve = Sieve()
    fleet, kind = sieve.fleet, sieve.kind
    ann = fleet.operator()
    assert kind(chain_text(ann.chain)) is StatementKind.NEW
    assert kind(chain_text(Fleet().operator().chain)) is StatementKind.REST
    assert sieve.bench.show(chain_text(ann.chain)).ok
    assert kind(chain_text(ann.chain)) is StatementKind.KNOWN
    assert kind("") is StatementKind.QUESTION
    assert kind("# a comment\n" + chain_text(ann.chain)) is StatementKind.REST
    assert kind(fleet.authority.revoke(1).text()) is StatementKind.WORD
    assert sieve.bench.show(fleet.authority.revoke(1).text()).ok
    assert kind(fleet.authority.revoke(1).text()) is StatementKind.REST
    assert kind(fleet.authority.revoke(2).text()) is StatementKind.WORD
    assert kind(fleet.standby.rotate(1, Party(), Party()).text()) is StatementKind.WORD
    assert kind(fleet.authority.rotate(1, Party(), Party()).text()) is StatementKind.REST
    assert kind(b'{"kind":"revocations","serial":' + b"9" * 4000) is StatementKind.REST
