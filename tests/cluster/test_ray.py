"""Export and rerun on a Ray cluster of two nodes on this machine's loopback (``make test-cluster``)."""

import json
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from recorder.record.robot_log import LogPlan
from recorder.review.export import read_manifest
from schemas.command_line import ExitCode
from schemas.messages import Variant
from tests.support.logs import Log
from tests.support.messages import SECOND, WALL_NS, gear, info, sample_of
from tests.support.rigs.gateway import Operator
from tests.support.rigs.recorded import RecordedRig
from tests.support.waiting import wait_until

RAY = Path(os.environ["RAY_BIN"]).absolute()
# For 127.0.0.1 Ray takes the machine's network address; the last node dies in a test.
HEAD, NODE, MORTAL = "127.0.0.2", "127.0.0.3", "127.0.0.4"
LOGS = int(os.environ.get("RAY_LOGS", "10000"))
ROBOTS = 20
WITHIN_S = 400  # a busy machine takes minutes to start the nodes and their server for clients
NAME = "cruiser-1-20260102T030405Z.mcap"

pytestmark = pytest.mark.timeout(3 * WITHIN_S)


def environment(home: Path) -> dict[str, str]:
    return {**os.environ, "RAY_USAGE_STATS_ENABLED": "0", "HOME": str(home), "PATH": f"{RAY}:{os.environ['PATH']}"}


@contextmanager
def node(home: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    common = ["--block", "--num-cpus", "1", "--object-store-memory", "100000000", "--disable-usage-stats"]
    with (home / f"{len(list(home.iterdir()))}.log").open("wb") as output:
        process = subprocess.Popen(
            [RAY / "ray", "start", *common, *words],
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment(home),
            cwd=home,
        )
        try:
            yield process
        finally:
            process.terminate()
            process.wait(60)


def free_port() -> str:
    with socket.create_server((HEAD, 0)) as server:
        return str(server.getsockname()[1])


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of two nodes with a processor each."""
    # Its name is in those of sockets, which are short.
    home = tmp_path_factory.mktemp("r")
    port, clients = free_port(), free_port()
    address = f"ray://{HEAD}:{clients}"
    head = ["--head", "--node-ip-address", HEAD, "--port", port, "--ray-client-server-port", clients]
    with ExitStack() as stack:
        stack.enter_context(node(home, *head, "--include-dashboard=false", "--temp-dir", str(home / "t")))
        wait_until(lambda: answers(HEAD, int(port)), deadline_s=WITHIN_S)
        stack.enter_context(node(home, "--address", f"{HEAD}:{port}", "--node-ip-address", NODE))
        wait_until(lambda: answers(HEAD, int(clients)), deadline_s=WITHIN_S)
        done = python("import sys\n" + BOTH_NODES, address)
        assert done.stdout.split() == [HEAD, NODE], done.stderr
        yield address


def answers(host: str, port: int) -> bool:
    with socket.socket() as client:
        return client.connect_ex((host, port)) == 0


BOTH_NODES = """
import time
import ray
end_s = time.monotonic() + 350
while True:
    try:
        ray.init(sys.argv[1], log_to_driver=False)
        break
    except ConnectionError:
        # Its server for clients listens before it can serve.
        if time.monotonic() > end_s:
            raise
        time.sleep(1)
while time.monotonic() < end_s and ray.cluster_resources().get("CPU") != 2:
    time.sleep(0.2)

@ray.remote(scheduling_strategy="SPREAD")
def where():
    time.sleep(0.2)
    return ray.util.get_node_ip_address()

print(*sorted(set(ray.get([where.remote() for _ in range(20)]))))
"""


def python(script: str, *words: object, timeout_s: float = WITHIN_S) -> subprocess.CompletedProcess[str]:
    command = [str(RAY / "python"), "-c", script, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout_s)


def review(
    *words: object, cwd: Path | None = None, timeout_s: float = WITHIN_S
) -> subprocess.CompletedProcess[str]:
    command = [str(RAY / "cruiser"), "review", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout_s, cwd=cwd)


def write_logs(directory: Path, count: int) -> None:
    directory.mkdir()
    for number in range(count):
        robot, at_ns = f"cruiser-{number % ROBOTS}", WALL_NS + number // ROBOTS * 900 * SECOND
        log = Log(LogPlan(name=robot, chunk_bytes=262_144, flush_ns=SECOND // 2, version="0.1.0"))
        for sample in (sample_of(gear(number, at_ns), robot), sample_of(info(), robot)):
            log.receive(sample, wall_ns=at_ns)
        (directory / f"{number:05}.mcap").write_bytes(log.close())


def contents(dataset: Path) -> tuple[Any, dict[str, bytes]]:
    manifest = read_manifest(dataset)
    assert manifest is not None
    return manifest, {part.path: (dataset / part.path).read_bytes() for part in manifest.files}


@pytest.mark.timeout(3600)
def test_ten_thousand_small_logs_become_the_dataset_that_one_process_makes(cluster: str, tmp_path: Path) -> None:
    """File by file, and byte by byte; also of a robot that died in the middle of its log."""
    write_logs(tmp_path / "logs", LOGS)
    cut = tmp_path / "logs" / "00007.mcap"
    cut.write_bytes(cut.read_bytes()[:-200])
    said = []
    for out, words in (("here", []), ("there", ["--ray", cluster])):
        done = review("export", *words, "-o", tmp_path / out, tmp_path / "logs", timeout_s=1700)
        assert done.returncode == ExitCode.PARTIAL, done.stderr
        said.append(done.stderr)
    assert said[0] == said[1]
    assert cut.name in said[0]
    here, there = contents(tmp_path / "here"), contents(tmp_path / "there")
    assert len(here[0].inputs) == LOGS
    assert here == there


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a robot that is driven for twelve seconds, with two changes of speed."""
    rig = RecordedRig(Variant.COARSE)
    rig.run(0.6)
    operator = Operator(rig)
    operator.engage()
    for speed_mps in (0.5, 1.0, 0.5):
        operator.drive(speed_mps, 2.0, 4.0)
    path = tmp_path_factory.mktemp("logs") / NAME
    path.write_bytes(rig.log())
    return path


@pytest.mark.parametrize("words", [["rerun"], ["rerun", "--set", "command.speed_limit_mps=0.8"]])
def test_the_answer_is_the_one_that_one_process_gives(cluster: str, drive: Path, words: list[str]) -> None:
    """Also where the logs are named as this process sees them."""
    here = review(*words, "--json", "--processes", "1", NAME, cwd=drive.parent)
    there = review(*words, "--json", "--ray", cluster, NAME, cwd=drive.parent)
    assert json.loads(here.stdout.splitlines()[-1])
    assert (here.returncode, here.stdout, here.stderr) == (there.returncode, there.stdout, there.stderr)


FAILING = """
import os, sys, time
from pathlib import Path
from recorder.reading.logs import Faults, find_logs
from recorder.review import export
from recorder.review.tasks import TaskRunner

address, logs, out, notes, mortal = *sys.argv[1:2], *map(Path, sys.argv[2:5]), sys.argv[5]
export_log = export.export_log

def task(one, progress):
    import ray
    name = one.log.path.name
    note = notes / name
    tries = len(note.read_text()) if note.exists() else 0
    if mortal == ray.util.get_node_ip_address():
        (notes / "pid").write_text(str(os.getppid()))  # the node's
        time.sleep(100)
    note.write_text("x" * (tries + 1))
    if name == "00002.mcap" and not tries:
        raise OSError(5, "the disk is away for a moment")
    return export_log(one, progress)

export.export_log = task
faults = Faults()
export.export_dataset(find_logs([logs], faults), out, export.ExportRange(), faults, run=TaskRunner(ray=address))
print(*((notes / f"{number:05}.mcap").read_text() for number in range(10)))
"""


def ten(directory: Path) -> None:
    """Ten small logs, their dataset, and a directory in which tasks count their starts."""
    write_logs(directory / "logs", 10)
    (directory / "notes").mkdir()
    done = review("export", "-o", directory / "here", directory / "logs")
    assert done.returncode == 0, done.stderr


@pytest.fixture
def mortal_node(cluster: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    done = python("import sys, ray\nray.init(sys.argv[1])\nprint(ray.get_runtime_context().gcs_address)", cluster)
    home = tmp_path_factory.mktemp("m")
    with node(home, "--address", done.stdout.split()[-1], "--node-ip-address", MORTAL):
        yield


@pytest.mark.usefixtures("mortal_node")
def test_a_node_that_dies_in_the_middle_costs_its_tasks_a_second_try(cluster: str, tmp_path: Path) -> None:
    """The others do them, and the dataset is the same."""
    ten(tmp_path)
    words = (cluster, tmp_path / "logs", tmp_path / "there", tmp_path / "notes", MORTAL)
    pid = tmp_path / "notes" / "pid"
    command = [str(RAY / "python"), "-c", FAILING, *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        wait_until(lambda: pid.exists() and bool(pid.read_text()), deadline_s=WITHIN_S)
        os.kill(int(pid.read_text()), signal.SIGKILL)
        out, _ = process.communicate(timeout=WITHIN_S)
    assert out.split() == ["x", "x", "xx", *["x"] * 7]
    assert contents(tmp_path / "here") == contents(tmp_path / "there")
