"""From a put on Zenoh to the frame on the bus in signed mode, beside open mode: in turns, on one machine."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from random import Random
from tempfile import mkdtemp
from unittest.mock import patch

import msgspec

from gateway.authority.operator_proof import OperatorProof, new_lease_key, new_question
from gateway.zenoh.client import received_of
from schemas.authority.proof import GrantRole
from schemas.decisions import LeaseReply
from tests.bench.command_latency import COMMAND, Driver, drives_us, on_the_road, until
from tests.bench.loads import Row
from tests.bench.processes import quantile
from tests.support.signed_site import ROBOT, ROOT, Site

NAME = "bench"


class SignedDriver(Driver):
    """An operator who signs; it verifies nothing that it receives."""

    def __init__(self, endpoint: str, proof: OperatorProof) -> None:
        super().__init__(endpoint)
        self._proof = proof
        until(self._is_met, pause_s=0.1)

    def prove(self, verb: str, payload: bytes) -> bytes | None:
        if verb == "drive":
            return self._proof.drive(payload)
        return self._proof.request(ROBOT, verb, payload, self.look()["challenge"])

    def take(self) -> int:
        private, public = new_lease_key()
        payload = msgspec.msgpack.encode({"role": "supervisor", "public_key": public})
        attachment = self.prove("take", payload)
        for reply in self.session.get(f"{COMMAND}take", payload=payload, attachment=attachment, timeout=5):
            if reply.ok is not None:
                received = received_of(reply.ok)
                said = msgspec.msgpack.decode(received.payload, type=LeaseReply)
                if not self._proof.begin_lease(ROBOT, private, said, received.attachment):
                    raise RuntimeError(f"take: {said}")
                return said.lease
        raise RuntimeError("no reply to take")

    def _is_met(self) -> bool:
        question = new_question()
        for reply in self.session.get(
            f"{ROOT}/{ROBOT}/@auth", payload=self._proof.statement, attachment=question, timeout=1
        ):
            if reply.ok is not None and self._proof.meet(ROBOT, received_of(reply.ok), question) is None:
                return True
        return False


def measure(turns: int, drives: int) -> list[tuple[list[float], list[float]]]:
    """Of each turn, open and signed: microseconds from put to frame, sorted."""
    found: list[tuple[list[float], list[float]]] = []
    with tempfile.TemporaryDirectory() as directory:
        site = Site(Path(directory))
        party = site.fleet.operator(NAME, role=GrantRole.SUPERVISOR, **site.holds)

        def signed_driver(endpoint: str) -> SignedDriver:
            proof = OperatorProof(party.private, party.chain, site.fleet.trust, ROOT, lambda: int(time.time()))
            return SignedDriver(endpoint, proof)

        for turn in range(turns):
            pair: dict[bool, list[float]] = {}
            for is_signed in (False, True) if turn % 2 == 0 else (True, False):
                command = ("-m", "gateway", "gateway", "--config", site.robot_settings) if is_signed else ()
                road = on_the_road(*command, driver_at=signed_driver if is_signed else Driver)
                # What a robot knows of the authority has to be kept somewhere.
                own = patch.dict(os.environ, CRUISER_GATEWAY_STATE_DIR=mkdtemp(dir=directory))
                with own, road as (driver, witness, *_):
                    # The same places between two ticks in both.
                    pair[is_signed] = sorted(drives_us(driver, witness, drives, Random(turn)))  # noqa: S311
            found.append((pair[False], pair[True]))
    return found


def rows(turns: int, drives: int) -> list[Row]:
    measured = measure(turns, drives)
    opened, signed = (sorted(one for pair in measured for one in pair[mode]) for mode in (0, 1))
    whole_ms = (quantile(signed, 0.99) - quantile(opened, 0.99)) / 1000
    middle_ms = (quantile(signed, 0.5) - quantile(opened, 0.5)) / 1000
    return [
        ("drive put to first CAN frame, open mode, p50 p99", _ms(opened), ""),
        ("  signed mode, with the making of the proof", _ms(signed), ""),
        ("  the difference at p50", f"{middle_ms:+.2f} ms", ""),
        ("  the difference at p99", f"{whole_ms:+.2f} ms", "under 1 ms"),
    ]


def _ms(values_us: list[float]) -> str:
    return f"{quantile(values_us, 0.5) / 1000:.2f} {quantile(values_us, 0.99) / 1000:.2f} ms, of {len(values_us)}"
