"""Golden logs, and the facts that ``cruiser review`` answers about them.

``python -m tests.support.golden_logs`` writes all answers again; ``--compare`` prints what differs.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import hashlib
import io
import json
import lzma
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from gateway.cli.main import main
from schemas.journal import COMMAND_RULES

DIRECTORY: Final = Path(__file__).parents[1] / "data" / "golden"
LOGS: Final = sorted(path.name for path in DIRECTORY.iterdir() if path.is_dir())

MOST_BYTES: Final = 150_000  # of a stored file of a log
DIGITS: Final = 9  # significant digits of a figure; later ones depend on the order of a sum
STOPS: Final = 3  # stops of a robot that are asked about, besides its last one
LINE: Final = 110

AUTHORITY: Final = "authority.json"
DAMAGED: Final = "damaged"  # prefix of the logs that are recovered too
# Words for people, each beside a fact that is compared.
PROSE: Final = frozenset({"headline", "time", "detail", "cause", "changes"})
OWN: Final = frozenset({"version", "metadata"})  # of the version that answers, or elsewhere in the same answer


def unpack(name: str, directory: Path) -> list[str]:
    """Write a log's files. Returns the names of the logs among them."""
    for path in (DIRECTORY / name).glob("*.xz"):
        (directory / path.stem).write_bytes(lzma.decompress(path.read_bytes()))
    return sorted(path.name for path in directory.glob("*.mcap*"))


def facts(value: Any) -> Any:  # noqa: ANN401 - JSON
    """The fields of an answer that are neither prose nor empty."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, list):
        return [facts(one) for one in value]
    if not isinstance(value, dict):
        return value
    said = PROSE | OWN | ({"text"} if value.get("data") or value.get("reason", "none") != "none" else set())
    kept = {key: facts(one) for key, one in value.items() if key not in said}
    return {key: one for key, one in kept.items() if one is not None and one not in ("", [], {})}


def ask(*words: str) -> tuple[int, list[Any]]:
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = main(["review", words[0], "--json", *words[1:]])
    return code, [json.loads(line) for line in said.getvalue().splitlines()]


def answered(question: str, *words: str) -> dict[str, Any]:
    code, said = ask(question, *words)
    return {"exit_code": code, "answer": facts(said)}


def why(*logs: str) -> dict[str, Any]:
    """The last stop of each robot, and each stop that is an event, by its time."""
    _, events = ask("events", *logs)
    found = {}
    for robot in sorted({one["robot"] for one in events}):
        stops = {one["since_s"] for one in events if one["robot"] == robot and one["kind"] in {"stop", "takeover"}}
        for at_s in sorted(stops)[:STOPS]:
            found[f"{robot} at {at_s}"] = answered("why", "--robot", robot, "--at", str(at_s), *logs)
        found[f"{robot}, last"] = answered("why", "--robot", robot, *logs)
    return found


def rerun(*logs: str) -> dict[str, Any]:
    """The summary; of a log under other rules only what was run, as its decisions differ."""
    code, runs = ask("rerun", *logs)
    others = [run for run in runs if run["rules"] != COMMAND_RULES]
    kept = ("robot", "run", "first", "inputs", "rules")
    said = [facts({key: run[key] for key in kept} if run in others else run) for run in runs]
    return {"exit_code": "other rules" if others else code, "answer": said}


def verify(*logs: str) -> dict[str, Any]:
    authority = ["--authority", AUTHORITY] if Path(AUTHORITY).exists() else []
    return answered("verify", *authority, *logs)


def digest(values: list[Any]) -> str:
    """A short hash of a column's values, independent of library versions."""
    text = json.dumps(values, default=bytes.hex, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def plain(table: pa.Table) -> pa.Table:
    """The table with times as whole nanoseconds."""
    for place, field in enumerate(table.schema):
        if pa.types.is_timestamp(field.type):
            table = table.set_column(place, field.name, table[place].cast("int64"))
    return table


def export(*logs: str) -> dict[str, Any]:
    """Number of rows and a hash of each column per table; likewise the raw frames as candump log."""
    code, said = ask("export", "-o", "tables", *logs)
    if not said:
        return {"exit_code": code}
    found: dict[str, list[dict[str, Any]]] = {}
    for file in sorted(said[0]["files"], key=lambda one: str(one["path"])):
        rows = plain(pq.read_table(Path("tables", file["path"]), partitioning=None)).to_pylist()
        found.setdefault(file["topic"], []).extend(rows)
    tables = {}
    for topic, rows in found.items():
        rows.sort(key=lambda row: (row["log_time"], row["sequence"]))
        values = {name: [row.get(name) for row in rows] for name in rows[0]}
        columns = {
            name: digest(column) for name, column in values.items() if any(one is not None for one in column)
        }
        tables[topic] = {"rows": len(rows), "columns": columns}
    inputs = [{"path": one["path"], "rows": one["rows"]} for one in said[0]["inputs"]]
    ask("export", "--format", "candump", "-o", "frames", *logs)
    frames = {
        path.name: [len(lines := path.read_bytes().splitlines()), hashlib.sha256(b"\n".join(lines)).hexdigest()]
        for path in sorted(Path("frames").glob("*.log"))
    }
    return {"exit_code": code, "inputs": inputs, "tables": tables, "frames": frames}


def recover(*logs: str) -> dict[str, Any]:
    """The recovered logs and their messages; changes the files."""
    said = answered("recover", *logs)
    files = sorted(path.name for path in Path().iterdir())
    _, made = ask("info", *(name for name in files if name.endswith(".mcap")))
    messages = {one["path"]: {row["topic"]: row["messages"] for row in one["channels"]} for one in made}
    return {**said, "files": files, "messages": messages}


QUESTIONS: Final[dict[str, Callable[..., dict[str, Any]]]] = {
    **{name: partial(answered, name) for name in ("info", "check", "events", "report")},
    "why": why,
    "rerun": rerun,
    "verify": verify,
    "export": export,
    "recover": recover,
}


def asked(name: str) -> list[str]:
    """The questions for a log; a whole one needs no recovery."""
    return [question for question in QUESTIONS if question != "recover" or name.startswith(DAMAGED)]


def pretty(value: Any, indent: str = "\n") -> str:  # noqa: ANN401 - JSON
    """JSON with sorted keys; whatever fits on one line is on one line."""
    line = json.dumps(value, sort_keys=True)
    if len(indent + line) <= LINE or not isinstance(value, dict | list):
        return line
    deeper = f"{indent} "
    if isinstance(value, list):
        return f"[{deeper}{f',{deeper}'.join(pretty(one, deeper) for one in value)}{indent}]"
    rows = [f"{json.dumps(key)}: {pretty(one, deeper)}" for key, one in sorted(value.items())]
    return f"{{{deeper}{f',{deeper}'.join(rows)}{indent}}}"


def answer(name: str, question: str) -> str:
    with TemporaryDirectory() as directory, contextlib.chdir(directory):
        return pretty(QUESTIONS[question](*unpack(name, Path()))) + "\n"


def stored(name: str, question: str) -> Path:
    return DIRECTORY / name / f"{question}.json"


def difference(name: str, question: str) -> str:
    """A diff of stored and current answer."""
    before = stored(name, question).read_text(encoding="utf-8").splitlines()
    now = answer(name, question).splitlines()
    return "\n".join(difflib.unified_diff(before, now, f"{name}/{question}: stored", "now", n=4, lineterm=""))


def command() -> int:
    """Write the answers about these logs, or all; with ``--compare`` print the differences instead."""
    parser = argparse.ArgumentParser()
    parser.add_argument("logs", nargs="*", default=LOGS)
    parser.add_argument("--compare", action="store_true")
    arguments = parser.parse_args()
    found = ""
    for log in arguments.logs:
        for question in asked(log):
            if arguments.compare:
                found += difference(log, question)
            else:
                stored(log, question).write_text(answer(log, question), encoding="utf-8")
    sys.stdout.write(found)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(command())
