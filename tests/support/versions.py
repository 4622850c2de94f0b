"""Logs that gateways and recorders of earlier versions wrote, and what ``cruiser review`` answers about them.

``python -m tests.support.versions`` writes the answers anew: read what has changed before you commit it.
"""

import contextlib
import io
import json
import lzma
import os
from pathlib import Path
from tempfile import TemporaryDirectory

from gateway.cli.main import main

DIRECTORY = Path(__file__).parents[1] / "data" / "versions"
LOGS = {path.name.removesuffix(".mcap.xz"): path for path in sorted(DIRECTORY.glob("*.mcap.xz"))}
OTHER_RULES = {"rules-1", "rules-4", "signed-mode", "rules-6", "rules-6-signed", "rules-6-checkpoint"}
"""Logs of other command rules than those of this version: their decisions come out otherwise."""

QUESTIONS = ("info", "check", "events", "why", "rerun", "export")


def unpack(name: str, directory: Path) -> Path:
    """The log as it was written, in a directory."""
    path = directory / f"{name}.mcap"
    path.write_bytes(lzma.decompress(LOGS[name].read_bytes()))
    return path


def answer(name: str, question: str) -> str:
    """What is answered about a log, in the present directory, which holds it; with the exit code."""
    words = ["review", question, f"{name}.mcap"]
    words += {"export": ["-o", "out", "--json"], "rerun": ["--json"]}.get(question, [])
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = main(words)
    text = said.getvalue()
    if question == "export":
        found = json.loads(text)["files"]
        text = "".join(
            f"{one['table']} {one['rows']}\n" for one in sorted(found, key=lambda one: str(one["table"]))
        )
    elif question == "rerun":
        runs = [json.loads(line) for line in text.splitlines()]
        kept = ["run", "inputs", "detail", *([] if name in OTHER_RULES else ["same", "difference_count"])]
        text = "".join(json.dumps({key: run.get(key) for key in kept}) + "\n" for run in runs)
    return f"{text}exit code {code}\n"


def stored(name: str, question: str) -> Path:
    """Where the answer is kept."""
    return DIRECTORY / name / f"{question}.txt"


if __name__ == "__main__":
    os.environ["COLUMNS"] = "100"
    for each in LOGS:
        with TemporaryDirectory() as made, contextlib.chdir(made):
            unpack(each, Path(made))
            for asked in QUESTIONS:
                stored(each, asked).parent.mkdir(exist_ok=True)
                stored(each, asked).write_text(answer(each, asked), encoding="utf-8")
