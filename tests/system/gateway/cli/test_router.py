"""``cruiser router``: it runs from its provisioned file, and names in one line what is wrong with it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gateway.authority.enrolment import TransportRole
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import run
from tests.support.secured import Network
from tests.support.waiting import nothing


@pytest.fixture
def router(tmp_path: Path) -> Path:
    return Network(tmp_path, free_endpoint().replace("tcp", "tls")).node(TransportRole.ROUTER, "127.0.0.1")


def said(*words: str | Path, command: str = "router") -> tuple[int, str]:
    done = run([command, *map(str, words)])
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout + done.stderr


def test_it_listens_where_its_file_says(router: Path) -> None:
    endpoint = json.loads((router / "router.json5").read_text())["listen"]["endpoints"][0]
    assert said("--directory", router, "--seconds", "0.1") == (0, f"router: listens on {endpoint}\n")
    other = free_endpoint().replace("tcp", "tls")
    words = ("--zenoh-config", router / "router.json5", "--listen", other, "--seconds", "0.1")
    assert said(*words) == (0, f"router: listens on {other}\n")


def test_what_is_wrong_is_one_line(router: Path, tmp_path: Path) -> None:
    (tmp_path / "damaged.json5").write_text("{mode:")
    operator = Network(router, "tls/127.0.0.1:1").node(TransportRole.OPERATOR, "ann")
    for words, code, says in (
        (("--directory", tmp_path), 2, "'cruiser provision router' makes it"),
        (("--zenoh-config", tmp_path / "damaged.json5"), 2, "damaged.json5"),
        (("--zenoh-config", operator / "operator.json5"), 2, "is not a router's"),
        (("--directory", router, "--listen", "nowhere"), 2, "Zenoh does not take listen/endpoints"),
        (("--directory", router, "--listen", "tls/192.0.2.1:7447"), 4, "192.0.2.1"),
    ):
        found, text = said(*words)
        assert (found, text.count("\n")) == (code, 1), text
        assert says in text


@pytest.mark.parametrize(
    ("robot", "says"),
    [
        ("cruiser-1", "cruiser-1: NOT STOPPED: NOTHING WAS SENT. Use the button on the robot"),
        ("--all", "all robots: NOT STOPPED: NOTHING WAS SENT. Use the buttons on the robots"),
    ],
)
def test_a_stop_that_cannot_be_sent_says_so_first(tmp_path: Path, robot: str, says: str) -> None:
    network = Network(tmp_path, free_endpoint().replace("tcp", "tls"))
    place = network.node(TransportRole.OPERATOR, "ann")
    (tmp_path / "other").mkdir()
    foreign = Network(tmp_path / "other", network.endpoint).node(TransportRole.OPERATOR, "ann")

    def exchange() -> None:
        for name in ("operator-tls.key", "operator-tls.pem"):
            (place / name).write_bytes((foreign / name).read_bytes())

    for change, code, cause in (
        (nothing, 4, f"no connection to {network.endpoint}: "),
        (exchange, 2, "is of another network than"),
        ((place / "operator-tls.key").unlink, 2, "operator-tls.key is not there"),
    ):
        change()
        found, text = said(robot, "--zenoh-config", place / "operator.json5", command="stop")
        first, second = text.splitlines()
        assert (found, first) == (code, says)
        assert cause in second


def test_a_stop_of_all_in_open_mode_that_has_no_link_says_the_same() -> None:
    code, text = said("--all", "--connect", "tcp/127.0.0.1:1", "--timeout", "0.5", command="stop")
    lines = text.splitlines()
    assert (code, len(lines)) == (4, 2), text
    assert lines[0].startswith("all robots: NOT STOPPED: NOTHING WAS SENT: no link. Use the buttons on")
