"""``cruiser record`` as a process of its own, against a small Zenoh peer, and what it is heard to say."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path

import zenoh
from mcap.reader import make_reader

from recorder.review.info import LogInfo, read_info
from schemas import codec, keys
from schemas.command_line import CommandError
from schemas.messages import Message
from schemas.recording import RecorderEvent, RecorderEventKind, RecorderHealth, RecordGap
from tests.support.fakes.peer import Peer
from tests.support.logs import logs_in
from tests.support.messages import FakeSample
from tests.support.processes.forked import Forked
from tests.support.waiting import wait_until

CRUISER = str(Path(sys.executable).with_name("cruiser"))


def environment() -> dict[str, str]:
    return {
        name: value
        for name, value in os.environ.items()
        if name in {"PATH", "HOME", "PYTHONPATH"} or name.startswith("CRUISER_")
    }


class Process:
    def __init__(self, process: Forked | subprocess.Popen[str]) -> None:
        self._process = process
        self.ready = self.read_line()

    def read_line(self) -> str:
        assert self._process.stderr is not None
        return self._process.stderr.readline()

    def end(self, number: int | None = signal.SIGTERM) -> tuple[int, str, str]:
        """Send a signal and wait. Returns exit code, stdout and the rest of stderr."""
        if number is not None:
            self._process.send_signal(number)
        out, err = self._process.communicate(timeout=30)
        return self._process.wait(), out, err

    def signal(self, number: int) -> None:
        self._process.send_signal(number)

    def kill(self) -> None:
        self.end(signal.SIGKILL)

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None


@contextmanager
def recording(*words: str, ulimit: str = "") -> Iterator[Process]:
    """A recorder that ends with the test; ``ulimit`` limits its resources by a shell."""
    if ulimit:
        process = Process(
            subprocess.Popen(
                ["/bin/sh", "-c", f'ulimit {ulimit}; exec "$0" record "$@"', CRUISER, *words],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env=environment(),
            )
        )
    else:
        process = Process(Forked(["record", *words], environment()))
    try:
        yield process
    finally:
        if process.is_running:
            process.kill()


def at(directory: Path, endpoint: str) -> list[str]:
    return ["-o", str(directory), "--connect", endpoint, "--name", "bench"]


def ask(*words: str) -> tuple[int, str, str]:
    """Run ``cruiser record`` with an action. Returns exit code, stdout and stderr."""
    command = Forked(["record", *words], environment())
    out, err = command.communicate(60)
    return command.wait(), out, err


def link(peer: Peer, directory: Path) -> None:
    def condition() -> bool:
        peer.put(FakeSample("fleet/cruiser-1/link", "zenoh/bytes", b""))
        return directory.exists() and bool(logs_in(directory))

    wait_until(condition)


def counts(found: LogInfo) -> dict[str, int]:
    return {channel.topic: channel.messages for channel in found.channels}


def heard(peer: Peer, directory: Path, name: str) -> bool:
    """Publish once; true once the log has it."""
    peer.put(FakeSample(f"fleet/cruiser-1/{name}", "zenoh/bytes", b""))
    time.sleep(0.05)
    return any(counts(one).get(f"fleet/cruiser-1/{name}") for one in readable(directory))


def readable(directory: Path) -> Iterator[LogInfo]:
    """The logs of a directory, some of which may be opened or renamed this moment."""
    with suppress(FileNotFoundError):
        for path in directory.iterdir():
            with suppress(CommandError):
                yield read_info(path)


def whole(directory: Path) -> list[Path]:
    return sorted(directory.glob("*.mcap"))


def sequences(path: Path, topic: str) -> list[int]:
    reader = make_reader(BytesIO(path.read_bytes()), validate_crcs=True)
    return [message.sequence for _, _, message in reader.iter_messages(topics=[topic])]


class Told:
    """What recorders publish about themselves."""

    def __init__(self, peer: Peer) -> None:
        self._subscriber = peer.session.declare_subscriber(
            "fleet/@recorder/*/*", zenoh.handlers.RingChannel(10_000)
        )
        self._messages: list[tuple[str, Message]] = []

    def _take(self) -> list[tuple[str, Message]]:
        while (sample := self._subscriber.try_recv()) is not None:
            parts = keys.parse(str(sample.key_expr))
            assert parts is not None, sample.key_expr
            message = codec.decode(parts.subject, sample.payload.to_bytes())
            assert isinstance(message, Message)
            assert str(sample.encoding) == parts.subject.encoding
            self._messages.append((parts.recorder, message))
        return self._messages

    def healths(self, recorder: str = "bench") -> list[RecorderHealth]:
        return [one for name, one in self._take() if name == recorder and isinstance(one, RecorderHealth)]

    def events(self, kind: RecorderEventKind) -> list[RecorderEvent]:
        return [one for _, one in self._take() if isinstance(one, RecorderEvent) and one.kind is kind]

    def gaps(self) -> list[RecordGap]:
        return [one for _, one in self._take() if isinstance(one, RecordGap)]

    def wait_for_health(self) -> RecorderHealth:
        """The next health that arrives."""
        count = len(self.healths())
        wait_until(lambda: len(self.healths()) > count)
        return self.healths()[-1]
