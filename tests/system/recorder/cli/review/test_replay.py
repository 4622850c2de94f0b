"""``cruiser review replay``: logs to Zenoh, and its subscribers."""

import json
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

from recorder.cli import review
from schemas import codec, keys
from schemas.command_line import CommandError, ExitCode
from schemas.messages import CanFrames, Gear, Message
from schemas.settings import RobotSettings, Settings, ZenohSettings
from schemas.subjects import BY_TYPE
from schemas.zenoh_session import join
from tests.support.commands import run_command
from tests.support.drives import drive_samples, write_samples
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.logs import saved
from tests.support.messages import MS
from tests.support.processes.recorder import CRUISER, counts, environment, readable, recording, whole
from tests.support.reading import rows_of
from tests.support.waiting import wait_until

Link = tuple[Peer, str]


def run(*words: str, endpoint: str = "", stopped: Callable[[], bool] = lambda: False) -> int:
    settings = Settings(zenoh=ZenohSettings(connect=[endpoint or free_endpoint()]))
    return run_command(review, "replay", *words, settings=settings, stopped=stopped)


@pytest.fixture
def log(tmp_path: Path) -> str:
    return str(write_samples(tmp_path / "drive.mcap", drive_samples()))


@pytest.fixture
def peer() -> Iterator[tuple[Peer, str]]:
    endpoint = free_endpoint()
    with Peer(endpoint) as one:
        yield one, endpoint


class Heard:
    def __init__(self, peer: Peer, expression: str = "**") -> None:
        self._subscriber = peer.session.declare_subscriber(expression, zenoh.handlers.FifoChannel(100_000))
        self._samples: list[zenoh.Sample] = []

    def samples(self) -> list[zenoh.Sample]:
        while (sample := self._subscriber.try_recv()) is not None:
            self._samples.append(sample)
        return self._samples

    def wait(self, count: int) -> list[zenoh.Sample]:
        wait_until(lambda: len(self.samples()) >= count)
        return self._samples


def test_a_log_is_published_under_another_root(peer: Link, log: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Each message in order, with its payload."""
    one, endpoint = peer
    heard = Heard(one)
    assert run(log, "--speed", "max", "--json", endpoint=endpoint) == ExitCode.OK
    samples = drive_samples()
    found: dict[str, list[bytes]] = {}
    # Between keys of different priority there is no order.
    for sample in heard.wait(len(samples)):
        found.setdefault(str(sample.key_expr), []).append(sample.payload.to_bytes())
    assert sorted(str(one.encoding) for one in heard.samples()) == sorted(one.encoding for one in samples)
    assert found.keys() == {"replay" + one.key.removeprefix("fleet") for one in samples}
    for key, payloads in found.items():
        if key != "replay/cruiser-1/can/can0/rx":
            assert payloads == [
                one.payload for one in samples if one.key.partition("/")[2] == key.partition("/")[2]
            ]
    told = json.loads(capsys.readouterr().out)
    assert (told["sent"], told["failed"], told["ended"], told["to"]) == (len(samples), 0, "end", "replay/**")


def test_what_is_recorded_of_a_replay_is_what_was_replayed(tmp_path: Path, log: str) -> None:
    endpoint = free_endpoint()
    again = tmp_path / "again"
    words = ["-k", "replay/**", "--root", "replay", "-o", str(again), "--connect", endpoint]
    with Peer(endpoint), recording(*words) as recorder:
        # A link of their own: who has one node in common finds the other by it.
        assert run(log, "--speed", "4", "--timeout", "20", endpoint=endpoint) == ExitCode.OK
        wanted = len(rows_of(Path(log)))

        def are_there() -> bool:
            found = [counts(one) for one in readable(again)] if again.exists() else []
            return (
                sum(count for one in found for topic, count in one.items() if "@recorder" not in topic) >= wanted
            )

        wait_until(are_there)
        code, _, err = recorder.end()
    assert code == ExitCode.OK, err

    def messages(*of: Path) -> dict[str, list[tuple[int, int, object]]]:
        found: dict[str, list[tuple[int, int, object]]] = {}
        for row in rows_of(*of):
            if row.topic.decode is not None and "/@recorder/" not in row.topic.name:
                message = row.topic.decode(row.data)
                rest = row.topic.name.partition("/")[2]
                if rest == "elsewhere":
                    # Its key and its time are those of this journey.
                    message, publish_ns = (message.payload, message.encoding, message.attachment), 0
                else:
                    publish_ns = row.publish_ns
                found.setdefault(rest, []).append((row.sequence if publish_ns else 0, publish_ns, message))
        return found

    assert messages(*whole(again)) == messages(Path(log))


def test_the_messages_of_a_moment_can_be_played_again_and_again(
    peer: tuple[Peer, str], log: str, capsys: pytest.CaptureFixture[str]
) -> None:
    one, endpoint = peer
    heard = Heard(one)
    words = ["--from", "0.1", "--to", "0.2", "--key", "fleet/*/chassis/**", "--loop", "3", "--speed", "max"]
    assert run(log, *words, endpoint=endpoint) == ExitCode.OK
    numbers = [
        message.sequence
        for sample in heard.wait(15)
        if isinstance(message := codec.decode(BY_TYPE[Gear], sample.payload.to_bytes()), Gear)
    ]
    assert len(numbers) == 15
    assert numbers == numbers[:5] * 3
    assert "3 times" in capsys.readouterr().out


def test_time_stamps_can_be_those_of_the_present(peer: tuple[Peer, str], log: str) -> None:
    one, endpoint = peer
    heard = Heard(one)
    begun_ns = time.time_ns()
    assert run(log, "--now", "--speed", "2", endpoint=endpoint) == ExitCode.OK
    found = heard.wait(len(drive_samples()))
    ended_ns = time.time_ns()
    for sample in found:
        parts = keys.parse(str(sample.key_expr))
        if parts is None:
            continue
        message = codec.decode(parts.subject, sample.payload.to_bytes())
        assert isinstance(message, Message)
        # The log's messages were up to half a second old when they were recorded.
        assert begun_ns - 500 * MS <= message.time_ns <= ended_ns
        if isinstance(message, CanFrames):
            assert message.frame_time_ns[1] - message.frame_time_ns[0] == 2 * MS


@pytest.mark.parametrize(
    ("root", "of_robots"),
    [("fleet", "fleet"), ("fleet/cruiser-1", "fleet"), ("elsewhere/fleet", "fleet"), ("site", "site")],
)
def test_the_logs_own_root_is_refused(tmp_path: Path, root: str, of_robots: str) -> None:
    """Also the root in the settings, with or without a robot there."""
    path = write_samples(tmp_path / "drive.mcap", drive_samples(3, "elsewhere"))
    settings = Settings(robot=RobotSettings(root=of_robots), zenoh=ZenohSettings(connect=[free_endpoint()]))
    with pytest.raises(CommandError) as caught:
        run_command(review, "replay", str(path), "--root", root, "--timeout", "0.1", settings=settings)
    assert caught.value.code is ExitCode.REFUSED


def test_the_logs_own_root_can_be_forced_unless_a_gateway_is_there(
    peer: tuple[Peer, str], log: str, capsys: pytest.CaptureFixture[str]
) -> None:
    one, endpoint = peer
    heard = Heard(one, "fleet/**")
    words = [log, "--root", "fleet", "--force", "--speed", "max"]
    token = one.session.liveliness().declare_token(keys.liveliness("fleet", "cruiser-5"))
    with pytest.raises(CommandError, match="cruiser-5") as caught:
        run(*words, endpoint=endpoint)
    assert caught.value.code is ExitCode.REFUSED
    assert heard.samples() == []
    # On a busy machine the gateway is seen a moment after the beginning, and still before the first sample.
    assert capsys.readouterr().out in {"", "fleet/**: 0 sent in 0.0 s, 0/s\n"}
    token.undeclare()
    wait_until(lambda: not list(one.session.liveliness().get("**/gateway", timeout=1)))
    assert run(*words, endpoint=endpoint) == ExitCode.OK
    assert str(heard.wait(len(drive_samples()))[1].key_expr) == "fleet/cruiser-1/chassis/gear"


def test_a_gateway_that_turns_up_ends_it(peer: Link, log: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 5."""
    one, endpoint = peer
    heard = Heard(one, "replay/**")
    tokens: list[zenoh.LivelinessToken] = []

    def appear() -> bool:
        if heard.samples() and not tokens:
            tokens.append(one.session.liveliness().declare_token(keys.liveliness("replay", "cruiser-1")))
        return False

    with pytest.raises(CommandError) as caught:
        run(log, "--loop", "forever", endpoint=endpoint, stopped=appear)
    assert caught.value.code is ExitCode.REFUSED
    assert "sent in" in capsys.readouterr().out


def test_nobody_there_is_unreachable(log: str) -> None:
    with pytest.raises(CommandError, match="--listen") as caught:
        run(log, "--timeout", "0.1")
    assert caught.value.code is ExitCode.UNREACHABLE


def test_a_viewer_connects_to_the_replay_itself_and_ctrl_c_ends_it(log: str) -> None:
    endpoint = free_endpoint()
    words = ["review", "replay", log, "--listen", endpoint, "--loop", "forever", "--json"]
    process = subprocess.Popen(
        [CRUISER, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    )
    try:
        assert process.stderr is not None
        assert "waiting for a subscriber" in process.stderr.readline()
        with join(ZenohSettings(connect=[endpoint])) as session:
            subscriber = session.declare_subscriber("replay/**", zenoh.handlers.RingChannel(10))
            wait_until(lambda: subscriber.try_recv() is not None)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=30)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    assert process.returncode == ExitCode.OK, err
    told = json.loads(out)
    assert told["ended"] == "stopped"
    assert told["sent"] > 0


def test_a_connection_alone_does_not_begin_it(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = free_endpoint()
    subscribed: list[zenoh.Subscriber[None]] = []
    looks = 0
    with join(ZenohSettings(connect=[endpoint])) as session:

        def subscribe_late() -> bool:
            nonlocal looks
            looks += bool(session.info.peers_zid())
            if looks > 20 and not subscribed:
                subscribed.append(session.declare_subscriber("replay/**", lambda _: None))
            return False

        settings = Settings(zenoh=ZenohSettings(listen=[endpoint]))
        words = ("replay", log, "--speed", "max", "--timeout", "0.001")
        assert run_command(review, *words, settings=settings, stopped=subscribe_late) == ExitCode.OK
    assert subscribed
    assert "no subscriber" not in capsys.readouterr().err


def test_a_log_that_holds_nothing_to_replay_is_told(tmp_path: Path, peer: tuple[Peer, str], log: str) -> None:
    _, endpoint = peer
    for words in (["--timeout", "0.1"], ["--listen", "tcp/127.0.0.1:0"]):
        with pytest.raises(CommandError, match="nothing to replay") as caught:
            run(log, "--key", "fleet/nobody/**", *words, endpoint=endpoint)
        assert caught.value.code is ExitCode.FAILURE
    with pytest.raises(CommandError, match="No such file"):
        run(str(tmp_path / "none.mcap"), endpoint=endpoint)


def test_of_a_damaged_log_what_can_be_read_is_replayed(tmp_path: Path, peer: tuple[Peer, str], log: str) -> None:
    path = saved(tmp_path / "damaged.mcap", Path(log).read_bytes()[:-300])
    heard = Heard(peer[0])
    assert run(str(path), "--speed", "max", endpoint=peer[1]) == ExitCode.PARTIAL
    assert heard.wait(1)


def test_what_was_recorded_of_a_replay_is_no_robots(tmp_path: Path, peer: tuple[Peer, str]) -> None:
    one, endpoint = peer
    heard = Heard(one)
    path = write_samples(tmp_path / "replayed.mcap", drive_samples(3, "replay"))
    assert run(str(path), "--speed", "max", endpoint=endpoint) == ExitCode.OK
    assert str(heard.wait(len(drive_samples(3)))[1].key_expr).startswith("replay/cruiser-1/")


def test_what_was_sent_to_nobody_is_told(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = free_endpoint()
    with Peer(endpoint) as one:
        heard = Heard(one, "replay/**")
        ends_s: list[float] = []

        def stopped() -> bool:
            if not ends_s and heard.samples():
                one.close()
                ends_s.append(time.monotonic() + 2)
            return bool(ends_s) and time.monotonic() > ends_s[0]

        assert run(log, "--loop", "forever", endpoint=endpoint, stopped=stopped) == ExitCode.PARTIAL
    assert "no Zenoh node was connected" in capsys.readouterr().out
