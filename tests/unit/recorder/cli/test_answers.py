"""Answers of ``cruiser review``: given these logs, a command and its output."""

import json
import os
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec.structs import replace

from recorder.encoding.samples import ReceivedSample
from schemas.command_line import CommandError
from schemas.messages import Message
from tests.support.commands import review
from tests.support.drives import drive_log, drive_messages, drives_over, restart, write_messages
from tests.support.logs import GEAR_CHANNEL, Log, foreign_log, gear_message, gears, own_log, saved, small_log
from tests.support.messages import FakeSample, gear, info, sample_of
from tests.support.rigs import scenarios
from tests.support.rigs.scenarios import acted, recorded


def log_of(*samples: ReceivedSample, wall_ns: int | None = None) -> bytes:
    log = Log()
    log.receive(*samples, **({} if wall_ns is None else {"wall_ns": wall_ns}))
    return log.close()


def damaged(data: bytes, before: bytes, behind: int, *, is_cut: bool = False) -> bytes:
    """A log with a flipped bit some bytes behind these, or one that ends there."""
    at = data.index(before) + behind
    return data[:at] if is_cut else data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


ROBOTS = range(1, 8)
STALL = [[gear_message(sequence, at_ns, one) for one in ROBOTS] for sequence, at_ns in ((0, 10), (5, 100))]
ACCOUNT = {"fleet/x": json.dumps({"sent": 9, "received": 5, "written": 5, "lost_link": 4})}
FILES: dict[str, Callable[[], bytes]] = {
    "whole.mcap": small_log,
    "cut.mcap.part": lambda: small_log()[:-300],
    "foreign.mcap": foreign_log,
    "cdr.mcap": lambda: foreign_log(encoding="cdr", schema=("p/msg/T", "ros2msg", b"int8 x")),
    "bare.mcap": lambda: own_log([], []),
    "empty.mcap.part": bytes,
    "zero.mcap": bytes,
    "lost.mcap": lambda: own_log([gears(0, 2, 5)], metadata=[("cruiser.completeness", ACCOUNT)]),
    "short.mcap": lambda: own_log([gears(0, 3, 10), gears(5, 3, 100)])[:-20],
    "stall.mcap": lambda: own_log(
        STALL, [replace(GEAR_CHANNEL, channel_id=one, topic=f"fleet/r-{one}/chassis/gear") for one in ROBOTS]
    ),
    "flipped.mcap": lambda: damaged(own_log([gears(0, 3, 10)]), b"\x28\xb5\x2f\xfd", 20),
    "ended.mcap": lambda: damaged(own_log([gears(0, 3, 10)]), b"\x28\xb5\x2f\xfd", 20, is_cut=True),
    "chunk.mcap.part": lambda: damaged(small_log(), b"\x04\x00\x00\x00zstd", 30),
    "r-1.mcap": lambda: own_log([gears(0, 3, 10)]),
    "r-2.mcap": lambda: own_log([gears(7, 3, 1_000_000_010)]),
    "r-2.incident.mcap": lambda: own_log([gears(0, 3, 10)]),
    "gears.mcap": lambda: own_log([gears(0, 3, 10)]),
    "minute.mcap": lambda: own_log([gears(0, 60, 100_000_000_000, 1_000_000_000)]),
    "few.mcap": lambda: own_log([gears(0, 3, 10)])[:-20],
    os.fsdecode(b"\xff.mcap"): lambda: own_log([gears(0, 2, 5)]),
    "escape.mcap": lambda: log_of(FakeSample("k/\x1b[2J\x07", "x", b"")),
    "late.mcap": lambda: log_of(FakeSample("k", "x", b""), wall_ns=2**63 - 1),
    "gear.mcap": lambda: log_of(sample_of(gear(0))),
    "roots.mcap": lambda: log_of(
        *(sample_of(one, root=root) for root in ("fleet", "..") for one in (gear(0), info()))
    ),
    "long.mcap": lambda: log_of(
        *(sample_of(one, robot) for robot in ("a" * 250, "cruiser-1") for one in (gear(0), info()))
    ),
    "catalog.parquet": lambda: b"rubbish",
    "report.html": lambda: b"old",
    "bumper.mcap": lambda: recorded(scenarios.front_bumper),
    "stub-8.mcap": lambda: recorded(scenarios.front_bumper)[:8],
    "stub-100.mcap": lambda: recorded(scenarios.front_bumper)[:100],
    "stale.mcap": lambda: recorded(scenarios.stale_commands),
    "other.mcap": lambda: acted(scenarios.deadman).log(robot="cruiser-2"),
    "drive.mcap": drive_log,
    "drive-2.mcap": lambda: drive_log("cruiser-2"),
    "drive-cut.mcap": lambda: drive_log(count=200)[:-200],
    "drive-stub.mcap": lambda: drive_log()[:400],
}
"""What a log of this name holds."""

DRIVES: dict[str, tuple[list[Message], list[str]]] = {
    "a.mcap": (drive_messages(60), ["cruiser-1"]),
    "cruiser-2-b.mcap": (drives_over(3, 3), ["cruiser-2"]),
    "x\x1b[2J.mcap": (drive_messages(60), ["cruiser-1"]),
    "restart.mcap": (restart(60, 40), ["cruiser-1"]),
    "two.mcap": (drive_messages(20), ["r-1", "r-2"]),
}
"""What these robots say in it."""

ROWS = r"""
== a time that is not in the logs is one clear error, for an empty answer would look like one [whole.mcap]
2$ events whole.mcap --from 5 --to 3 => no time between
2$ events whole.mcap --from 1000 => hold nothing of that time
2$ events whole.mcap --to 1999-01-01T00:00:00Z => hold nothing of that time
2$ events whole.mcap --from noon => is no time
== where there is no journal there was nothing to run [whole.mcap]
3$ rerun whole.mcap => no journal
== a sound log is no finding, and its frames are counted [whole.mcap]
$ check whole.mcap => file: no fault found | data: no loss detected | Auto_GearFeedBack
== findings are told by what they are about [short.mcap]
1$ check short.mcap
    the file is cut off within a record (1, first at byte
    data: fleet/cruiser-1/chassis/gear: samples missed, by the sequence (2, first at 1970-
== what is missing everywhere is one line, with three names [stall.mcap]
1$ check stall.mcap
    samples missed, by the sequence (28, first at 1970-
    : fleet/r-1/chassis/gear, fleet/r-2/chassis/gear, fleet/r-3/chassis/gear and 4 more | never r-4
== a check as JSON is an object a log, and one for what is between them [whole.mcap cut.mcap.part]
1$ check --json whole.mcap cut.mcap.part
    {"path": "whole.mcap", "findings": []} | {"path": "cut.mcap.part", "messages": 12} | {"between": []}
    "about":"file" | #3 | never "about":"data"
== what cannot be judged is told, and is no finding [cdr.mcap]
$ check cdr.mcap => not read: messages of 1 channels
== where no message can be read nothing is claimed [flipped.mcap ended.mcap]
1$ check flipped.mcap => : 0 messages | data: unknown, no message could be read | never no loss
1$ check ended.mcap => : 0 messages | data: unknown, no message could be read | never no loss
== what is in none of several logs is told, and is no finding about any [logs/r-1.mcap logs/r-2.mcap]
$ check logs
    between the logs: fleet/cruiser-1: 4 samples of 1 keys between 1970-01-01 | (r-1.mcap, then r-2.mcap)
== incidents are checked too [logs/r-1.mcap logs/r-2.incident.mcap]
$ check logs => r-2.incident.mcap
== a killed recorder's log is recovered by hand [cut.mcap.part]
$ recover cut.mcap.part => = "cut.mcap: recovered, 12 messages\n"
$ info cut.mcap
== a recovery as JSON [cut.mcap.part]
$ recover --json cut.mcap.part => {"outcome": "recovered", "messages": 12, "kept": null, "result": "cut.mcap"}
== a damaged log is a partial recovery, and the rest is kept [chunk.mcap.part]
3$ recover chunk.mcap.part => damaged, 2 messages | fault: byte | rest is in chunk.mcap.damaged
== what cannot be recovered is a failure, and among others a part [empty.mcap.part cut.mcap.part]
1$ recover empty.mcap.part none => nothing in it can be read | No such file
3$ recover empty.mcap.part cut.mcap.part
== of a directory what is not finished is recovered, and nothing else [logs/cut.mcap.part logs/whole.mcap]
$ recover logs => = "logs/cut.mcap: recovered, 12 messages\n"
$ recover logs => holds no unfinished log | #0
== a part of no topic is refused, and nothing is written [gears.mcap few.mcap]
2$ cut gears.mcap --topic nothing -o out.mcap => no topic matches these patterns | never cut off
2$ cut few.mcap --topic nothing -o out.mcap => no topic matches these patterns | cut off
1$ info out.mcap => No such file
== a part is of a time and of topics, as people write them [minute.mcap]
$ cut minute.mcap --from 10 --to -9.5 --topic '*/gear' -o out.mcap --json => {"messages": 40, "channels": 1}
$ info out.mcap --json => {"messages": 40, "start_ns": 110000000000, "end_ns": 149000000000}
2$ cut minute.mcap --from soon -o other.mcap => is no time | only minute.mcap out.mcap
== a part is of one log, or of a directory of one [one/gears.mcap logs/gears.mcap logs/r-2.mcap]
$ cut one -o one.mcap
2$ cut logs -o out.mcap => it takes one file, and logs has 2
2$ cut logs/gears.mcap logs/r-2.mcap -o out.mcap
1$ info out.mcap => No such file
== events are a table with times, severity, kind, cause, operator and a sentence [stale.mcap]
$ events stale.mcap
    operator what 2023-11-14 | 3.318 22:13:23.330 cruiser-1 warning stop deadman
    (operator-1) stopping: no valid drive command arrived in time; none for 310 ms; 15 commands refused as too
        old, 1290 ms
    [30 times within 0.6 s]
== time and kind bound what events tell [stale.mcap]
$ events stale.mcap --json --kind stop --kind refusal --from 3.1 --to 3.35
    {"kind": "refusal"} | {"kind": "stop", "cause": "no valid drive command arrived in time"} | #2
== events of a log without a robot are refused, and of no such kind there are none
logs foreign.mcap gears.mcap bare.mcap
1$ events foreign.mcap => nothing of a robot | #0
1$ events --json foreign.mcap => nothing of a robot | #0
1$ events bare.mcap => nothing of a robot | #0
1$ why bare.mcap => nothing of a robot | #0
$ events gears.mcap --json --kind takeover => = ""
== a robot that is not in the logs is refused with the names of those that are [stale.mcap]
2$ events stale.mcap --robot cruiser-1 --robot cruiser-9 => nothing of cruiser-9, but of cruiser-1
$ events stale.mcap --robot cruiser-1 => deadman
$ events stale.mcap --robot 'cruiser-*' => deadman
$ events stale.mcap --robot '*' => deadman
== the last stop is explained in one sentence, and each link has its times [bumper.mcap]
$ why bumper.mcap
    cruiser-1 at 2.028 s, 2023-11-14 22:13:22.040 UTC: It was being stopped: the front bumper was hit.
    +0.000 s 22:13:22.040 cause Stopping: the front bumper was hit.
    Frame 0x18C4D9EF Auto_MileageAndBodyFeedback
== a moment has every form of a time, each the same one [bumper.mcap]
$ why bumper.mcap --json --at='1.9'
    {"state": "engaged", "reason": "front_bumper"} | later a stop began: the front bumper was hit
$ why bumper.mcap --json --at='-2.4'
    {"state": "engaged", "reason": "front_bumper"} | later a stop began: the front bumper was hit
$ why bumper.mcap --json --at='2023-11-14 22:13:21.912 UTC'
    {"state": "engaged", "reason": "front_bumper"} | later a stop began: the front bumper was hit
== of several robots one is to be named [bumper.mcap other.mcap]
2$ why bumper.mcap other.mcap => one of cruiser-1, cruiser-2
$ why bumper.mcap other.mcap --robot cruiser-2
2$ why bumper.mcap --robot cruiser-3 => nothing of cruiser-3
== a log that tells nothing of the arbiter is a failure [whole.mcap]
1$ why whole.mcap => Not in the log: what the arbiter did then.
== a moment that the log does not hold is a failure without a reason, however near [bumper.mcap]
1$ why bumper.mcap --json --at=100
    {"state": null, "reason": "none", "stop_ns": null, "chain": [{"step": "missing"}]}
    The log does not cover that moment: it ends 95.
    not in the log: that moment: the log covers 2023-11-14 22:13:20
1$ why bumper.mcap --json --at=8
    {"state": null, "reason": "none", "stop_ns": null, "chain": [{"step": "missing"}]}
    The log does not cover that moment: it ends 3.
    not in the log: that moment: the log covers 2023-11-14 22:13:20
1$ why bumper.mcap --json --at=-100
    {"state": null, "reason": "none", "stop_ns": null, "chain": [{"step": "missing"}]}
    The log does not cover that moment: it begins 95.
    not in the log: that moment: the log covers 2023-11-14 22:13:20
== a stub says that it is one [stub-8.mcap stub-100.mcap]
3$ why stub-8.mcap => nothing of a robot | ends without a footer
3$ why stub-100.mcap => nothing of a robot | is cut off within a record
== a whole log is described [whole.mcap]
$ info whole.mcap
    whole.mcap: whole | robot cruiser-1, variant coarse | fleet/cruiser-1/chassis/gear
    nothing lost, by the recorder's account
== what was lost is told as the recorder says [lost.mcap]
$ info lost.mcap => fleet/x 9 5 5 - 0 4 0 0 0 0
== info as JSON is an object a log and one for all [whole.mcap cut.mcap.part]
3$ info --json whole.mcap cut.mcap.part
    {"path": "whole.mcap", "whole": true, "messages": 12}
    {"path": "cut.mcap.part", "whole": false, "messages": 12} | {"files": 2, "whole": 1, "messages": 24} | #3
== a partial log is shown as far as it goes [cut.mcap.part]
3$ info cut.mcap.part => NOT WHOLE | read record by record | fault: byte | fleet/cruiser-1/chassis/gear
== a directory is shown with a total [logs/whole.mcap logs/foreign.mcap]
$ info logs => 2 files, 2 of them whole | 22 messages | 1 robot: cruiser-1
== a directory is a line for each log [logs/whole.mcap logs/cut.mcap.part]
3$ info logs
    logs/whole.mcap: whole, robot cruiser-1, from 2027-01-15 08:00:00.000 UTC, | , 12 messages, 0 lost
    logs/cut.mcap.part: NOT WHOLE, robot cruiser-1,
== one file that is none is an error
1$ info none.mcap => No such file
== a log's names do not reach the terminal as commands [escape.mcap x<ESC>[2J.mcap]
$ info escape.mcap
$ find logs .
== a log of absurd times is described [late.mcap]
$ info late.mcap => 2262-
== a name that is no text is escaped [<FF>.mcap]
$ info  . => \udcff.mcap
$ info --json . => \udcff.mcap
$ check  . => \udcff.mcap
$ check --json . => \udcff.mcap
== a dataset is made, and one line says how much it is [drive.mcap]
$ export -o out drive.mcap => out: 29 rows in 6 files, 0.
$ export --json -o set drive.mcap => {"inputs": [{"rows": 29}], "files": [{}, {}, {}, {}, {}, {}]}
== raw frames are one file a robot, and none is written over [drive.mcap drive-2.mcap]
$ export --format candump -o candump drive.mcap drive-2.mcap
    cruiser-1.log: 5 frames | cruiser-2.log: 5 frames | #2
1$ export --format candump -o candump drive.mcap drive-2.mcap => exists, and is not overwritten
== CSV is one file a topic, of chosen topics alone [drive.mcap]
$ export --format csv --topic 'chassis/*' -o out drive.mcap
    = "out/fleet.cruiser-1.chassis.gear.csv: 20 rows\n"
1$ export --format csv -o out drive.mcap => exists, and is not overwritten
== a place on a network is refused [drive.mcap]
2$ export --format parquet -o s3://b/logs drive.mcap => s3:/b/logs is no directory | (aws s3 sync
2$ export --format csv -o s3://b/logs drive.mcap => s3:/b/logs is no directory | (aws s3 sync
1$ info s3: => No such file
== what only a dataset has is refused elsewhere [whole.mcap]
2$ export --format csv --processes 2 -o out whole.mcap => --format parquet
2$ export --format csv --ray auto -o out whole.mcap => --format parquet
== a time is chosen from the log's beginning [drive.mcap]
$ export --topic chassis_gear --from 0.05 --to 0.1 -o out drive.mcap => : 5 rows in 1 files
== a name that is no text is escaped in a manifest, also beside a damaged log [<FF>.mcap drive-cut.mcap]
3$ export --json -o out <FF>.mcap drive-cut.mcap
    {"inputs": [{"path": "\\udcff.mcap"}, {"path": "drive-cut.mcap"}]} | file out/manifest.json has \udcff.mcap
== people get an aligned table with a head [drive.mcap]
$ query 'SELECT gear_position AS g, max(alive_counter) / 2 AS x FROM chassis_gear GROUP BY 1' SOURCE
    = "  g      x\n  drive  7.5\n"
== options may stand anywhere, and what is none is told [drive.mcap]
$ query --json 'SELECT count(*) AS n FROM chassis_gear' SOURCE => = "{\"n\":20}\n"
$ query 'SELECT count(*) AS n FROM chassis_gear' --json SOURCE => = "{\"n\":20}\n"
$ query 'SELECT count(*) AS n FROM chassis_gear' SOURCE --json => = "{\"n\":20}\n"
2$ query 'SELECT 1' --nothing SOURCE => unrecognized arguments: --nothing
== columns of one name are kept apart [drive.mcap]
$ query --json 'SELECT 1 AS a, 2 AS a, 3 AS a_1, 4 AS a FROM chassis_gear LIMIT 1' SOURCE
    = "{\"a\":1,\"a_2\":2,\"a_1\":3,\"a_3\":4}\n"
== programs get an object a line, or a head and lines [drive.mcap]
$ query --json 'SELECT sequence, log_time, data FROM can_rx LIMIT 2' SOURCE
    {"sequence": 0, "log_time": "2027-01-15T08:00:00.000000000Z", "data": "AQQAAAAAAAU="} | #2
$ query --csv 'SELECT sequence, log_time, data FROM can_rx LIMIT 2' SOURCE
    "sequence","log_time","data" 0,"2027-01-15T08:00:00.000000000Z","0104000000000005"
== an empty answer is one: in words, in CSV as a head alone [drive.mcap]
$ query 'SELECT sequence FROM chassis_gear WHERE sequence < 0' SOURCE => = "  no rows\n"
$ query --csv 'SELECT sequence FROM chassis_gear WHERE sequence < 0' SOURCE => = "\"sequence\"\n"
== tables are listed with topics, columns, types and units [drive.mcap]
$ query --tables SOURCE => chassis_gear: fleet/cruiser-1/chassis/gear | time_ns int64 ns
$ query --tables --json SOURCE => {"name": "can_rx"} | {"name": "raw_sample"}
== a statement and a log are wanted [drive.mcap]
2$ query SOURCE => give a statement
== of a dataset the statement says the time, and it is asked alone [drive.mcap]
$ export -o out drive.mcap
2$ query --from 1 'SELECT 1' out => WHERE log_time
2$ query 'SELECT 1' drive.mcap out => give one dataset alone
== a damaged log is a partial answer [drive-cut.mcap drive-stub.mcap]
3$ query 'SELECT count(*) AS n FROM chassis_gear' drive-cut.mcap => 200 | byte
2$ query 'SELECT * FROM odometry_of_others' drive-stub.mcap => does not exist | the file is cut off
== a statement does not write into the dataset that it reads [drive.mcap]
$ export -o out drive.mcap
2$ query "COPY (SELECT 1 AS a) TO 'out/manifest.json' (FORMAT csv)" out => not a SELECT
2$ query "EXPLAIN ANALYZE COPY (SELECT 1 AS a) TO 'out/manifest.json' (FORMAT csv)" out => not a SELECT
    file out/manifest.json has "format": "cruiser-dataset"
== what a log holds does not rule the terminal, and is cut [drive.mcap]
$ query "SELECT chr(27) || '[2J' AS a, repeat('x', 99) AS b" SOURCE => xxx...
$ query --csv "SELECT chr(27) || chr(155) || chr(13) || chr(8238) AS a, 'ü,<NL>' AS b" SOURCE
    = "\"a\",\"b\"\n\"\\x1b\\x9b\\r\\u202e\",\"ü,\n\"\n"
$ query --csv 'SELECT 1 AS "a<ESC>"' SOURCE => = "\"a\\x1b\"\n1\n"
== files are out of reach [drive.mcap]
2$ query "COPY (SELECT 1 AS a) TO 'a.csv'" SOURCE => not a SELECT
1$ info a.csv => No such file
== moments are shown with links into their reports [logs/a.mcap logs/cruiser-2-b.mcap]
$ find stops logs --reason=front_bumper --robot=cruiser-2
    logs/cruiser-2-b.html#t=2027-01-16T08:00:02.950Z&robot=cruiser-2
    cruiser review report logs/cruiser-2-b.mcap -o logs/cruiser-2-b.html | #5
== drives and logs have tables of their own [logs/a.mcap logs/cruiser-2-b.mcap]
$ find drives logs => #6
$ find logs logs --robot=cruiser-2
    begin robots lasted distance stops lost faults log | logs/cruiser-2-b.mcap | #2
$ find logs logs --json => {"names": ["cruiser-1"]} | {"names": ["cruiser-2"]} | #2 | never "moments"
$ find drives logs --json => #4
== nothing is said to be nothing; for programs there is no line [logs/a.mcap logs/cruiser-2-b.mcap]
$ find stops logs --reason=deadman => = "nothing found\n"
$ find stops logs --reason=deadman --json => = ""
== a log that cannot be read is named, and costs no other [logs/a.mcap logs/cruiser-2-b.mcap logs/zero.mcap]
3$ find stops logs --json => zero.mcap is empty | #4
== what two directories hold is told once, and each has its catalog
logs logs/a.mcap logs/cruiser-2-b.mcap depot/a.mcap depot/two.mcap
$ find stops logs depot --json
    {"robot": "cruiser-1"} | {"robot": "cruiser-2"} | {"robot": "r-1"} | {"robot": "r-2"} | #6
    file logs/catalog.parquet has PAR1 | file depot/catalog.parquet has PAR1
== a damaged catalog is told in a line, and the answer is whole
logs logs/a.mcap logs/cruiser-2-b.mcap logs/catalog.parquet
$ find stops logs --json
    #4 | cruiser review: logs/catalog.parquet is damaged: rebuilt from the logs
$ find stops logs --json => #4 | never rebuilt
== a catalog is kept elsewhere when told to, that of one directory [logs/a.mcap logs/cruiser-2-b.mcap]
$ find stops logs --catalog elsewhere.parquet --json
    #4 | only elsewhere.parquet logs logs/a.mcap logs/cruiser-2-b.mcap
2$ find stops logs . --catalog elsewhere.parquet => one local directory
== a damaged log is answered as far as it goes each time, and marked [logs/drive-cut.mcap logs/a.mcap]
3$ find stops logs --json => 1 of 2 logs are damaged or unfinished: 'find logs' marks them
3$ find stops logs --json => 1 of 2 logs are damaged or unfinished: 'find logs' marks them
3$ find logs logs --json
    {"file": "logs/drive-cut.mcap", "faults": 1} | {"file": "logs/a.mcap", "faults": 0} | cut off
== a directory without logs is an error
1$ why file:///no/such/place => no such directory
1$ find stops . => there is no log in
== the catalog is a table for any other question, and no more [logs/a.mcap logs/cruiser-2-b.mcap]
$ query 'SELECT names[1] AS robot, len(drives) AS drives FROM catalog ORDER BY robot' logs --json
    {"robot": "cruiser-1", "drives": 1} | {"robot": "cruiser-2", "drives": 3} | #2
1$ info logs/catalog.parquet => is no MCAP file
2$ query "COPY (SELECT * FROM catalog) TO 'elsewhere.csv'" logs => not a SELECT
2$ query 'SELECT * FROM catalog' logs --from=1 => WHERE start_ns
== the newest answers and a time before now bound what is found [logs/a.mcap logs/cruiser-2-b.mcap]
$ find stops logs --newest=2 --since=2000w --until=2100-01-01 --json => #2
$ find stops logs --until=2000-01-01 --json => = ""
== a log of no robot has no layouts, and where nothing can be written it says so [escape.mcap whole.mcap]
1$ layouts escape.mcap -o out => no topic of a robot
1$ layouts whole.mcap -o whole.mcap => cannot write
== layouts as JSON are an object a file [whole.mcap]
$ layouts whole.mcap -o out --json
    {"robot": "fleet/cruiser-1", "path": "out/cruiser-1.layout.foxglove.json"}
== robots of one name under two roots have layouts of their own, and no root leads out of the directory
logs roots.mcap
$ layouts roots.mcap -o out
    file out/..-cruiser-1.layout.foxglove.json has { | file out/..-cruiser-1.layout.plotjuggler.xml has <
    file out/fleet-cruiser-1.layout.foxglove.json has { | file out/fleet-cruiser-1.layout.plotjuggler.xml has <
== a robot whose name is too long costs no other its layouts [long.mcap]
3$ layouts long.mcap -o out
    file out/cruiser-1.layout.foxglove.json has { | no layout of fleet/aaaa | File name too long
== a page is written whole, with the summary on stdout [a.mcap]
$ report a.mcap -o r.html
    cruiser-1: 1 drive, 2.9 m; 1 stop: the front bumper was hit | written: r.html | file r.html has <!doctype html>
    only a.mcap r.html
== JSON alone writes no file, and nothing that is only drawn [a.mcap]
$ report a.mcap --json
    {"robots": [{"distance_m": 2.95, "moments": [{"reason": "front_bumper"}, {"kind": "gap"}]}]} | never "lines"
    only a.mcap
== without a name a report is report.html, and what is there is replaced [a.mcap report.html]
$ report a.mcap => file report.html has Drive report
== a damaged log gives a report of what can be read [drive-cut.mcap]
3$ report drive-cut.mcap -o r.html => cruiser review: drive-cut.mcap: byte | file r.html has Unreadable data
== a gateway that died is told on the terminal and as JSON [restart.mcap]
$ report restart.mcap => 1 stop: the gateway died; 40 samples lost. | Gateway silent for 2.0 s from
$ report restart.mcap --json => "kind":"gap" | "kind":"gateway" | "variant":"coarse"
== a report's period counts from the log's beginning [a.mcap]
$ report a.mcap --json --from 1 --to 2 => {"robots": [{"known_s": 0.95}]}
== a log of no robot's state has nothing to report [gear.mcap]
1$ report gear.mcap => nothing to report
== a report of another kind is a matter of usage, and one that cannot be written a failure [a.mcap]
2$ report a.mcap -o r.pdf => .html
1$ report a.mcap -o nowhere/r.html => cannot write
== a report of one robot of several [two.mcap]
$ report two.mcap --json --robot r-2 => {"robots": [{"name": "r-2"}]}
2$ report two.mcap --json --robot r-3 => the logs hold nothing of r-3
== flags of a replay that mean nothing are a matter of usage [drive.mcap]
2$ replay drive.mcap --root 'fleet/**'
2$ replay drive.mcap --root ''
2$ replay drive.mcap --key a//b => no key expression
2$ replay drive.mcap --speed=-1
2$ replay drive.mcap --speed 0
2$ replay drive.mcap --speed nan
2$ replay drive.mcap --loop 0
2$ replay drive.mcap --loop x
== what means nothing is a matter of usage [logs/a.mcap logs/cruiser-2-b.mcap]
2$ find 'stop last 7d' logs => invalid choice: 'stop last 7d' (choose from
2$ find stops --reason front_bumpr logs => there is no reason 'front_bumpr': did you mean front_bumper?
2$ find stops --since yesterday logs => 'yesterday' is no time: give one as 30d
2$ find stops --since 30 logs => '30' is no time
2$ find stops --newest 0 logs => '0' is not a whole number from 1
2$ find stops --since 1d --until 2d logs => --since must be before --until
2$ find stops --robot cruiser-9 logs => the logs hold nothing of cruiser-9, but of cruiser-1, cruiser-2
"""
"""A name, in brackets the logs that are there, and commands with what they say, behind ``=>`` or below.

Before ``$`` stands the exit code, if it is not 0. A text stands in all that is said, white space apart; JSON is a
part of a line; ``#3`` lines are on stdout; ``= text`` is all of it, as JSON has it; ``never text`` stands nowhere;
``only names`` are there, and ``file name has text``. A line that is indented by eight goes on. SOURCE is a log, or
a dataset of it.
"""

UNSEEN = {"<ESC>": "\x1b", "<FF>": os.fsdecode(b"\xff"), "<NL>": "\n"}
CASES = [
    pytest.param(row, source, id=f"{row.partition(' [')[0].partition(chr(10))[0]}{source and ': '}{source}")
    for row in re.sub("\n {8}", " ", ROWS).split("\n== ")[1:]
    for source in (("drive.mcap", "set") if "SOURCE" in row else ("",))
]


def unseen(text: str) -> str:
    """The text with its invisible characters."""
    for short, character in UNSEEN.items():
        text = text.replace(short, character)
    return text


def holds(found: object, wanted: object) -> bool:
    """True if an object contains all wanted parts."""
    if isinstance(wanted, dict):
        return isinstance(found, dict) and all(holds(found.get(key), value) for key, value in wanted.items())
    if isinstance(wanted, list):
        return isinstance(found, list) and len(found) == len(wanted) and all(map(holds, found, wanted))
    return bool(found == (pytest.approx(wanted) if isinstance(wanted, float) else wanted))


def judge(said: str, out: str, every: str) -> None:
    objects = [json.loads(line) for line in out.splitlines() if line.startswith("{")]
    for wanted in said.split(" | ") if said else ():
        if wanted.startswith("#"):
            assert len(out.splitlines()) == int(wanted[1:]), every
        elif wanted.startswith("{"):
            assert any(holds(found, json.loads(wanted)) for found in objects), (wanted, every)
        elif wanted.startswith("= "):
            assert out == json.loads(wanted[2:])
        elif wanted.startswith("never "):
            assert wanted[6:] not in every
        elif wanted.startswith("only "):
            assert " ".join(sorted(map(str, Path().rglob("*")))) == wanted[5:]
        elif wanted.startswith("file "):
            name, _, words = wanted[5:].partition(" has ")
            assert words in Path(name).read_text("utf-8", "replace")
        else:
            assert " ".join(wanted.split()) in " ".join(every.split()), (wanted, every)


@pytest.mark.parametrize(("row", "source"), CASES)
def test_answers(
    row: str, source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each command of a row ends with its exit code and prints the texts given there."""
    monkeypatch.chdir(tmp_path)
    given, *_ = re.findall(r"(?:\A.* \[(.*)\]$|^logs (.*)$)", row, re.MULTILINE) or [("", "")]
    asks = re.findall(r"^(\d?)\$ (.*?)(?: => (.*))?((?:\n    .*)*)$", row, re.MULTILINE)
    assert asks
    for path in map(Path, unseen("".join(given)).split()):
        path.parent.mkdir(exist_ok=True)
        if path.name in DRIVES:
            write_messages(path, DRIVES[path.name][0], robots=DRIVES[path.name][1])
        else:
            saved(path, FILES[path.name]())
    if source == "set":
        asks.insert(0, ("", "export -o set drive.mcap", "", ""))
    for wanted, command, beside, below in asks:
        code: object
        try:
            code, ending = review(*shlex.split(unseen(command).replace("SOURCE", source))), ""
        except CommandError as error:
            code, ending = error.code, str(error)
        except SystemExit as error:
            code, ending = error.code, ""
        shown = capsys.readouterr()
        every = shown.out + shown.err + ending
        assert code == int(wanted or 0), (command, every)
        assert "\x1b" not in every
        judge(f"{beside}{below}".replace("\n    ", " | ").removeprefix(" | "), shown.out, every)
