"""The gateway's health, each second."""

from gateway.telemetry.health import OTHER_IDENTIFIERS, UNKNOWN_IDENTIFIERS_MAX, HealthMeter, Links
from schemas.messages import GatewayHealth, Variant

SECOND_NS = 10**9


def report(meter: HealthMeter, now_ns: int, *, cpu_ns: int = 0, frames: int = 0) -> GatewayHealth:
    return meter.report(now_ns, 0, Links(cpu_ns=cpu_ns), Variant.COARSE, frames, [])


def test_rates_are_those_since_the_last_report() -> None:
    """Processor time and frames are told for the last interval alone, and an idle one is 0."""
    meter = HealthMeter("0", "can0", 0)
    first = report(meter, SECOND_NS, cpu_ns=400_000_000, frames=630)
    second = report(meter, 3 * SECOND_NS, cpu_ns=600_000_000, frames=830)
    third = report(meter, 4 * SECOND_NS, cpu_ns=600_000_000, frames=830)
    assert [health.cpu_percent for health in (first, second, third)] == [40.0, 10.0, 0.0]
    assert [health.frames_per_s for health in (first, second, third)] == [630.0, 100.0, 0.0]
    assert [health.frames for health in (first, second, third)] == [630, 830, 830]
    assert [health.sequence for health in (first, second, third)] == [0, 1, 2]


def test_lateness_is_that_since_the_last_report_but_for_the_worst() -> None:
    """The quantiles begin anew with each report; the worst is that since the start."""
    meter = HealthMeter("0", "can0", 0)
    for late_ms in range(1, 101):
        meter.tick_lateness(late_ms * 1_000_000)
    first = report(meter, SECOND_NS)
    meter.tick_lateness(2_000_000)
    second = report(meter, 2 * SECOND_NS)
    assert (first.tick_lateness_p50_ms, first.tick_lateness_p99_ms, first.tick_lateness_max_ms) == (51, 100, 100)
    assert (second.tick_lateness_p50_ms, second.tick_lateness_max_ms) == (2, 2)
    assert (first.tick_lateness_worst_ms, second.tick_lateness_worst_ms) == (100, 100)


def test_strangers_are_counted_by_name_up_to_a_number() -> None:
    """A bus full of unknown identifiers does not fill the memory: those beyond it share one count."""
    meter = HealthMeter("0", "can0", 0)
    for can_id in (*range(UNKNOWN_IDENTIFIERS_MAX + 10), 0):
        meter.unknown_identifier(can_id)
    counted = report(meter, SECOND_NS).unknown_identifiers
    assert len(counted) == UNKNOWN_IDENTIFIERS_MAX + 1
    assert counted[OTHER_IDENTIFIERS] == 10
    assert sum(counted.values()) == UNKNOWN_IDENTIFIERS_MAX + 11


def test_the_ends_of_certificate_and_grant_are_told_where_there_are_any() -> None:
    """In nanoseconds, like every time of a message; in open mode both are null."""
    meter = HealthMeter("0", "can0", 0)
    links = Links(certificate_ends_s=1_800_000_000, grant_ends_s=1_800_000_001)
    health = meter.report(SECOND_NS, 0, links, Variant.COARSE, 0, [])
    assert (health.certificate_ends_ns, health.grant_ends_ns) == (1_800_000_000 * 10**9, 1_800_000_001 * 10**9)
    health = report(meter, 2 * SECOND_NS)
    assert (health.certificate_ends_ns, health.grant_ends_ns) == (None, None)
