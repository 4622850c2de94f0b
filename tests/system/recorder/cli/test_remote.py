"""``cruiser record status`` and ``mark``, against real recorders."""

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from recorder.cli import record
from recorder.record.incidents import INCIDENT_NAME
from recorder.review.info import read_info
from schemas.command_line import ExitCode
from schemas.recording import RecorderEventKind
from tests.support.fakes.peer import Peer
from tests.support.fakes.recorders import a_reply, answering
from tests.support.logs import logs_in
from tests.support.messages import gear, sample_of
from tests.support.processes.recorder import Told, ask, link, recording
from tests.support.waiting import wait_until

HOSTILE = "\x1b[2J\x9b31m\x07\nhost: recording\r\u202e"


class Depot:
    """A peer, a recorder that is called depot, and where it writes."""

    def __init__(self, peer: Peer, endpoint: str, directory: Path) -> None:
        self.peer = peer
        self.directory = directory
        self.told = Told(peer)
        self._connect = ["--connect", endpoint, "--operator", "operator-1"]

    def ask(self, *words: str) -> tuple[int, str, str]:
        """One of the commands; what becomes of it."""
        return ask(*words, *self._connect)

    def reply(self, *words: str) -> dict[str, object]:
        """The one reply to a command that is obeyed."""
        code, out, err = self.ask(*words, "--json")
        assert (code, err) == (ExitCode.OK, "")
        (line,) = out.splitlines()
        reply: dict[str, object] = json.loads(line)
        return reply


@pytest.fixture
def depot(peer: Peer, endpoint: str, tmp_path: Path) -> Iterator[Depot]:
    """A recorder that has heard something."""
    logs = tmp_path / "logs"
    with recording("-o", str(logs), "--connect", endpoint, "--name", "depot") as process:
        link(peer, logs)
        one = Depot(peer, endpoint, logs)
        peer.put(sample_of(gear(0)))
        wait_until(lambda: [health.robots for health in one.told.healths("depot")][-1:] == [1])
        yield one
        code, _, err = process.end()
        assert code == ExitCode.OK
        assert "Traceback" not in err


def test_status_says_how_a_recorder_is(depot: Depot) -> None:
    """In lines for people; as a line of JSON for programs."""
    code, out, err = depot.ask("status")
    assert (code, err) == (ExitCode.OK, "")
    lines = out.splitlines()
    assert lines[0] == "depot: recording"
    assert lines[1].startswith("  cruiser-1-")
    assert "  1 robots, 2 keys" in out
    assert "dropped: none" in out
    reply = depot.reply("status")
    assert (reply["recorder"], reply["ok"], reply["detail"]) == ("depot", True, "recording")
    assert reply["files"] == [name.removesuffix(".part") for name in logs_in(depot.directory)]
    (one,) = [reply["health"]]
    assert isinstance(one, dict)
    assert (one["recorder"], one["state"], one["robots"]) == ("depot", "recording", 1)


def test_a_mark_keeps_an_incident(depot: Depot) -> None:
    """With who marked it and why; of one robot, or of all."""
    reply = depot.reply("mark", "--robot", "cruiser-1", "-m", "a bump\nand a \x1b[1mrattle")
    (name,) = reply["files"] if isinstance(reply["files"], list) else []
    assert re.fullmatch(r"cruiser-1-\d{8}T\d{6}Z\.incident\.mcap", name)
    assert f"{name}.part" in logs_in(depot.directory)
    assert depot.reply("mark")["files"] == [name], "one that is under way goes on"
    wait_until(lambda: bool(depot.told.events(RecorderEventKind.INCIDENT)))
    (event,) = depot.told.events(RecorderEventKind.INCIDENT)
    assert (event.file, event.robot) == (name, "cruiser-1")

    def is_kept() -> bool:
        found = read_info(depot.directory / f"{name}.part")
        return (
            found.metadata.get(INCIDENT_NAME, {}).get("because")
            == "mark by operator-1: a bump\nand a \x1b[1mrattle"
        )

    wait_until(is_kept)


def test_what_cannot_be_done_is_refused(depot: Depot) -> None:
    """Exit code 5, and why."""
    code, out, err = depot.ask("mark", "--robot", "nobody")
    assert (code, out, err) == (ExitCode.REFUSED, "depot: refused: nothing of nobody has been heard\n", "")
    code, out, _ = depot.ask("mark", "-m", "x" * 1001, "--json")
    assert code == ExitCode.REFUSED
    assert json.loads(out)["ok"] is False
    assert not [name for name in logs_in(depot.directory) if "incident" in name]


def test_recorders_of_one_name_are_asked_one_by_one(
    depot: Depot, endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second has a number; status is of all, and nothing else is done to all."""
    monkeypatch.setenv("CRUISER_RECORDER_NAME", "depot")
    with recording("-o", str(tmp_path / "second"), "--connect", endpoint) as process:
        depot.told.wait_for_health("depot-2")
        link(depot.peer, tmp_path / "second")

        def are_both_found() -> bool:
            _, out, _ = depot.ask("status", "--json")
            return [json.loads(line)["recorder"] for line in out.splitlines()] == ["depot", "depot-2"]

        wait_until(are_both_found)
        several = "cruiser record: there are several recorders: depot, depot-2; name one\n"
        # Asked while only one of them is found, that one makes an incident.
        wait_until(lambda: depot.ask("mark") == (ExitCode.USAGE, "", several))
        before = depot.told.wait_for_health("depot").incidents
        code, out, _ = depot.ask("mark", "depot-2")
        assert code == ExitCode.OK
        assert out.startswith("depot-2: an incident keeps")
        assert depot.told.wait_for_health("depot").incidents == before
        code, _, err = process.end()
    assert code == ExitCode.OK
    assert "a recorder depot is there already; this one is depot-2" in process.ready + err


@pytest.mark.parametrize("action", ["status", "mark"])
def test_without_a_recorder_it_says_so(peer: Peer, endpoint: str, action: str) -> None:
    """Exit code 4, one clear line; whom it looked for."""
    assert peer
    words = ["--connect", endpoint, "--timeout", "0.5"]
    assert ask(action, *words) == (ExitCode.UNREACHABLE, "", "cruiser record: no recorder answers\n")
    expected = "cruiser record: recorder depot does not answer\n"
    assert ask("status", "depot", *words) == (ExitCode.UNREACHABLE, "", expected)


def test_without_a_zenoh_node_it_says_so(endpoint: str) -> None:
    """It is not for want of a recorder, whatever was asked for."""
    expected = f"cruiser record: no Zenoh node answered at {endpoint}\n"
    for words in (["status"], ["status", "depot"]):
        answer = ask(*words, "--connect", endpoint, "--timeout", "0.1")
        assert answer == (ExitCode.UNREACHABLE, "", expected)


def test_a_recorder_that_says_no_more_is_told(peer: Peer, endpoint: str) -> None:
    """It was there a moment ago."""
    with answering(peer, "depot", a_reply(), silent="mark"):
        answer = ask("mark", "--connect", endpoint, "--timeout", "1")
    assert answer == (ExitCode.UNREACHABLE, "", "cruiser record: recorder depot does not answer\n")


def test_words_before_an_action_hold(endpoint: str) -> None:
    """As if they stood behind it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--log-level", default="warning")
    record.add_arguments(parser)
    before = ["--log-level", "debug", "--connect", endpoint, "--json", "--root", "r"]
    arguments = vars(parser.parse_args([*before, "status", "depot"]))
    assert (arguments["action"], arguments["recorder"]) == ("status", "depot")
    assert (arguments["log_level"], arguments["json"]) == ("debug", True)
    assert (arguments["zenoh.connect"], arguments["robot.root"]) == ([endpoint], "r")


@pytest.mark.parametrize("words", [["--json"], []])
def test_what_a_recorder_says_rules_no_terminal(peer: Peer, endpoint: str, words: list[str]) -> None:
    """Anybody on the network may answer like one."""
    payload = a_reply(HOSTILE, files=[HOSTILE])
    with answering(peer, "depot", payload):
        code, out, err = ask("status", "--connect", endpoint, *words)
    assert (code, err) == (ExitCode.OK, "")
    assert out.isascii()
    assert all(line.isprintable() for line in out.splitlines())
    if words:
        assert json.loads(out)["detail"] == HOSTILE
    else:
        assert out.splitlines()[0].startswith(r"depot: \x1b[2J")
        assert "\nhost: recording" not in out


def test_two_that_share_a_name_are_both_shown(peer: Peer, endpoint: str) -> None:
    """They may have begun before they could know of each other."""
    with answering(peer, "depot", a_reply("here"), a_reply("and here")):
        code, out, err = ask("mark", "--connect", endpoint, "--timeout", "2")
    assert (code, out, err) == (ExitCode.OK, "depot: here\ndepot: and here\n", "")
