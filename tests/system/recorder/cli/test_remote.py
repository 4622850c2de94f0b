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
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.fakes.recorders import a_reply, answering
from tests.support.logs import logs_in
from tests.support.messages import gear, sample_of
from tests.support.processes.recorder import Told, ask, link, recording
from tests.support.waiting import wait_until

HOSTILE = "\x1b[2J\x9b31m\x07\nhost: recording\r\u202e"


class Depot:
    def __init__(self, peer: Peer, endpoint: str, directory: Path) -> None:
        self.peer = peer
        self.directory = directory
        self.told = Told(peer)
        self._connect = ["--connect", endpoint, "--operator", "operator-1"]

    def ask(self, *words: str) -> tuple[int, str, str]:
        return ask(*words, *self._connect)

    def reply(self, *words: str) -> dict[str, object]:
        code, out, err = self.ask(*words, "--json")
        assert (code, err) == (ExitCode.OK, "")
        (line,) = out.splitlines()
        reply: dict[str, object] = json.loads(line)
        return reply


@pytest.fixture
def depot(peer: Peer, endpoint: str, tmp_path: Path) -> Iterator[Depot]:
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

    reply = depot.reply("status")
    assert (reply["recorder"], reply["ok"], reply["detail"]) == ("depot", True, "recording")
    assert reply["files"] == [name.removesuffix(".part") for name in logs_in(depot.directory)]
    (one,) = [reply["health"]]
    assert isinstance(one, dict)
    assert (one["recorder"], one["state"], one["robots"]) == ("depot", "recording", 1)


def test_a_mark_keeps_an_incident(depot: Depot) -> None:
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


def test_without_a_recorder_it_says_so(peer: Peer, endpoint: str) -> None:
    def answer(*words: str, to: str = endpoint, timeout_s: float = 0.5) -> tuple[int, str, str]:
        return ask(*words, "--connect", to, "--timeout", str(timeout_s))

    def line(text: str) -> tuple[int, str, str]:
        return ExitCode.UNREACHABLE, "", f"cruiser record: {text}\n"

    nowhere = free_endpoint()
    assert answer("status", to=nowhere) == line(f"no Zenoh node answered at {nowhere}")
    for action in ("status", "mark"):
        assert answer(action) == line("no recorder answers")
    assert answer("status", "depot") == line("recorder depot does not answer")
    with answering(peer, "depot", a_reply(), silent="mark"):
        assert answer("mark", timeout_s=1) == line("recorder depot does not answer")


def test_words_before_an_action_hold(endpoint: str) -> None:
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


def test_two_that_share_a_name_are_both_shown_and_of_several_one_is_named(peer: Peer, endpoint: str) -> None:
    words = ("mark", "--connect", endpoint, "--timeout", "2")
    with answering(peer, "depot", a_reply("here"), a_reply("and here")):
        assert ask(*words) == (ExitCode.OK, "depot: here\ndepot: and here\n", "")
        with answering(peer, "other", a_reply("elsewhere")) as other:
            several = "cruiser record: there are several recorders: depot, other; name one\n"
            # Asked while only one of them is found, that one makes an incident.
            wait_until(lambda: ask(*words) == (ExitCode.USAGE, "", several))
            other.clear()
            assert ask("mark", "other", *words[1:]) == (ExitCode.OK, "other: elsewhere\n", "")
            assert "fleet/@recorder/other/@cmd/" in other[-1]
