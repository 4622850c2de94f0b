"""Frozen scenarios and deaths of the gateway: short hashes of all frames and samples of each.

A change of a rule writes them again, and its commit says why: ``python -m tests.system.scenarios --freeze``.
``--lines NAME`` prints all that is hashed of a row: compare two commits to find the first difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from hashlib import blake2b
from pathlib import Path
from typing import Any, Final

import msgspec

from schemas.codec import Sample
from schemas.journal import Kind
from schemas.settings import CommandSettings
from tests.system.scenarios import early_stops
from tests.system.scenarios.deaths import DEATHS
from tests.system.scenarios.oracle import Fields, Oracle
from tests.system.scenarios.plant import CanFrame
from tests.system.scenarios.scenario import Play, Result, Scenario, scenario

FILE: Final = Path(__file__).parents[2] / "data" / "frozen" / "scenarios.txt"

SEEDS: Final = 500

# Rows of the file: a seed, or time and circumstances of a gateway's death.
NAMES: Final = (*map(str, range(SEEDS)), *DEATHS)
HEARD: Final = ("feedback", "core", "guard", "replies")
# The first word of each subject: removing a subject leaves the other hashes as they are.
SAMPLES: Final = ("can", "chassis", "gateway", "journal", "safety", "state")
COLUMNS: Final = ("plan", *HEARD, *SAMPLES, "end")

UNHASHED: Final = "chassis/odometry"  # newer than the frozen rows, and tested elsewhere: no decision depends on it
LEFT_OUT: Final = {
    "journal": ("rules", "inputs"),
    "safety/decision": ("detail",),
    "safety/event": ("text",),
    "safety/state": ("stop_detail",),
}
"""Fields of a subject that no hash counts. Texts for people are among them: new words change no behaviour.

Enter one here and freeze before it goes: its going changes nothing.

The number of the command rules says nothing of what is done. A journal's inputs are hashed one by one, without
checkpoints: these hold the attributes of the core, which may get other names.
"""


class Witness(Oracle):
    """An oracle that also hashes frames and samples, line by line."""

    def __init__(self, *given: Any, **named: Any) -> None:  # noqa: ANN401 - those of the oracle
        super().__init__(*given, **named)
        self.hashes = {name: blake2b(digest_size=4) for name in (*HEARD, *SAMPLES)}
        self.write: Callable[[str], object] = lambda _: None

    def hears(self, frames: list[CanFrame], now_s: float) -> None:
        super().hears(frames, now_s)
        self._add_frames("feedback", frames, now_s)

    def frames(self, burst: list[CanFrame], now_s: float, *, taken: int, by_guard: bool) -> None:
        super().frames(burst, now_s, taken=taken, by_guard=by_guard)
        self._add_frames("guard" if by_guard else "core", burst[:taken], now_s)

    def reply(self, verb: str, fields: Fields, now_s: float) -> None:
        super().reply(verb, fields, now_s)
        kept = {name: value for name, value in fields.items() if name not in {"detail", "cure"}}
        self.add("replies", now_s, f"{verb} {kept}")

    def _add_frames(self, name: str, frames: list[CanFrame], now_s: float) -> None:
        for identifier, data in frames:
            self.add(name, now_s, f"{identifier:08X} {data.hex()}")

    def add(self, name: str, now_s: float, said: str) -> None:
        line = f"{now_s:.3f} {name} {said}\n"
        self.hashes[name].update(line.encode())
        self.write(line)


def _take_samples(played: Play) -> None:
    witness, gateway = played.oracle, played.gateway
    assert isinstance(witness, Witness)
    samples, gateway.samples = gateway.samples, []
    for sample in samples:
        subject = sample.subject
        if subject == UNHASHED:
            continue
        witness.add(subject.partition("/")[0], played.rig.now_s, f"{subject} {_content(sample)}")


def _content(sample: Sample) -> str:
    if sample.subject not in LEFT_OUT:
        return sample.payload.hex()
    fields = msgspec.msgpack.decode(sample.payload)
    kept = {name: value for name, value in fields.items() if name not in LEFT_OUT[sample.subject]}
    inputs = msgspec.msgpack.decode(fields["inputs"]) if sample.subject == "journal" else []
    return msgspec.msgpack.encode([kept, [one for one in inputs if one[0] != Kind.CHECKPOINT]]).hex()


def plan_of(name: str) -> Scenario:
    return DEATHS[name] if name in DEATHS else scenario(int(name))


def hash_of_plan(plan: Scenario) -> str:
    """A hash of what a seed decides; settings with the product's default are left out."""
    defaults = CommandSettings()
    fields = {name: getattr(plan, name) for name in plan.__struct_fields__}
    fields["command"] = {
        name: value
        for name in plan.command.__struct_fields__
        if (value := getattr(plan.command, name)) != getattr(defaults, name)
    }
    return blake2b(msgspec.json.encode(fields, order="deterministic"), digest_size=4).hexdigest()


def play(name: str, write: Callable[[str], object] | None = None) -> tuple[str, Result]:
    """Play a run. Returns its row, and the oracle's result."""
    plan = plan_of(name)
    played = Play(plan, keeps=True, watch=_take_samples, judge=Witness)
    witness = played.oracle
    assert isinstance(witness, Witness)
    witness.write = write or witness.write
    result = played.run()
    state, plant = played.gateway.state, played.plant
    held = "braked" if plant.braked else "unbraked"
    end = ",".join([state["state"], state["stop_reason"], held, "moves" if plant.speed_mps else "stands"])
    return " ".join([name, hash_of_plan(plan), *(one.hexdigest() for one in witness.hashes.values()), end]), result


def row_of(name: str) -> str:
    return play(name)[0]


def frozen() -> dict[str, str]:
    rows = FILE.read_text(encoding="utf-8").splitlines()[1:]
    return {row.partition(" ")[0]: row for row in rows}


def freeze(rows: Iterable[str]) -> None:
    early_stops.FILE.write_text(early_stops.frozen(), encoding="utf-8")
    FILE.write_text("\n".join([f"name {' '.join(COLUMNS)}", *rows, ""]), encoding="utf-8")


def difference(row: str, before: str) -> str:
    name, *now = row.split()
    differing = [word for word, one, other in zip(COLUMNS, now, before.split()[1:], strict=True) if one != other]
    again = f"python -m tests.system.scenarios --lines {name}"
    return f"{name}: {', '.join(differing)}; {again} at both commits shows from when" if differing else ""
