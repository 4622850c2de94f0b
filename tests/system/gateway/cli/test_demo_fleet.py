"""``cruiser demo-fleet``: a fleet with keys, as a user starts it."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.processes.gateway import run

TIMEOUT_S = 400
"""On a busy machine the story is played once more, twice at most."""

pytestmark = pytest.mark.timeout(TIMEOUT_S)

SEEN = {
    "keys": "0 readable for others",
    "the viewer lists robots": "cruiser-1, cruiser-2, none of them lost",
    "the viewer asks why": "ann holds the lease",
    "an intruder without TLS": "refused",
    "an intruder without a certificate": "refused",
    "an intruder with another authority's certificate": "refused",
    "the viewer commands": "refused",
    "a desk without a grant commands": "proof_missing",
    "forged drives, leases, a stop of all": "0 answered",
    "the operator resets": "cleared remote_stop",
    "the viewer stops one robot": "cruiser-2: stops",
    "robots take over the revocation": "cruiser-1: taken over; cruiser-2: taken over",
    "the robot stops in a controlled way": "the grant was revoked",
    "the operator's drive ends": "grant_revoked",
    "the operator drives again": "the grant was revoked",
    "speed": "0.5 granted",
    "the log of cruiser-1": "0 missing or changed",
    "the log of cruiser-2": "0 missing or changed",
    "what reached cruiser-1 of the forged commands": "0 verbs and drives, 0 stops",
    "who drove cruiser-1": "ann by depot by the authority",
    "cruiser review verify": "exit code 0",
}
"""What the demo has to see, and words of it."""


@pytest.mark.long
def test_a_fleet_is_driven_attacked_and_its_operator_locked_out(tmp_path: Path) -> None:
    """Every fact is as it should be; settings of another robot change nothing. The log can be asked again."""
    foreign = {"CRUISER_ROBOT_ROOT": "elsewhere", "CRUISER_ZENOH_CONNECT": "tcp/127.0.0.1:1"}
    done = run(["demo-fleet", "--out", str(tmp_path / "fleet"), "--json"], TIMEOUT_S, **foreign)
    assert done.returncode == 0, (done.stdout, done.stderr)
    summary = json.loads(done.stdout)
    assert summary["holds"]
    facts = {fact["what"]: fact["seen"] for fact in summary["facts"]}
    assert facts.keys() == SEEN.keys()
    assert [what for what, words in SEEN.items() if words not in facts[what]] == []
    place = Path(summary["directory"])
    again = run(
        ["review", "verify", str(place / "recorder/log"), "--authority", str(place / "ann/authority.json")]
    )
    assert again.returncode == 0, again.stderr
    assert "by depot < authority" in again.stdout


@pytest.mark.night
def test_a_fleet_that_is_held_serves_clients_until_ctrl_c(tmp_path: Path) -> None:
    """It says where its router is, and where the files of its people are. Nothing of it is left running."""
    words = [sys.executable, "-m", "gateway", "demo-fleet", "--hold", "--json", "--out", str(tmp_path / "fleet")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            places = json.loads(process.stdout.readline())
            operator = ["--config", f"{places['operator']}/operator.toml"]
            listed = run(["list", *operator])
            assert [
                f"{robot}  OFFLINE" not in listed.stdout and robot in listed.stdout for robot in places["robots"]
            ] == [True, True]
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 0, errors
    ended = run(["list", *operator, "--timeout", "1"])
    assert ended.returncode == 4, ended.stdout


def test_ctrl_c_ends_it_while_people_are_let_in(tmp_path: Path) -> None:
    """Soon, without the rest of the story."""
    words = [sys.executable, "-m", "gateway", "demo-fleet", "--out", str(tmp_path / "fleet")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            for line in process.stdout or ():
                if "provision authority" in line:
                    break
            process.send_signal(signal.SIGINT)
            told, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 3
    assert errors == "cruiser demo-fleet: interrupted\n"
    assert "provision sign" not in told


def test_a_directory_that_cannot_be_written_is_one_clear_line() -> None:
    """Nothing starts."""
    done = run(["demo-fleet", "--out", "/proc/nowhere"])
    assert done.returncode == 1
    assert "cannot write in /proc/nowhere" in done.stderr
    assert len(done.stderr.splitlines()) == 1
