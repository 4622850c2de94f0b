"""The versions of the command rules."""

from schemas.journal import CHANGES, COMMAND_RULES, rules_notice


def test_every_version_of_the_rules_says_what_it_changed() -> None:
    """From the second on: the first one changed nothing."""
    assert list(CHANGES) == list(range(2, COMMAND_RULES + 1))


def test_under_the_rules_of_today_there_is_nothing_to_notice() -> None:
    """The same inputs give the same decisions."""
    assert rules_notice(COMMAND_RULES) == ""


def test_what_was_made_under_other_rules_says_what_has_changed_since() -> None:
    """Logs from before the rules had a number were made under rules 1."""
    notice = rules_notice(0)
    assert notice == rules_notice(1)
    assert notice.startswith(f"made under rules 1, today's are {COMMAND_RULES}: ")
    assert all(text in notice for text in CHANGES.values())
    assert notice.endswith("differences are expected")


def test_rules_of_a_newer_version_are_noticed_too() -> None:
    """Though nobody here knows what they changed."""
    assert rules_notice(COMMAND_RULES + 1).startswith(f"made under rules {COMMAND_RULES + 1}, today's are ")
