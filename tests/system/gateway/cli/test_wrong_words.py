"""Wrong arguments of all commands: one line that names what is wrong, and an exit code."""

import shlex
import socket
from pathlib import Path

import pytest

from schemas.command_line import ExitCode
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import run

FAILURE, USAGE, UNREACHABLE = ExitCode.FAILURE, ExitCode.USAGE, ExitCode.UNREACHABLE
AUTHORITY = "provision authority --directory {here}/new"
ROUTER = "tls/127.0.0.1:47447"
DRIVE, SIGN, DEMO = "drive cruiser-1 --seconds 1", "provision sign some.request", "demo --desk --no-browser"
NO_FILE = "cannot read the configuration file '/nowhere/robot.toml': no such file or directory"
NO_ADDRESS = "is not an address and a port, such as 0.0.0.0:9747"
REFUSED = "no server there: [Errno 111] Connection refused (with --wait-for-bus the gateway starts without it)"
NOBODY = "no Zenoh node answered within 0.5 s at tcp/{free}"

WRONG: list[tuple[str, ExitCode, str]] = [
    ("wach", USAGE, "cruiser: unknown command 'wach'; did you mean 'watch'?"),
    *[(f"{one} --config /nowhere/robot.toml", USAGE, NO_FILE) for one in ("decode", "list", "watch")],
    ("sim --listen nonsense", USAGE, "HOST:PORT"),
    ("sim --listen 256.256.256.256:1", UNREACHABLE, "cannot listen"),
    ("sim --listen a..b:1", UNREACHABLE, "cannot listen"),
    ("sim --listen {taken}", UNREACHABLE, "cruiser sim: cannot listen on {taken}: Address already in use"),
    ("sim --fault '3s bumpr front on'", USAGE, "did you mean 'bumper'"),
    ("sim --fault 'slope -31'", USAGE, "from -30 to 30"),
    ("sim --listen 127.0.0.1:0 --interface virtual", USAGE, "cannot be combined"),
    ("sim --channel x", USAGE, "--interface"),
    ("sim --interface socketcand --channel 127.0.0.1:9", UNREACHABLE, "bus unavailable"),
    *[
        (f"sim {flag} {value}", USAGE, flag)
        for flag, value in (
            *(("--rate-multiplier", "1000"), ("--rate-multiplier", "nan"), ("--rate-multiplier", "x")),
            *(
                ("--seconds", "0"),
                ("--seconds", "x"),
                ("--variant", "medium"),
                ("--stop-mode", "x"),
                ("--slope", "-31"),
            ),
        )
    ],
    ("fault --sim a..b:9 clear", UNREACHABLE, "cruiser fault: no virtual chassis at a..b:9: "),
    ("fault --sim 127.0.0.1:9 clear", UNREACHABLE, "cruiser fault: no virtual chassis at 127.0.0.1:9: "),
    ("fault --sim 127.0.0.1:9 bumpr", USAGE, "cruiser fault: there is no fault 'bumpr'; did you mean 'bumper'?"),
    ("gateway --interface nosuch", USAGE, "nosuch"),
    ("gateway --interface socketcand --channel x", USAGE, "HOST:PORT"),
    ("gateway --variant rough", USAGE, "variant"),
    ("gateway --robot 'Cruiser 1'", USAGE, "robot.name"),
    ("gateway --interface socketcand --channel {free}", UNREACHABLE, f"socketcand {{free}}: {REFUSED}"),
    ("gateway --channel nosuchcan", UNREACHABLE, "nosuchcan"),
    ("gateway --interface virtual --listen tcp/{taken}", UNREACHABLE, "Address already in use"),
    ("halt --interface socketcand --channel 127.0.0.1:1", UNREACHABLE, "127.0.0.1:1"),
    *[(f"watch '{one}'", USAGE, "cannot be a robot, or several") for one in ("cruiser-$*", "Cruiser-1")],
    *[
        (f"{one} --timeout 0.5 --connect tcp/{{free}}", UNREACHABLE, NOBODY)
        for one in ("watch", "watch cruiser-1", "list")
    ],
    *[(f"demo --seconds {one}", USAGE, "--seconds") for one in ("0", "-1", "nan", "x")],
    *[(f"demo --seconds {one}", USAGE, "must be from 20 to 86400") for one in ("5", "19", "1e6")],
    ("demo --out /proc/nowhere", FAILURE, "/proc/nowhere"),
    ("demo --out {here}/none.pem", FAILURE, "cannot write in {here}/none.pem: Not a directory"),
    (f"{DEMO} --robots 0", USAGE, "not a whole number from 1 to 64"),
    (f"{DEMO} --endpoint tcp/0.0.0.0:0", USAGE, "can be reached from other computers"),
    (f"{DEMO} --endpoint here", USAGE, "here"),
    (f"{DEMO} --robots 1 --endpoint tcp/{{taken}}", UNREACHABLE, "{taken}"),
    ("desk --listen 0.0.0.0:0", USAGE, "desk.certificate"),
    ("desk --listen nowhere", USAGE, "desk.listen"),
    ("desk --certificate /nowhere/desk.pem", USAGE, "desk.key"),
    ("desk --listen {taken}", UNREACHABLE, "{taken}"),
    (
        "desk --listen 127.0.0.1:0 --certificate {here}/none.pem --certificate-key {here}/desk.key",
        USAGE,
        "none.pem",
    ),
    ("desk --logs missing --logs-only", USAGE, "missing is not a directory"),
    ("desk --logs . --viewer 'javascript:alert(1)'", USAGE, "not the address of a viewer"),
    ("desk --logs-only", USAGE, "--logs-only needs --logs DIR"),
    (f"{DRIVE} --speed 0.2 --deadman 1.5", USAGE, "longer than the maximum timeout, 1 s"),
    (f"{DRIVE} --speed 9", USAGE, "9 m/s is above the chassis's maximum, 2.222 m/s"),
    (f"{DRIVE} --speed -2.3", USAGE, "-2.3 m/s is above the chassis's maximum, 2.222 m/s"),
    (f"{DRIVE} --speed 1 --angle 30", USAGE, "30 deg is above the chassis's maximum, 24 deg"),
    (DRIVE, USAGE, "--seconds needs --speed"),
    ("drive cruiser-1 --speed 1", USAGE, "no terminal to read keys from"),
    ("drive cruiser-1", USAGE, "no terminal to read keys from"),
    *[
        (f"park {one}", USAGE, "error: argument")
        for one in ("Cruiser", "'*'", "cruiser-1 --operator a/b", "cruiser-1 --lease -1", "a --lease x")
    ],
    *[(f"decode --variant coarse {{here}}/{one}", USAGE, "cannot read") for one in ("missing.log", ".")],
    *[
        (f"record {one}", USAGE, says)
        for one, says in (
            *(("dance", "dance"), ("status Depot", "Depot"), ("status depot/x", "depot/x"), ("status a b", "b")),
            *(
                ("status '\x1b[2J'", "[2J"),
                ("mark --robot '*'", "--robot"),
                ("mark --operator 'a b'", "--operator"),
            ),
            *(
                ("mark --timeout 0", "--timeout"),
                ("mark --timeout nan", "--timeout"),
                ("status --text x", "--text"),
            ),
            *((f"--seconds={text}", "--seconds") for text in ("0", "-1", "inf", "nan", "soon")),
            *(("--shard 5/4", "such as 2/4"), ("--shard two", "recorder.shard")),
            ("--shard 1/2 -k 'elsewhere/**'", "names none"),
            *((f"-k '{key}'", "is no key expression") for key in ("fleet//x", "", "/fleet", "fleet/$x*")),
            *((f"{one}--connect nonsense", "Zenoh does not take connect/endpoints") for one in ("", "status ")),
        )
    ],
    ("record -o {here}/none.pem --connect tcp/{free}", FAILURE, "cannot write {here}/none.pem: File exists"),
    *[
        (f"metrics --listen '{one}'", USAGE, NO_ADDRESS)
        for one in ("9747", "localhost:9747", "127.0.0.1:", "127.0.0.1:65536", "127.0.0.1:-1", "")
    ],
    ("metrics --listen {taken}", UNREACHABLE, "cannot listen on {taken}: Address already in use"),
    ("provision robot 'Cruiser 1'", USAGE, "'Cruiser 1' cannot be a name"),
    ("provision router \u00fc.example", USAGE, "'\\xfc.example' cannot be a name"),
    ("provision robot cruiser_1", USAGE, "one name, of the form"),
    ("provision operator ann/bea", USAGE, "ann/bea"),
    (f"provision viewer {'x' * 65}", USAGE, "x" * 65),
    ("provision renew robot", USAGE, "robot-tls.pem is not there; 'cruiser provision install' writes it"),
    ("provision renew viewer", USAGE, "viewer-tls.pem is not there; 'cruiser provision install' writes it"),
    ("provision sign no.request", USAGE, "no.request is not there"),
    ("provision install no.bundle", USAGE, "no.bundle is not there"),
    (f"provision authority --standby no --router {ROUTER}", USAGE, "'cruiser provision standby' makes it"),
    *[
        (f"{AUTHORITY} --standby {{here}}/standby.pub --router '{one}'", USAGE, "tls/HOST:PORT")
        for one in ("tcp/127.0.0.1:7447", "router.example:7447", "tls/router.example", "")
    ],
    ("provision rotate no.json", USAGE, "no.json is not there"),
    ("provision show {here}/none.pem --all", USAGE, "none.pem: it contains no statement"),
    ("provision revoke", USAGE, "nothing to revoke"),
    ("provision revoke ann", USAGE, "no authority's key is in"),
    *[
        (f"{SIGN} {flag} {value}", USAGE, flag)
        for flag, value in (
            *(("--verbs", "drive,fly"), ("--role", "robot"), ("--speed-limit", "0"), ("--speed-limit", "101")),
            *[("--robots", "Depot")],
        )
    ],
    (f"{SIGN} --hours 0", USAGE, "'0' is not a number of hours"),
    (f"{SIGN} --days 4000", USAGE, "'4000' is not a number of days"),
]


@pytest.mark.parametrize(("words", "code", "says"), WRONG, ids=[words for words, *_ in WRONG])
def test_what_cannot_be_is_one_line_and_a_code(tmp_path: Path, words: str, code: ExitCode, says: str) -> None:
    (tmp_path / "none.pem").write_text("none")
    (tmp_path / "standby.pub").write_text("ab" * 32)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        places = {"taken": f"127.0.0.1:{taken.getsockname()[1]}", "here": str(tmp_path)}
        places["free"] = free_endpoint().removeprefix("tcp/")
        done = run(
            shlex.split(words.format(**places)),
            XDG_CONFIG_HOME=str(tmp_path),
            CRUISER_RECORDER_DIRECTORY=str(tmp_path / "logs"),
        )
    lines = [line for line in done.stderr.splitlines() if not line.startswith("demo: ")]
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    assert says.format(**places) in lines[-1]
    assert len(lines) == 1 or lines[0].startswith("usage: "), lines
    assert "\x1b" not in done.stderr
    assert ".rs" not in done.stderr, "no place in Zenoh's own source"
    assert not (tmp_path / "new").exists()
