"""Samples in, metrics out; the table against the messages' fields; and the command's extra."""

from __future__ import annotations

import sys

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta
from prometheus_client.parser import text_string_to_metric_families

from gateway.cli import metrics
from gateway.client.fleet import HEALTH_STALE_NS
from gateway.metrics import BOUNDS, GAP_MAX, INFO, LABEL_LENGTH_MAX, LABELS_MAX, MEASURES, Measure, bounded
from gateway.telemetry.samples import Missed
from schemas.command_line import CommandError
from schemas.configuration import attribute_texts
from schemas.messages import SEQUENCE_MAX, UNIT_KEYWORD
from tests.support.commands import run_command
from tests.support.messages import HEALTH, STANDBY, STATE, recorder_health
from tests.support.metrics import (
    FULL,
    START_NS,
    WALL_S,
    exposition,
    fleet,
    full_exposition,
    received,
    series,
    token,
)

R = 'robot="cruiser-1"'
UP = f"cruiser_up{{{R}}}"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (UP, 1),
        (f"cruiser_gateway_connected{{{R}}}", 1),
        (f"cruiser_last_health_timestamp_seconds{{{R}}}", WALL_S),
        (f'cruiser_gateway_info{{bus="can0",{R},version="0.1.0"}}', 1),
        (f"cruiser_gateway_frames_total{{{R}}}", 630),
        (f'cruiser_gateway_faults_total{{kind="checksum",{R}}}', 2),
        (f"cruiser_gateway_tick_lateness_max_seconds{{{R}}}", 0.0003),
        (f"cruiser_gateway_certificate_ends_timestamp_seconds{{{R}}}", 1_800_000_000.5),
        (f'cruiser_feedback_valid_total{{frame="Auto_GearFeedBack",{R}}}', 99),
        (f'cruiser_safety_state{{{R},state="standby"}}', 1),
        (f'cruiser_safety_latched{{reason="guard",{R}}}', 1),
        (f"cruiser_safety_lease_held{{{R}}}", 1),
        (f"cruiser_chassis_total_mileage_meters{{{R}}}", 12345),
        ('cruiser_recorder_dropped_total{reason="disk",recorder="depot"}', 4),
        ("cruiser_exporter_certificate_ends_timestamp_seconds", 1_800_000_000),
    ],
)
def test_what_was_said_is_shown_in_base_units(name: str, value: float) -> None:
    assert series(fleet(token(), *map(received, FULL)))[name] == pytest.approx(value)


def test_nobodys_name_and_no_free_text_is_a_label() -> None:
    text = full_exposition()
    assert STANDBY.lease_holder == "first"
    assert '"first"' not in text


def test_a_silent_robot_has_no_values_but_that_it_is_silent() -> None:
    metrics = fleet(token(), *map(received, FULL))
    now_ns = START_NS + HEALTH_STALE_NS - 1
    assert series(metrics, now_ns)[UP] == 1
    left = {name: value for name, value in series(metrics, now_ns + 1).items() if R in name}
    assert left.pop(UP) == 0
    assert left.pop(f"cruiser_gateway_connected{{{R}}}") == 1
    assert left.pop(f"cruiser_last_health_timestamp_seconds{{{R}}}") == WALL_S
    assert all(name.startswith("cruiser_samples_") for name in left)


def test_a_token_alone_is_a_robot_that_is_silent() -> None:
    shown = series(fleet(token()))
    assert (shown[UP], shown[f"cruiser_gateway_connected{{{R}}}"]) == (0, 1)
    assert series(fleet(token(), token(present=False)))[f"cruiser_gateway_connected{{{R}}}"] == 0


def unreadable(shown: dict[str, float], subject: str) -> dict[str, float]:
    """Count unreadable samples of the robot by reason."""
    return {
        reason: shown[f'cruiser_samples_unreadable_total{{reason="{reason}",{R},subject="{subject}"}}']
        for reason in ("newer", "older", "damaged")
    }


@pytest.mark.parametrize(
    ("version", "reason"), [("9", "newer"), ("0", "older"), ("1", "damaged"), ("of_another", "damaged")]
)
def test_what_cannot_be_read_is_counted_with_the_reason_and_changes_nothing(version: str, reason: str) -> None:
    bad = received(STATE, encoding=f"application/msgpack;cruiser.RobotState/{version}")
    if version == "1":
        bad = msgspec.structs.replace(bad, payload=b"\x81\xa5speed\xc1")
    shown = series(fleet(received(STATE), bad))
    assert unreadable(shown, "state") == {one: float(one == reason) for one in ("newer", "older", "damaged")}
    assert shown[f'cruiser_samples_received_total{{{R},subject="state"}}'] == 1
    assert shown[f"cruiser_chassis_speed_meters_per_second{{{R}}}"] == STATE.speed_mps


@pytest.mark.parametrize(
    ("sequences", "lost"),
    [
        ([7, 8, 9], 0),
        ([7, 10], 2),
        ([SEQUENCE_MAX - 1, SEQUENCE_MAX, 0, 2], 1),
        ([500, 0, 1], 0),
        ([0, GAP_MAX + 1], GAP_MAX),
        ([0, GAP_MAX + 2, GAP_MAX + 3], 0),
        ([5, 5, 4, 5], 0),
    ],
)
def test_gaps_in_the_sequence_are_losses(sequences: list[int], lost: int) -> None:
    states = [received(msgspec.structs.replace(STATE, sequence=sequence)) for sequence in sequences]
    assert series(fleet(*states))[f'cruiser_samples_lost_total{{{R},subject="state"}}'] == lost


def test_samples_that_were_refused_or_missed_are_counted() -> None:
    names = [f"r{number}" for number in range(BOUNDS.robots)]
    metrics = fleet(*(received(HEALTH, name) for name in names), received(HEALTH), token("e"))
    metrics.receive(Missed(), START_NS, WALL_S)
    shown = series(metrics)
    assert UP not in shown
    assert (shown["cruiser_exporter_refused_total"], shown["cruiser_exporter_overruns_total"]) == (2, 1)


def test_who_was_silent_for_a_week_is_forgotten() -> None:
    metrics = fleet(received(HEALTH), token("hangs"), received(recorder_health()))
    shown = series(metrics, START_NS + BOUNDS.forgotten_ns - 1)
    assert (shown[UP], shown['cruiser_recorder_up{recorder="depot"}']) == (0, 0)
    shown = series(metrics, START_NS + BOUNDS.forgotten_ns)
    assert [name for name in shown if "_up" in name] == ['cruiser_up{robot="hangs"}']


def unique(text: str) -> bool:
    """Every line is another series, as Prometheus requires."""
    samples = [
        (sample.name, tuple(sorted(sample.labels.items())))
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    ]
    return len(samples) == len(set(samples))


@given(
    names=st.lists(st.text(max_size=100), max_size=100),
    counts=st.dictionaries(st.text(max_size=100), st.integers(0, 2**63 - 1), max_size=100),
    version=st.text(max_size=1000),
)
def test_a_robot_that_makes_things_up_cannot_break_a_scrape(
    names: list[str], counts: dict[str, int], version: str
) -> None:
    feedback = [msgspec.structs.replace(HEALTH.feedback[0], name=name) for name in names]
    made_up = msgspec.structs.replace(
        HEALTH, feedback=feedback, faults=counts, unknown_identifiers=counts, gateway_version=version
    )
    text = exposition(fleet(received(made_up)))
    assert unique(text)
    assert UP in text
    assert len(text) < 1_000_000


def test_all_that_is_served_has_a_help_and_is_there_once() -> None:
    text = full_exposition()
    assert unique(text)
    assert all(family.documentation for family in text_string_to_metric_families(text))


UNITS = {
    "": ("", "", 1),
    "m/s": ("_mps", "_meters_per_second", 1),
    "m/s2": ("_mps2", "_meters_per_second_squared", 1),
    "deg": ("_deg", "_degrees", 1),
    "deg/s": ("_degps", "_degrees_per_second", 1),
    "rad/s": ("_radps", "_radians_per_second", 1),
    "km": ("_km", "_meters", 1e-3),
    "m": ("_m", "_meters", 1),
    "s": ("_s", "_seconds", 1),
    "ms": ("_ms", "_seconds", 1e3),
    "ns": ("_ns", "_timestamp_seconds", 1e9),
    "B": ("_bytes", "_bytes", 1),
    "%": ("_percent", "_ratio", 100),
}
"""By a schema's unit: ending of the field's name, ending of the metric's, and divisor."""

NO_METRIC = {
    # Of every message, and what commands refer to.
    *("time_ns", "sequence", "tick", "accepted_seq", "challenge"),
    # Rates: PromQL makes them of the counters.
    *("frames_per_s", "received_per_s", "rate_hz"),
    # Counts that wrap, a pedal that is never pressed.
    *("rear_left_pulses", "rear_right_pulses", "brake_pedal_percent"),
    # Free text, names, and records with metrics of their own.
    *("bus_detail", "stop_detail", "stopped_by", "name", "recorder", "failures", "notes", "silent", "feedback"),
}

ROWS = [(kind, measure) for kind, measures in MEASURES.items() for measure in measures]


def unit_of(annotation: object) -> str:
    """Return the unit in a field's annotation; empty if it has none."""
    for part in (annotation, *getattr(annotation, "__args__", ())):
        for meta in getattr(part, "__metadata__", ()):
            if isinstance(meta, Meta) and meta.extra_json_schema and UNIT_KEYWORD in meta.extra_json_schema:
                return str(meta.extra_json_schema[UNIT_KEYWORD])
    return ""


@pytest.mark.parametrize(("kind", "measure"), ROWS, ids=lambda one: getattr(one, "name", ""))
def test_a_name_and_its_divisor_say_the_unit_of_the_field(kind: type[msgspec.Struct], measure: Measure) -> None:
    field = next(one for one in msgspec.structs.fields(kind) if one.name == measure.field)
    unit = unit_of(field.type)
    end, base, divisor = UNITS[unit]
    if measure.field != "lease_holder":
        assert measure.name.removesuffix("_total").endswith(measure.field.removesuffix(end) + base)
    assert measure.divisor == divisor
    since = "since the start" in attribute_texts(kind).get(measure.field, "")
    assert measure.is_counter or not since or unit not in {"", "B"}
    assert unit in {"", "B"} or not measure.is_counter


@pytest.mark.parametrize("kind", MEASURES)
def test_each_field_is_a_metric_or_left_out_on_purpose(kind: type[msgspec.Struct]) -> None:
    shown = {measure.field for measure in MEASURES[kind]} | set(INFO[kind][2].values() if kind in INFO else ())
    others = {field.name for field in msgspec.structs.fields(kind)} - shown
    assert others <= NO_METRIC


def test_what_is_no_number_is_left_out() -> None:
    measure = Measure("x", "value", "", "", 1)
    made = msgspec.defstruct("Made", [("value", float | None)])
    assert [list(measure.values(made(value))) for value in (float("nan"), float("-inf"), None)] == [[], [], []]


@given(counts=st.dictionaries(st.text(), st.integers(0, 2**63 - 1), max_size=3 * LABELS_MAX))
def test_labels_that_somebody_makes_up_are_bounded(counts: dict[str, int]) -> None:
    kept = list(bounded(counts))
    labels = [label for label, _ in kept]
    assert len(labels) == len(set(labels)) <= LABELS_MAX + 1
    assert all(label.isprintable() and len(label) <= 10 * LABEL_LENGTH_MAX for label in labels)
    assert sum(count for _, count in kept) == sum(counts.values())


def test_without_its_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("prometheus_client")]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("gateway.cli.metrics_server", "gateway.metrics"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    with pytest.raises(CommandError, match=r"prometheus_client: pip install -e '\.\[metrics\]'"):
        run_command(metrics, stopped=lambda: True)
