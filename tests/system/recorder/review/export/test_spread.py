"""The export by Daft: the same dataset, and nobody is told."""

import subprocess
import sys
from pathlib import Path

from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.review.export.dataset import export_dataset
from recorder.review.export.manifest import read_manifest
from recorder.review.export.one_log import ExportRange
from tests.support.drives import drive_log
from tests.support.logs import saved

BY_DAFT = """
import socket, sys
from pathlib import Path
connected = []
def refuse(self, address):
    connected.append(address)
    raise OSError("no network")
socket.socket.connect = refuse
from recorder.review.export.dataset import export_dataset
from recorder.review.export.one_log import ExportRange
from recorder.review.export.spread import daft_runner
from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
if __name__ == "__main__":
    faults = Faults()
    read = []
    logs = find_logs([Path(sys.argv[1])], faults)
    export_dataset(logs, Path(sys.argv[2]), ExportRange(), faults, run=daft_runner(), progress=read.append)
    assert sum(read) == sum(log.bytes for log in logs), read
    from daft import scarf_telemetry
    assert scarf_telemetry._track_on_scarf("daft-import")[0] is None
    assert not [one for one in connected if not isinstance(one, str) and one[0] != "127.0.0.1"], connected
    print(len(faults.told))
"""


def test_daft_makes_the_same_dataset(tmp_path: Path) -> None:
    """File by file, of logs that overlap and one that is damaged; no telemetry is sent."""
    logs = tmp_path / "logs"
    logs.mkdir()
    saved(logs / "1.mcap", drive_log())
    saved(logs / "2.mcap", drive_log(first=10))
    saved(logs / "3.mcap", drive_log("cruiser-3")[:-100])
    faults = Faults()
    export_dataset(find_logs([logs], faults), tmp_path / "here", ExportRange(), faults)
    out = subprocess.run(
        [sys.executable, "-W", "error", "-c", BY_DAFT, str(logs), str(tmp_path / "daft")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert out.returncode == 0, out.stderr
    assert out.stdout == f"{len(faults.told)}\n"
    here, daft = read_manifest(tmp_path / "here"), read_manifest(tmp_path / "daft")
    assert here is not None
    assert here == daft
    for part in here.files:
        assert (tmp_path / "here" / part.path).read_bytes() == (tmp_path / "daft" / part.path).read_bytes()
