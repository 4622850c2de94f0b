# SPDX-License-Identifier: Apache-2.0
"""Rewrite the generated parts of README.md and docs/*.md: ``make generate``.

A part stands between ``<!-- generated: NAME -->`` and ``<!-- end -->``. The text around it is written by hand.
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from pathlib import Path
from typing import Any, Final

import tables

from gateway import LeaseLost, Refused, Robot, Stopped, Unreachable
from gateway.chassis.cruiser import gate
from gateway.chassis.cruiser.frames import DRIVE_COMMAND, STEERING_COMMAND, TARGET_ANGLE, TARGET_SPEED, load
from gateway.chassis.frame import hex_identifier
from gateway.client.link import Sighting
from gateway.client.refusal import RobotError
from gateway.client.robot import Lease
from gateway.command.rulings import STOPS, diagram
from gateway.doctor.checks import CHECKS
from gateway.metrics import MEASURES
from recorder import read_log
from recorder.reading.rows import END_OF_TIME_NS
from recorder.review.messages import LogMessage, LogMessages
from schemas.command_line import CommandError
from schemas.messages import Variant
from schemas.reasons import TEXTS

ROOT: Final = Path(__file__).parent.parent

LIBRARY: Final = (
    Robot,
    Lease,
    Sighting,
    CommandError,
    RobotError,
    Refused,
    Stopped,
    LeaseLost,
    Unreachable,
    read_log,
    LogMessages,
    LogMessage,
)


def state_diagram() -> str:
    """The arbiter's states, as a diagram that Markdown viewers draw."""
    return f"```mermaid\n{diagram()}\n```"


def stop_table() -> str:
    """Every cause to stop: how hard, and whether it is latched."""
    rows = [
        (
            f"`{reason.value}`",
            TEXTS[reason].means,
            "emergency" if stop.at_once else "normal",
            "yes" if stop.latched else "",
        )
        for reason, stop in STOPS.items()
    ]
    return tables.table(("cause", "it means", "deceleration", "latched"), rows)


_TESTS: Final = "tests/unit/gateway/chassis/cruiser/test_gate"
_RISES: Final = (gate.SPEED_RISE_RAW[Variant.COARSE], gate.SPEED_RISE_RAW[Variant.FINE])

BUS_RULES: Final = (
    ("identifiers", "the eight above, extended", "_exhausted.py::test_no_other_identifier"),
    ("kind", "classic data frames of 8 bytes", ".py::test_every_length_but_eight_is_refused"),
    (
        "bits",
        "those above, the alive counter (52..55) and the checksum (56..63), which is right",
        "_exhausted.py::test_every_pattern_of_a_frame",
    ),
    ("other bits", "none", "_exhausted.py::test_one_and_two_wrong_bits"),
    (
        "alive counter",
        "the one after the last of that identifier, modulo 16",
        "_exhausted.py::test_every_counter_after_every_counter",
    ),
    (
        "rate",
        f"at most {gate.RATE_FRAMES} frames of an identifier in {gate.RATE_WINDOW_NS // 1_000_000} ms",
        ".py::test_the_rate_of_each_frame_is_bounded",
    ),
    (
        "burst",
        "drive, gear, steering, braking and parking, in this order, then others; each once; all or nothing",
        ".py::test_a_burst_is_whole_and_in_order",
    ),
    (
        "after a part of a burst",
        "at zero speed also drive, parking, gear, steering and braking, in this order",
        ".py::test_a_torn_burst_may_be_followed_by_the_brake_first",
    ),
    ("values", "those above", "_exhausted.py::test_every_value_of_every_signal"),
    ("enables", "all five or none", ".py::test_each_combination_of_enables"),
    (
        "without the enables",
        "neutral, zero speed, parking request",
        "_exhausted.py::test_every_combination_of_two_bursts",
    ),
    (
        "neutral",
        "with the parking request, at zero speed",
        ".py::test_what_contradicts_itself_is_refused",
    ),
    (
        "a speed",
        "in reverse or drive, without parking request",
        ".py::test_what_contradicts_itself_is_refused",
    ),
    (
        "the speed rises",
        f"a burst by {_RISES[0]} bit (coarse), {_RISES[1]} bits (fine) at most; never in a stop",
        "_exhausted.py::test_every_speed_step",
    ),
    (
        "the angle changes",
        f"a burst by {gate.ANGLE_STEP_RAW} bits at most",
        "_exhausted.py::test_every_angle_step",
    ),
    (
        "the gear changes",
        "from or to neutral, with the parking request in this burst and in the one before",
        ".py::test_what_may_follow_what",
    ),
    (
        "the parking request ends",
        "in reverse or drive, at zero speed; in a stop once after an engagement, for a brake that does not hold",
        ".py::test_what_may_follow_what",
    ),
    (
        f"after {gate.FORGET_NS // 1_000_000} ms without a burst, or silence on purpose",
        "the parking request; a stop may begin released, and with a speed",
        ".py::test_what_may_follow_what",
    ),
    (
        "a stop in place",
        "always, within the rate: zero speed, gear and angle as before, parking request, enables",
        "_exhausted.py::test_a_stop_in_place_is_always_admitted",
    ),
)
"""The conditions of the gate, each with the end of its test's name."""


def bus_frame_table() -> str:
    """Every frame that the gate admits: which bits, and which values."""
    names = {message.can_id: message.name for message in load(Variant.COARSE).commands}
    values = dict(zip(gate.MOTION, (_speeds(), _gears(), _angles(), "0", "0, 1"), strict=True))
    rows = [
        (f"`0x{hex_identifier(can_id)}`", names[can_id], _bits(used), values.get(can_id, "0, 1 each"))
        for can_id, used in gate.USED_BITS.items()
    ]
    return tables.table(("identifier", "frame", "bits that may be set", "their values"), rows)


def bus_rule_table() -> str:
    """Every rule of the gate, with its test."""
    rows = [(what, passes, f"`{_TESTS}{test}`") for what, passes, test in BUS_RULES]
    return tables.table(("what", "passes", "test"), rows)


def _bits(used: int) -> str:
    """The bits below the alive counter, as the manual counts them."""
    digits = f"{used & (1 << 52) - 1:b}"[::-1]
    runs = [match.span() for match in re.finditer("1+", digits)]
    return ", ".join(f"{first}" if end - first == 1 else f"{first}..{end - 1}" for first, end in runs)


def _gears() -> str:
    names = {gate.REVERSE: "reverse", gate.NEUTRAL: "neutral", gate.DRIVE: "drive"}
    return ", ".join(f"{raw} {names[raw]}" for raw in sorted(gate.GEARS))


def _angles() -> str:
    signal = load(Variant.COARSE).messages[STEERING_COMMAND].signal(TARGET_ANGLE)
    first, last = (raw * signal.scale + signal.offset for raw in (gate.ANGLE_RAW[0], gate.ANGLE_RAW[-1]))
    return f"{gate.ANGLE_RAW[0]}..{gate.ANGLE_RAW[-1]}: {first:.2f} to {last:.2f} deg"


def _speeds() -> str:
    texts = []
    for variant in (Variant.COARSE, Variant.FINE):
        signal = load(variant).messages[DRIVE_COMMAND].signal(TARGET_SPEED)
        most = gate.SPEED_RAW_MAX[variant]
        texts.append(f"{variant.value} 0..{most}: to {most * signal.scale:.3f} m/s")
    return "; ".join([*texts, f"scale unknown: {gate.SPEED_RAW_MAX[Variant.UNKNOWN]}"])


def metric_table() -> str:
    """Every metric that is made of a field of a message."""
    rows = [
        (f"`{measure.name}`", measure.label and f"`{measure.label}`", f"`{kind.__name__}.{measure.field}`")
        for kind, measures in MEASURES.items()
        for measure in measures
    ]
    return tables.table(("metric", "label", "field"), rows)


def finding_table() -> str:
    """Every finding of ``cruiser doctor``, with its cure; a note is said to be one."""
    rows = [(f"`{check.name}`{' (note)' if check.is_note else ''}", check.means, check.cure) for check in CHECKS]
    return tables.table(("finding", "it means", "cure"), rows)


def library() -> str:
    """Return the signatures and docstrings of all that a program imports."""
    return "\n\n".join(map(_described, LIBRARY))


def _described(one: Any) -> str:
    """Return a class with its public members, or a function."""
    name = one.__qualname__
    lines = [f"## `{name}{_signature(one)}`", _prose(one)]
    for member, value in vars(one).items() if isinstance(one, type) else ():
        inner = value.__func__ if isinstance(value, classmethod) else value
        if member.startswith("_") or not (inspect.isfunction(inner) or isinstance(inner, property)):
            continue
        label = f"{name}.{member}" + ("" if isinstance(inner, property) else _signature(inner))
        lines.append(f"**`{label}`** {_prose(inner)}")
    return "\n\n".join(line for line in lines if line)


def _signature(one: Any) -> str:
    """Return the arguments without their types, which the text names where a name does not."""
    if isinstance(one, type) and not issubclass(one, BaseException) and not hasattr(one, "__struct_fields__"):
        return ""
    if isinstance(one, type) and issubclass(one, BaseException):
        return ""
    signature = inspect.signature(one)
    shown = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in signature.parameters.values()
        if parameter.name not in {"self", "cls"}
    ]
    text = re.sub(r"<function .*? at \w+>", "...", str(inspect.Signature(shown)))
    return re.sub(r"<([\w.]+): .*?>", r"\1", text).replace(str(END_OF_TIME_NS), "END_OF_TIME_NS")


def _prose(one: Any) -> str:
    """Return a docstring as Markdown: its sections as lists, its literals in single backticks."""
    text = inspect.cleandoc(one.__doc__ or "").replace("``", "`")
    head, *sections = re.split(r"^(?=(?:Args|Attributes|Raises):$)", text, flags=re.MULTILINE)
    items: list[str] = []
    for section in sections:
        rows = re.split(r"^    (?=\S)", section.partition("\n")[2], flags=re.MULTILINE)[1:]
        named = [re.sub(r"\s+", " ", row).strip().partition(": ") for row in rows]
        title = {"Args": "", "Attributes": "", "Raises": "raises "}[section.partition(":")[0]]
        items += [f"- {title}`{name}`: {text}" for name, _, text in named]
    return "\n\n".join(filter(None, [head.strip(), "\n".join(items)]))


PARTS: Final[dict[str, tables.Part]] = tables.PARTS | {
    "bus-frames": bus_frame_table,
    "bus-rules": bus_rule_table,
    "findings": finding_table,
    "library": library,
    "metrics": metric_table,
    "states": state_diagram,
    "stops": stop_table,
}


def rewrite(text: str) -> str:
    """Return the document with every generated part current."""

    def replace(match: re.Match[str]) -> str:
        if match[1] not in PARTS:
            raise SystemExit(f"there is no generated part {match[1]!r}; there are {', '.join(PARTS)}")
        return f"<!-- generated: {match[1]} -->\n\n{PARTS[match[1]]()}\n\n<!-- end -->"

    return re.sub(r"<!-- generated: ([\w-]+) -->\n.*?<!-- end -->", replace, text, flags=re.DOTALL)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a document is not current")
    parser.add_argument("--root", type=Path, default=ROOT, help="the project's directory")
    arguments = parser.parse_args()
    stale = 0
    for path in [arguments.root / "README.md", *sorted(arguments.root.glob("docs/*.md"))]:
        text = path.read_text(encoding="utf-8")
        current = rewrite(text)
        if current != text:
            stale += 1
            if not arguments.check:
                path.write_text(current, encoding="utf-8")
            sys.stderr.write(f"{'stale' if arguments.check else 'wrote'} {path}\n")
    return int(bool(stale)) if arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
