"""Which gateways a robot had, one after the other."""

import random

import pytest

from recorder.review.report.account import CHANGES_MAX, MOST, Versions, changed_settings
from recorder.review.report.findings import InForce
from schemas.messages import GatewayInfo, Variant
from tests.support.messages import PERIOD_NS, SECOND, WALL_NS, gateway_info

FAST = "[command]\nspeed_limit_mps = 2.222\n"
SLOW = "[command]\nspeed_limit_mps = 0.6\n"


def heard(*infos: tuple[int, GatewayInfo]) -> Versions:
    """Each was received so many periods after the beginning."""
    versions = Versions()
    for number, info in infos:
        versions.hear(info, WALL_NS + number * PERIOD_NS)
    return versions


def noted(info: GatewayInfo) -> dict[str, str]:
    """The same as a recorder's metadata have it."""
    return {
        "variant": info.variant.value,
        "started_ns": str(info.started_ns),
        "configuration_sha256": info.configuration_sha256,
        **{f"versions.{name}": version for name, version in info.versions.items()},
    }


def since(found: list[InForce]) -> list[int]:
    """The periods."""
    return [(one.since_ns - WALL_NS) // PERIOD_NS for one in found]


def test_each_gateway_is_told_with_what_is_otherwise() -> None:
    """Since when, and which settings."""
    found = heard(
        (2, gateway_info(0, FAST)), (60, gateway_info(50, SLOW)), (95, gateway_info(90, SLOW))
    ).in_force()
    assert since(found) == [0, 50, 90]
    assert [one.settings for one in found] == [[], ["command.speed_limit_mps 0.6, 2.222 before"], []]


def test_other_packages_and_another_variant_are_told() -> None:
    """None is lost because another came."""
    first = gateway_info(0, versions={"cruiser-gateway": "0.1.0", "python": "3.11.7"})
    second = gateway_info(50, versions={"cruiser-gateway": "0.2.0", "cantools": "45"}, variant=Variant.FINE)
    found = heard((0, first), (50, second)).in_force()
    assert [one.versions for one in found] == [first.versions, second.versions]
    assert [one.variant for one in found] == ["coarse", "fine"]


def test_a_gateway_that_learns_its_variant_is_one() -> None:
    """It is asked again until it knows; in whatever order the answers stand."""
    answers = [(1, gateway_info(0, variant=Variant.UNKNOWN)), (5, gateway_info(0)), (9, gateway_info(0))]
    for seed in range(6):
        random.Random(seed).shuffle(answers)  # noqa: S311 - an order, no secret
        (found,) = heard(*answers).in_force()
        assert (found.variant, found.since_ns) == ("coarse", WALL_NS)


def test_a_variant_that_changes_while_the_gateway_runs_holds_since_then() -> None:
    """The chassis was changed."""
    found = heard((1, gateway_info(0)), (70, gateway_info(0, variant=Variant.FINE))).in_force()
    assert since(found) == [0, 70]
    assert [one.variant for one in found] == ["coarse", "fine"]


def test_the_recorders_metadata_tell_the_same() -> None:
    """Where the answers are not among what was asked about; both together are no more than one."""
    versions = Versions()
    for info in (gateway_info(0, FAST), gateway_info(50, SLOW)):
        versions.read(noted(info))
    bare = versions.in_force()
    assert since(bare) == [0, 50]
    assert [one.settings for one in bare] == [[], []]
    versions.hear(gateway_info(50, SLOW), WALL_NS + 51 * PERIOD_NS)
    assert versions.in_force() == bare


def test_times_are_the_recorders_where_the_clocks_differ() -> None:
    """And never later than the gateway was heard."""
    versions = heard((200, gateway_info(0)))
    assert versions.in_force(3 * SECOND)[0].since_ns == WALL_NS + 3 * SECOND
    assert versions.in_force(3600 * SECOND)[0].since_ns == WALL_NS + 200 * PERIOD_NS
    assert versions.in_force(-2 * WALL_NS)[0].since_ns == 0


def test_gateways_outside_of_the_period_are_left_out() -> None:
    """The one that was there when it began is not; what is otherwise is told of those that are left."""
    versions = heard(*((number, gateway_info(number, f"a = {number}\n")) for number in (0, 50, 90)))
    for from_s, to_s, kept in ((0, 60, [0, 50]), (60, 80, [50]), (60, 95, [50, 90]), (91, 200, [90])):
        found = versions.in_force(0, WALL_NS + from_s * PERIOD_NS, WALL_NS + to_s * PERIOD_NS)
        assert since(found) == kept
        assert not found[0].settings


def test_metadata_of_no_sense_are_passed_over() -> None:
    """Anybody can write a log."""
    versions = Versions()
    for started in ("", "x", "-5", "1" * 5000, str(2**64)):
        versions.read({"started_ns": started})
    assert versions.in_force() == []


def test_gateways_without_end_are_counted() -> None:
    """The first ones are kept."""
    versions = heard(*((number, gateway_info(number)) for number in range(MOST + 5)))
    assert (len(versions.in_force()), versions.left_out) == (MOST, 5)


@pytest.mark.parametrize("text", ["", "no TOML", "a = [" * 5000, "a = 1\na = 2\n"])
def test_a_configuration_that_cannot_be_read_tells_no_settings(text: str) -> None:
    """That it is another one is told all the same."""
    assert changed_settings(text, FAST) == changed_settings(FAST, text) == []
    found = heard((0, gateway_info(0, text)), (50, gateway_info(50, FAST))).in_force()
    assert found[0].configuration_sha256 != found[1].configuration_sha256


def test_settings_are_compared_whole_and_shown_short() -> None:
    """Those that are only in one of the two are told, too."""
    assert changed_settings("a.b = 1\nc = [1]\n", "a.b = 1\nd = true\n") == [
        "c not set, [1] before",
        "d True, not set before",
    ]
    (said,) = changed_settings(f"a = '{'x' * 500}1'\n", f"a = '{'x' * 500}2'\n")
    assert len(said) < 200
    many = [gateway_info(number, "".join(f"s{key} = {number}\n" for key in range(100))) for number in (0, 50)]
    assert heard((0, many[0]), (50, many[1])).in_force()[1].settings[CHANGES_MAX:] == [
        f"and {100 - CHANGES_MAX} more"
    ]
