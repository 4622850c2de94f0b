"""A robot's report as people see it: a line, a panel, a table of robots. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import msgspec
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from gateway.client.fleet import RobotStatus, alarm
from gateway.client.reasons_text import is_idle, last_stop, link_line
from gateway.client.robot_word import WORDS, label_of, summary, word_of
from schemas.command_line import plain
from schemas.decisions import COMMANDING
from schemas.messages import GatewayHealth, RobotState

GOOD: Final = "green"
BAD: Final = "bold red"
LOUD: Final = "bold white on red"
PLAIN: Final = ""

NO_VALUE: Final = "--"
"""A value that is not known: never seen, or silent."""


class Fact(msgspec.Struct, frozen=True):
    """One thing to see, with the style that it is seen in."""

    label: str
    text: str
    style: str = PLAIN


def state_facts(state: RobotState) -> list[Fact]:
    """Return the facts of a robot's state."""
    hit = [side for side, on in (("front", state.front_bumper), ("rear", state.rear_bumper)) if on]
    lamps = (
        ("headlamp", state.headlamp),
        ("left", state.left_indicator),
        ("right", state.right_indicator),
        ("horn", state.horn),
    )
    return [
        Fact("mode", state.mode.value),
        Fact("gear", state.gear_position.value),
        Fact("speed", _number(state.speed_mps, "+z.2f", "m/s")),
        Fact("angle", _number(state.angle_deg, "+z.1f", "deg")),
        Fact("brake", state.braking_status.value),
        Fact("parking", state.parking_status.value),
        Fact("bumpers", _bumpers(state, hit), BAD if hit else PLAIN),
        Fact("lamps", _lamps(lamps)),
        Fact("mileage", _number(state.total_mileage_km, ".3f", "km")),
        Fact("variant", state.variant.value, BAD if state.variant.value == "unknown" else PLAIN),
        Fact("bus", "up" if state.bus_up else "DOWN", GOOD if state.bus_up else BAD),
        Fact("silent", ", ".join(map(plain, state.silent)) or "none", BAD if state.silent else PLAIN),
    ]


def health_facts(health: GatewayHealth) -> list[Fact]:
    """Return the facts of a gateway's health."""
    lost = sum(frame.lost for frame in health.feedback)
    faults = ", ".join(f"{plain(kind)} {count}" for kind, count in sorted(health.faults.items()) if count)
    bus = f"{plain(health.bus)} {'up' if health.bus_up else 'DOWN'}"
    if health.bus_detail and not health.bus_up:
        bus += f" ({plain(health.bus_detail)})"
    return [
        Fact("bus", bus, GOOD if health.bus_up else BAD),
        Fact("frames", f"{health.frames_per_s:.0f}/s, {lost} lost", BAD if lost else PLAIN),
        Fact("variant", health.variant.value),
        Fact("faults", faults or "none", BAD if faults else PLAIN),
        Fact("version", plain(health.gateway_version)),
        Fact("up", f"{health.uptime_s:.0f} s"),
        *([] if health.realtime else [Fact("real-time", "no", BAD)]),
    ]


def line(report: RobotStatus) -> str:
    """A robot in one line."""
    words = [report.robot]
    if report.state is None:
        words.append(_offline(report))
    else:
        words.append(label_of(word_of(report)[0]))
        words += [_word(fact) for fact in (*state_facts(report.state), *safety_facts(report))]
        words.append(f"age {report.state_age_s or 0:.2f} s")
    words.append(_faults_word(report))
    if report.newer:
        words.append(plain(report.newer))
    return "  ".join(words)


def safety_facts(report: RobotStatus) -> list[Fact]:
    """Return the arbiter's facts: operator, latches, blockers, last stop, limit, the commands' age."""
    safety = report.safety
    if report.state is None or safety is None:
        return []
    latched = ", ".join(reason.value for reason in safety.latched)
    link, stop = link_line(safety), last_stop(safety)
    blocked_by = [reason for reason in safety.blocked_by if reason not in safety.latched]
    blocked = ", ".join(reason.value for reason in blocked_by)
    return [
        Fact("arbiter", safety.state.value),
        Fact("driver", plain(safety.lease_holder) or "nobody"),
        *([Fact("latched", latched, BAD)] if latched else []),
        *([Fact("stopped by", plain(", ".join(safety.stopped_by)), BAD)] if safety.stopped_by else []),
        *([Fact("blocked by", blocked, PLAIN if is_idle(blocked_by) else BAD)] if blocked else []),
        *([Fact("last stop", stop)] if stop else []),
        *([Fact("limit", f"{safety.speed_limit_mps:.2f} m/s")] if safety.state in COMMANDING else []),
        *([Fact("link", link)] if link else []),
    ]


def list_lines(reports: Sequence[RobotStatus]) -> Iterator[str]:
    """Robots, one a line with what needs attention below it; several after a line on all of them."""
    if len(reports) > 1:
        yield summary(reports)
    for report in reports:
        yield _list_line(report)
        yield from (f"  needs attention: {note}" for note in _attention(report))


def _list_line(report: RobotStatus) -> str:
    """A robot's state, speed, driver, and its gateway's health."""
    words = [report.robot]
    if report.state is None:
        words.append(_offline(report))
    else:
        words += [label_of(word_of(report)[0]), _number(report.state.speed_mps, "+z.2f", "m/s")]
        words += (
            [f"driver {plain(report.safety.lease_holder)}"] if report.safety and report.safety.lease_holder else []
        )
        words += [] if report.connected else ["no liveliness token"]
        words += ["no health"] if report.health is None else []
    words += [_word(fact) for fact in health_facts(report.health)] if report.health is not None else []
    return "  ".join([*words, *([plain(report.newer)] if report.newer else [])])


def _attention(report: RobotStatus) -> list[str]:
    """Everything that somebody has to see to."""
    safety = report.safety
    latched = [] if safety is None else [reason.value.replace("_", " ") for reason in safety.latched]
    by = f" by {plain(', '.join(safety.stopped_by))}" if safety is not None and safety.stopped_by else ""
    notes = [f"{', '.join(latched)}{by}, reset required"] if latched else []
    return notes if report.health is None else [*notes, *map(plain, report.health.notes)]


def panel(report: RobotStatus) -> RenderableType:
    """A robot, large."""
    grid = Table.grid(padding=(0, 2))
    for _ in range(4):
        grid.add_column(no_wrap=False)
    if report.state is not None:
        cells = [text for fact in state_facts(report.state) for text in _cells(fact)]
        for start in range(0, len(cells), 4):
            grid.add_row(*cells[start : start + 4])
        top = Text(f"state {report.state_age_s or 0:.2f} s old", style=GOOD)
    else:
        top = Text(_offline(report), style=LOUD)
    # What is wrong comes first: a small window cuts the rest off.
    safety = [Text(_word(fact), style=fact.style) for fact in safety_facts(report)]
    newer = [Text(plain(report.newer))] if report.newer else []
    return Panel(Group(top, _health_text(report), *safety, *newer, grid), title=Text(report.robot), expand=False)


def table(reports: Sequence[RobotStatus]) -> RenderableType:
    """Robots, one a row: what each does, and whatever is wrong with it."""
    shown = Table(expand=False, title=summary(reports) if len(reports) > 1 else None)
    for label in ("robot", "state", *_TABLE_LABELS, "age"):
        shown.add_column(label, no_wrap=True)
    shown.add_column("wrong")
    for report in reports:
        cells = [Text(NO_VALUE)] * len(_TABLE_LABELS)
        if report.state is not None:
            facts = {fact.label: fact for fact in state_facts(report.state)}
            cells = [Text(facts[label].text, style=facts[label].style) for label in _TABLE_LABELS]
        word, _ = word_of(report)
        state = Text(label_of(word), style=(PLAIN, BAD, LOUD)[WORDS[word]])
        shown.add_row(Text(report.robot), state, *cells, _age(report), _wrong(report))
    return shown if reports else Group(shown, Text("no robot is connected", style=BAD))


_TABLE_LABELS: Final = ("speed", "angle")


def _wrong(report: RobotStatus) -> Text:
    text = Text()
    if report.state is None:
        text.append(_offline(report), style=LOUD)
    facts = [
        *(state_facts(report.state) if report.state else ()),
        *(health_facts(report.health) if report.health else ()),
        *safety_facts(report),
    ]
    wrong = {f"{fact.label} {fact.text}": fact.style for fact in facts if fact.style == BAD}
    if report.state is not None and report.health is None:
        wrong["no health"] = BAD
    for word, style in wrong.items():
        text.append("; " if text else "").append(word, style=style)
    return text


def _offline(report: RobotStatus) -> str:
    return f"OFFLINE: {alarm(report)}"


def _age(report: RobotStatus) -> Text:
    if report.state_age_s is None:
        return Text("never", style=LOUD)
    return Text(f"{report.state_age_s:.1f} s", style=LOUD if report.state is None else GOOD)


def _cells(fact: Fact) -> tuple[Text, Text]:
    return Text(fact.label, style="dim"), Text(fact.text, style=fact.style)


def _word(fact: Fact) -> str:
    return fact.text if fact.label in {"speed", "angle"} else f"{fact.label} {fact.text}"


def _health_text(report: RobotStatus) -> Text:
    if report.health is None:
        age = "yet" if report.health_age_s is None else f"for {report.health_age_s:.1f} s"
        return Text(f"no health {age}", style=BAD)
    text = Text()
    for fact in health_facts(report.health):
        text.append(f"{fact.label} ", style="dim").append(f"{fact.text}  ", style=fact.style)
    return text


def _faults_word(report: RobotStatus) -> str:
    if report.health is None:
        return "faults not known: no health"
    return _word(next(fact for fact in health_facts(report.health) if fact.label == "faults"))


def _number(value: float | None, form: str, unit: str) -> str:
    return NO_VALUE if value is None else f"{value:{form}} {unit}"


def _bumpers(state: RobotState, hit: list[str]) -> str:
    if hit:
        return " and ".join(hit) + " HIT"
    return NO_VALUE if state.front_bumper is None or state.rear_bumper is None else "clear"


def _lamps(lamps: Iterable[tuple[str, bool | None]]) -> str:
    values = dict(lamps)
    if all(value is None for value in values.values()):
        return NO_VALUE
    return ", ".join(name for name, on in values.items() if on) or "off"
