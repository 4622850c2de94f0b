"""``cruiser record stop`` and the rest to a recorder in signed mode: by grant alone."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas.exit_codes import ExitCode
from tests.support.authority import Fleet, Party
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.messages import gear, sample_of
from tests.support.processes.recorder import Process, Told, ask, link, recording
from tests.support.provisioned import provision, write_authority
from tests.support.waiting import wait_until

DAY_S = 86_400


class SignedDepot:
    """A recorder in signed mode, and people with their keys."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.fleet = Fleet()
        self.endpoint = free_endpoint()
        self.logs = directory / "logs"
        write_authority(directory, self.fleet)

    def person(self, name: str, verbs: list[str]) -> Path:
        """Somebody with a grant; where the files are."""
        party, now_s = Party(name), int(time.time())
        self.fleet.authority.grant(party, verbs=verbs, not_before=now_s - 60, not_after=now_s + DAY_S)
        return provision(self.directory / name, "operator", party, self.fleet)


def act_as(monkeypatch: pytest.MonkeyPatch, directory: Path, mode: str = "signed") -> None:
    """What the next process inherits."""
    monkeypatch.setenv("CRUISER_AUTHORITY_MODE", mode)
    monkeypatch.setenv("CRUISER_AUTHORITY_DIRECTORY", str(directory))


@pytest.fixture
def depot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SignedDepot]:
    """It has heard something."""
    (tmp_path / "recorder").mkdir()
    one = SignedDepot(tmp_path / "recorder")
    with Peer(one.endpoint) as peer:
        act_as(monkeypatch, one.directory)
        with recording("-o", str(one.logs), "--connect", one.endpoint, "--name", "depot") as process:
            ready(process, peer, one)
            yield one


def ready(process: Process, peer: Peer, depot: SignedDepot) -> None:
    """Wait until it writes a log."""
    assert "waiting" in process.ready
    link(peer, depot.logs)
    peer.put(sample_of(gear(0)))
    told = Told(peer)
    wait_until(lambda: any(len(health.challenge) == 8 for health in told.healths("depot")))


def order(depot: SignedDepot, *words: str) -> tuple[int, str]:
    """The exit code of an order, and what the recorder replied."""
    code, out, err = ask(*words, "--connect", depot.endpoint, "--json")
    assert "Traceback" not in err
    return code, json.loads(out)["detail"] if out else err


def test_an_order_is_obeyed_by_grant_alone(depot: SignedDepot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Status is for everybody. Whoever signs nothing, or has no such verb, is told why, and what would help."""
    ann, bob = depot.person("ann", ["stop", "start", "split", "mark"]), depot.person("bob", ["split"])
    act_as(monkeypatch, ann, mode="open")
    assert order(depot, "status")[0] == ExitCode.OK
    for verb in ("stop", "split", "start", "mark"):
        code, detail = order(depot, verb)
        assert (code, "proof_missing" in detail) == (ExitCode.REFUSED, True), detail
    act_as(monkeypatch, bob)
    assert order(depot, "split")[0] == ExitCode.OK
    code, detail = order(depot, "stop")
    assert code == ExitCode.REFUSED
    assert "stop is not among its verbs (not_granted)" in detail
    act_as(monkeypatch, ann)
    assert order(depot, "stop") == (ExitCode.OK, "stopped: nothing is written but incidents")
    assert order(depot, "start")[0] == ExitCode.OK
    code, detail = order(depot, "stop", "--operator", "carl")
    assert code == ExitCode.USAGE
    assert "the grant is of ann" in detail


def test_a_stranger_is_refused(depot: SignedDepot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whose grant is of another authority, and who has no files at all."""
    elsewhere = depot.directory / "elsewhere"
    elsewhere.mkdir()
    stranger = SignedDepot(elsewhere)
    act_as(monkeypatch, stranger.person("eve", ["stop"]))
    code, detail = order(depot, "stop")
    assert code == ExitCode.REFUSED
    assert "grant_unknown" in detail
    act_as(monkeypatch, depot.directory / "nowhere")
    code, detail = order(depot, "stop")
    assert code == ExitCode.USAGE
    assert "operator.key is not there; 'cruiser provision operator NAME' makes it" in detail


def test_a_recorder_without_its_authority_does_not_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would obey nobody, or everybody."""
    act_as(monkeypatch, tmp_path)
    with recording("-o", str(tmp_path / "logs"), "--connect", free_endpoint()) as process:
        code, _, _ = process.end(None)
    assert code == ExitCode.USAGE
    assert "authority.json is not there; 'cruiser provision install' writes it" in process.ready
