"""``cruiser metrics`` over real Zenoh and HTTP, in open mode and with certificates."""

from __future__ import annotations

import http.client
import socket
import time
import urllib.error
import urllib.request
from contextlib import ExitStack
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from gateway.cli.metrics_server import MetricsServer
from gateway.metrics import FleetMetrics
from gateway.provisioning.key_files import expires_s, read_certificates
from schemas.command_line import CommandError
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import HEALTH
from tests.support.metrics import fleet, received
from tests.support.processes.gateway import Running, chassis
from tests.support.provisioning import ProvisionedFleet
from tests.support.waiting import wait_until

UP = ("cruiser_up", "robot", "cruiser-1")


def scrape(address: str) -> dict[tuple[str, str, str], float]:
    with urllib.request.urlopen(address, timeout=10) as answer:  # noqa: S310 - it begins with http
        text = answer.read().decode()
    return {
        (sample.name, *next(iter(sample.labels.items()), ("", ""))): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_a_robot_in_signed_mode_says_when_its_keys_end(tmp_path: Path) -> None:
    made = ProvisionedFleet(tmp_path, free_endpoint().replace("tcp/", "tls/"))
    router, robot, viewer = (
        made.let_in(*who) for who in (("router", "127.0.0.1"), ("robot", "cruiser-1"), ("viewer", "metrics"))
    )
    with Running("router", "--directory", str(router)) as routing, chassis() as (_, address):
        routing.wait_says("listens on")
        bus = ["--interface", "socketcand", "--channel", address]
        with (
            Running("gateway", "--config", str(robot / "robot.toml"), *bus) as gateway,
            Running("metrics", "--config", str(viewer / "viewer.toml"), "--listen", "127.0.0.1:0") as metrics,
        ):
            gateway.wait_says("^gateway: ")
            where = metrics.wait_says(r"(http://[^,]+)")[1]
            wait_until(lambda: scrape(where).get(UP) == 1)
            found = scrape(where)
    ends = {
        "cruiser_gateway_certificate_ends_timestamp_seconds": certificate_end(robot / "robot-tls.pem"),
        "cruiser_gateway_grant_ends_timestamp_seconds": made.grant("cruiser-1", "robot").not_after,
    }
    assert {name: found.get((name, *UP[1:])) for name in ends} == ends
    assert found["cruiser_exporter_certificate_ends_timestamp_seconds", "", ""] == certificate_end(
        viewer / "viewer-tls.pem"
    )


def certificate_end(file: Path) -> int:
    return expires_s(read_certificates(file.read_text())[0])


def test_that_others_can_ask_is_said(caplog: pytest.LogCaptureFixture) -> None:
    with MetricsServer(fleet(), "127.0.0.1", 0):
        assert not caplog.records
    with pytest.raises(CommandError, match=r"cannot listen on 192\.0\.2\.1:9747"):
        MetricsServer(fleet(), "192.0.2.1", 9747)
    assert "any client that reaches 192.0.2.1:9747 can read the robots' health" in caplog.text


def test_a_page_whose_name_points_here_is_answered_nothing() -> None:
    """DNS rebinding: the browser sends the page's name in the Host header."""
    own, others = ("localhost", "127.0.0.1:9747", "[::1]:9747"), ("robots.example", "robots.example:9747", "")
    with MetricsServer(fleet(), "127.0.0.1", 0) as server:
        for name in (*own, *others):
            asked = http.client.HTTPConnection(server.where.split("/")[2], timeout=10)
            asked.request("GET", "/metrics", headers={"Host": name})
            answer = asked.getresponse()
            expected = (200, True) if name in own else (421, False)
            assert (answer.status, b"cruiser_" in answer.read()) == expected
            asked.close()


def test_who_asks_for_nothing_whole_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.cli.metrics_server.REQUEST_S", 1.0)
    with MetricsServer(fleet(), "127.0.0.1", 0) as server, ExitStack() as stack:
        port = int(server.where.split(":")[2].partition("/")[0])
        slow = [stack.enter_context(socket.create_connection(("127.0.0.1", port), 10)) for _ in range(200)]
        wait_until(lambda: reads(server.where))
        slow[-1].settimeout(0.1)

        def is_cut() -> bool:
            try:
                slow[-1].send(b"G")
                return slow[-1].recv(1) == b""
            except TimeoutError:
                return False
            except ConnectionError:
                return True

        wait_until(is_cut)


def reads(address: str) -> bool:
    try:
        return scrape(address)["cruiser_exporter_connected", "", ""] == 1
    except OSError:
        return False


def test_what_waited_while_it_was_held_up_is_not_new(monkeypatch: pytest.MonkeyPatch) -> None:
    metrics = FleetMetrics("fleet", "1")
    clock = [10**12]
    monkeypatch.setattr(time, "monotonic_ns", lambda: clock[0])

    class Waiting:
        """A listener with a health on its second look."""

        looks = 0

        def drain(self) -> list[object]:
            self.looks += 1
            return [received(HEALTH)] if self.looks == 2 else []

        def connected(self) -> bool:
            return True

    waiting = Waiting()

    def ends() -> bool:
        if waiting.looks == 1:
            clock[0] += 60 * 10**9
        return waiting.looks == 2

    with MetricsServer(metrics, "127.0.0.1", 0) as server:
        server.follow(waiting, ends)  # type: ignore[arg-type]
        assert scrape(server.where)[UP] == 0
