"""Wrong arguments of all commands: one line that names what is wrong, and an exit code."""

import re
import shlex
import socket
from pathlib import Path

import pytest

from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import run

DESK = "127.0.0.1:0 --certificate {here}/none.pem --certificate-key {here}/desk.key"
NO_FILE = "cannot read the configuration file '/nowhere/robot.toml': no such file or directory"
REFUSED = "no server there: [Errno 111] Connection refused (with --wait-for-bus the gateway starts without it)"
WRONG = r"""
2 wach => cruiser: unknown command 'wach'; did you mean 'watch'?
2 [decode|list|watch] --config /nowhere/robot.toml => {no_file}
2 sim --listen nonsense => HOST:PORT
4 sim --listen [256.256.256.256:1|a..b:1] => cannot listen
4 sim --listen {taken} => cruiser sim: cannot listen on {taken}: Address already in use
2 sim --fault '3s bumpr front on' => did you mean 'bumper'
2 sim --fault 'slope -31' => from -30 to 30
2 sim --listen 127.0.0.1:0 --interface virtual => cannot be combined
2 sim --channel x => --interface
4 sim --interface socketcand --channel 127.0.0.1:9 => bus unavailable
2 sim --rate-multiplier [1000|nan|x] => --rate-multiplier
2 sim --seconds [0|x] => --seconds
2 sim --variant medium => --variant
2 sim --stop-mode x => --stop-mode
2 sim --slope -31 => --slope
4 fault --sim a..b:9 clear => cruiser fault: no virtual chassis at a..b:9:
4 fault --sim 127.0.0.1:9 clear => cruiser fault: no virtual chassis at 127.0.0.1:9:
2 fault --sim 127.0.0.1:9 bumpr => cruiser fault: there is no fault 'bumpr'; did you mean 'bumper'?
2 gateway --interface nosuch => nosuch
2 gateway --interface socketcand --channel x => HOST:PORT
2 gateway --variant rough => variant
2 gateway --robot 'Cruiser 1' => robot.name
4 gateway --interface socketcand --channel {free} => socketcand {free}: {refused}
4 gateway --channel nosuchcan => nosuchcan
4 gateway --interface virtual --listen tcp/{taken} => Address already in use
4 halt --interface socketcand --channel 127.0.0.1:1 => 127.0.0.1:1
2 watch [cruiser-'$'*|Cruiser-1] => cannot be a robot, or several
4 [watch|watch cruiser-1|list] --timeout 0.5 --connect tcp/{free} => no Zenoh node answered within 0.5 s at
2 demo --seconds [0|-1|nan|x] => --seconds
2 demo --seconds [5|19|1e6] => must be from 20 to 86400
1 demo --out /proc/nowhere => /proc/nowhere
1 demo --out {here}/none.pem => cannot write in {here}/none.pem: Not a directory
2 demo --desk --no-browser --robots 0 => not a whole number from 1 to 64
2 demo --desk --no-browser --endpoint tcp/0.0.0.0:0 => can be reached from other computers
2 demo --desk --no-browser --endpoint here => here
4 demo --desk --no-browser --robots 1 --endpoint tcp/{taken} => {taken}
2 desk --listen 0.0.0.0:0 => desk.certificate
2 desk --listen nowhere => desk.listen
2 desk --certificate /nowhere/desk.pem => desk.key
4 desk --listen {taken} => {taken}
2 desk --listen {desk} => none.pem
2 desk --logs missing --logs-only => missing is not a directory
2 desk --logs . --viewer 'javascript:alert(1)' => not the address of a viewer
2 desk --logs-only => --logs-only needs --logs DIR
2 drive cruiser-1 --seconds 1 --speed 0.2 --deadman 1.5 => longer than the maximum timeout, 1 s
2 drive cruiser-1 --seconds 1 --speed 9 => '9' is not a speed in m/s from -2.222 to 2.222
2 drive cruiser-1 --seconds 1 --speed -2.3 => '-2.3' is not a speed in m/s from -2.222 to 2.222
2 drive cruiser-1 --seconds 1 --speed 1 --angle 30 => '30' is not an angle in degrees from -24 to 24
2 drive cruiser-1 --seconds 1 => --seconds needs --speed
2 drive cruiser-1[| --speed 1] => no terminal to read keys from
2 park [Cruiser|'*'|cruiser-1 --operator a/b|cruiser-1 --lease -1|a --lease x] => error: argument
2 decode --variant coarse {here}/[missing.log|.] => cannot read
2 record dance => dance
2 record status Depot => Depot
2 record status depot/x => depot/x
2 record status a b => b
2 record status '{escape}[2J' => [2J
2 record mark --robot '*' => --robot
2 record mark --operator 'a b' => --operator
2 record mark --timeout [0|nan] => --timeout
2 record status --text x => --text
2 record --seconds=[0|-1|inf|nan|soon] => --seconds
2 record --shard 5/4 => such as 2/4
2 record --shard two => recorder.shard
2 record --shard 1/2 -k 'elsewhere/**' => names no robot
2 record -k '[fleet//x||/fleet|fleet/$x*]' => is no key expression
2 record [|status ]--connect nonsense => Zenoh does not take connect/endpoints
1 record -o {here}/none.pem --connect tcp/{free} => cannot write {here}/none.pem: File exists
2 metrics --listen '[9747|localhost:9747|127.0.0.1:|127.0.0.1:65536|127.0.0.1:-1|]' => is not an address and a port
4 metrics --listen {taken} => cannot listen on {taken}: Address already in use
2 provision robot 'Cruiser 1' => 'Cruiser 1' cannot be a name
2 provision router {umlaut}.example => '\xfc.example' cannot be a name
2 provision robot cruiser_1 => one name, of the form
2 provision operator ann/bea => ann/bea
2 provision viewer {long} => {long}
2 provision renew [robot|viewer] => -tls.pem is not there; 'cruiser provision install' writes it
2 provision sign no.request => no.request is not there
2 provision install no.bundle => no.bundle is not there
2 provision authority --standby no --router tls/127.0.0.1:47447 => 'cruiser provision standby' makes it
2 provision authority {new} '[tcp/127.0.0.1:7447|router.example:7447|tls/router.example|]' => tls/HOST:PORT
2 provision rotate no.json => no.json is not there
2 provision show {here}/none.pem --all => none.pem: it contains no statement
2 provision revoke => nothing to revoke
2 provision revoke ann => no authority's key is in
2 provision sign some.request --verbs drive,fly => --verbs
2 provision sign some.request --role robot => --role
2 provision sign some.request --speed-limit [0|101] => --speed-limit
2 provision sign some.request --robots Depot => --robots
2 provision sign some.request --hours 0 => '0' is not a number of hours
2 provision sign some.request --days 4000 => '4000' is not a number of days
"""
"""Exit code, words, and what the line says; ``[a|b]`` is a row for each."""


def rows(line: str) -> list[str]:
    found = re.search(r"\[([^][]*\|[^][]*)\]", line)
    if found is None:
        return [line]
    return [row for one in found[1].split("|") for row in rows(line.replace(found[0], one, 1))]


@pytest.mark.parametrize("row", [row for line in WRONG.strip("\n").split("\n") for row in rows(line)])
def test_what_cannot_be_is_one_line_and_a_code(tmp_path: Path, row: str) -> None:
    (tmp_path / "none.pem").write_text("none")
    (tmp_path / "standby.pub").write_text("ab" * 32)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        places = {"taken": f"127.0.0.1:{taken.getsockname()[1]}", "here": str(tmp_path)}
        places |= {"free": free_endpoint().removeprefix("tcp/"), "desk": DESK.format(here=tmp_path)}
        places |= {"no_file": NO_FILE, "refused": REFUSED, "escape": "\x1b", "umlaut": "\u00fc", "long": "x" * 65}
        places["new"] = f"--directory {tmp_path}/new --standby {tmp_path}/standby.pub --router"
        words, says = row[2:].format(**places).split(" => ")
        done = run(
            shlex.split(words), XDG_CONFIG_HOME=str(tmp_path), CRUISER_RECORDER_DIRECTORY=str(tmp_path / "logs")
        )
    lines = [line for line in done.stderr.splitlines() if not line.startswith("demo: ")]
    assert (str(done.returncode), done.stdout) == (row[0], ""), done.stderr
    assert says in lines[-1]
    assert len(lines) == 1 or lines[0].startswith("usage: "), lines
    assert "\x1b" not in done.stderr
    assert ".rs" not in done.stderr, "no place in Zenoh's own source"
    assert not (tmp_path / "new").exists()
