"""The profiles of thin links: what is in each, and the rules that Zenoh gets."""

import pytest

from schemas.command_line import CommandError
from schemas.configuration import TomlSource, merge
from schemas.settings import DOWNSAMPLING, FULL, OPERATOR, PROFILES, PUBLISHED, THIN, rate_in_words, zenoh_rules

NEEDED = {"safety/state", "safety/event", "state", "gateway/health", "authority/statement"}
"""Subjects without which nobody sees how a robot is, or who may command it."""


@pytest.mark.parametrize("profile", PROFILES)
def test_a_profile_names_subjects_that_are_published(profile: str) -> None:
    """And leaves out none without which a robot cannot be seen."""
    assert PROFILES[profile].keys() <= {subject.name for subject in PUBLISHED}
    assert {subject.name for subject in PUBLISHED if PROFILES[profile].get(subject.name) != 0} >= NEEDED


def test_events_are_never_reduced_nor_what_an_operator_drives_by() -> None:
    """The state of the arbiter, which holds the challenge to echo, comes as often as a drive command is sent."""
    assert all("safety/event" not in rates for rates in PROFILES.values())
    assert PROFILES[OPERATOR]["safety/state"] >= 20
    assert "safety/decision" not in PROFILES[OPERATOR]


def test_each_profile_is_thinner_than_the_one_before() -> None:
    """In every subject."""
    for thick, thin in ((FULL, OPERATOR), (OPERATOR, THIN)):
        for subject in PUBLISHED:
            before, after = (PROFILES[one].get(subject.name, 1e9) for one in (thick, thin))
            assert after <= before, subject.name


def test_no_two_rules_fit_one_key() -> None:
    """Zenoh uses any one of those that fit."""
    for item in zenoh_rules(["*=thin", "wwan0=operator"], "fleet", "r-1")[DOWNSAMPLING]:
        keys = [rule["key_expr"] for rule in item["rules"]]
        assert len(set(keys)) == len(keys)
        assert all(key.startswith("fleet/r-1/") for key in keys)
        assert not any("**" in key for key in keys)


def test_rules_are_those_of_the_interface_at_the_robots_end_of_what_leaves() -> None:
    """Without a profile there are none, and nothing else of a session changes."""
    assert zenoh_rules([], "fleet", "r-1") == {}
    assert zenoh_rules(["wwan0=full"], "fleet", "r-1") == {}
    rules = zenoh_rules(["wwan0=operator", "*=thin"], "fleet", "r-1")[DOWNSAMPLING]
    assert [one.get("interfaces") for one in rules] == [["wwan0"], ["wwan0"], None, None]
    assert len({one["id"] for one in rules}) == 4
    assert all(one["flows"] == ["egress"] for one in rules)
    for item in rules:
        is_left_out = {rule["freq"] == 0 for rule in item["rules"]}
        assert is_left_out == {"reply" in item["messages"]}, "replies of what leaves are never reduced"


@pytest.mark.parametrize(
    "wrong", ["thin", "wwan0", "wwan0=thick", "=thin", "a=b=thin", "much-too-long-a-name=thin"]
)
def test_what_is_no_profile_of_an_interface_is_an_error(wrong: str) -> None:
    """At the start, in one line."""
    with pytest.raises(CommandError, match=r"zenoh\.profiles"):
        merge(TomlSource("", f'[zenoh]\nprofiles = ["{wrong}"]\n'), {}, {})


def test_profiles_come_from_the_environment_too() -> None:
    """A list, as everywhere."""
    found = merge(None, {"CRUISER_ZENOH_PROFILES": "wwan0=thin,*=operator"}, {})
    assert found.zenoh.profiles == ["wwan0=thin", "*=operator"]


def test_rates_are_told_in_words() -> None:
    """For the table of the documents."""
    said = [rate_in_words(THIN, name) for name in ("safety/event", "journal", "state", "gateway/health")]
    assert said == ["all", "none", "at most 2 Hz", "every 2 s at most"]
