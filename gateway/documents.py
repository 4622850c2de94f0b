"""All generated parts of README.md and docs/*.md: ``python -m gateway.documents`` rewrites them.

Most are made from the tables of ``schemas``, by ``schemas.documents``. Those of this module are made from the
arbiter's, the gate's and the metrics' own tables, which ``schemas`` knows nothing of.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import Final

from gateway.chassis.cruiser import gate
from gateway.chassis.cruiser.frames import DRIVE_COMMAND, STEERING_COMMAND, TARGET_ANGLE, TARGET_SPEED, load
from gateway.chassis.frame import hex_identifier
from gateway.command.rulings import STOPS, diagram
from gateway.doctor.checks import CHECKS
from gateway.metrics import MEASURES
from schemas import documents
from schemas.documents import Part
from schemas.messages import Variant
from schemas.reasons import TEXTS


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
    return documents.table(("cause", "it means", "deceleration", "latched"), rows)


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
    return documents.table(("identifier", "frame", "bits that may be set", "their values"), rows)


def bus_rule_table() -> str:
    """Every rule of the gate, with its test."""
    rows = [(what, passes, f"`{_TESTS}{test}`") for what, passes, test in BUS_RULES]
    return documents.table(("what", "passes", "test"), rows)


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
    return documents.table(("metric", "label", "field"), rows)


def finding_table() -> str:
    """Every finding of ``cruiser doctor``, with its cure; a note is said to be one."""
    rows = [(f"`{check.name}`{' (note)' if check.is_note else ''}", check.means, check.cure) for check in CHECKS]
    return documents.table(("finding", "it means", "cure"), rows)


PARTS: Final[dict[str, Part]] = {
    "bus-frames": bus_frame_table,
    "bus-rules": bus_rule_table,
    "findings": finding_table,
    "metrics": metric_table,
    "states": state_diagram,
    "stops": stop_table,
}


def main(words: Sequence[str] | None = None) -> int:
    """Rewrites the documents, or with ``--check`` only says which ones are not current."""
    return documents.main(words, documents.PARTS | PARTS)


if __name__ == "__main__":
    sys.exit(main())
