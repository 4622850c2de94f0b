"""A log at the desk as the packages of Foxglove and Lichtblick read it in a browser (``make readers``)."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Final

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.support.processes.desk import chromium
from tests.support.processes.gateway import Running
from tests.support.rigs.scenarios import acted, front_bumper

BUILT: Final = Path(__file__).parent / "viewer" / "build"

DESK: Final = ("--logs-only", "--listen", "127.0.0.1:0")

LAST_S: Final = 2

# Protobuf types: double, float, int32, fixed32, uint32, sfixed32, sint32.
NUMBERS: Final = frozenset({1, 2, 5, 7, 13, 15, 17})


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def viewer() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=BUILT)) as server:
        threading.Thread(target=server.serve_forever).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "a drive.mcap"
    path.write_bytes(acted(front_bumper).log(ticks=True))
    return path


Read = dict[str, Any]  # the messages from a moment on, and the bytes that were read


@pytest.fixture(scope="module")
def read(log: Path) -> Iterator[Callable[[int], Read]]:
    """Reads the log from a moment on, in the browser."""
    with (
        viewer() as origin,
        Running("desk", *DESK, "--logs", str(log.parent), "--viewer", origin) as serving,
        chromium() as browser,
    ):
        address = serving.wait_says(r"desk: (http://127\.0\.0\.1:\d+/)")[1]
        page = browser.new_page()
        page.goto(origin)
        page.add_script_tag(url=f"{origin}/read.js")

        def reads(start_ns: int) -> Read:
            words = [f"{address}logs/{log.name}", str(start_ns)]
            found: Read = page.evaluate("([url, start]) => readLog(url, start)", words)
            return found

        yield reads


def read_here(log: Path, start_ns: int) -> list[tuple[str, str, str, dict[str, float]]]:
    """The same with the mcap package and its CRCs."""
    with log.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, str(message.log_time), str(message.publish_time), _numbers(content))
            for _, channel, message, content in reader.iter_decoded_messages(starting_at=start_ns)
        ]


def bytes_before(log: Path, start_ns: int) -> int:
    """Length of the chunks that end before a moment."""
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    lengths = [chunk.chunk_length for chunk in summary.chunk_indexes if chunk.message_end_time < start_ns]
    assert lengths
    return sum(lengths)


def _numbers(content: Any) -> dict[str, float]:  # noqa: ANN401 - a class of protobuf's, made at run time
    """Numbers that JavaScript can hold: floating point, and 32 bits; without zeros."""
    return {
        field.name: value
        for field, value in content.ListFields()
        if field.type in NUMBERS and not field.is_repeated and value
    }


def _ordered(messages: list[Any]) -> list[Any]:
    return sorted(messages, key=lambda one: (one[1], one[0], one[2], sorted(one[3].items())))


def test_every_message_of_a_served_log_is_read_as_the_mcap_package_reads_it(
    log: Path, read: Callable[[int], Read]
) -> None:
    messages = [tuple(one) for one in read(0)["messages"]]
    assert len(messages) > 1000
    assert {f"fleet/cruiser-1/chassis/odometry/{chunk}" for chunk in ("tf", "outline")} < {
        one[0] for one in messages
    }
    assert _ordered(messages) == _ordered(read_here(log, 0))


def test_the_end_of_a_log_is_read_without_the_rest(log: Path, read: Callable[[int], Read]) -> None:
    """By ranges, without the chunks before the moment."""
    start_ns = max(int(one[1]) for one in read_here(log, 0)) - LAST_S * 1_000_000_000
    end, whole = read(start_ns), read(0)
    assert len(end["messages"]) == len(read_here(log, start_ns)) < len(whole["messages"]) / 2
    assert end["bytes"] <= whole["bytes"] - bytes_before(log, start_ns)
