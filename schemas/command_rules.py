"""The versions of the rules by which the arbiter decides.

The same inputs give the same decisions under the same rules alone. A journal names the rules under which it was
made, so that whoever runs it again under others knows that differences are to be expected.
"""

from __future__ import annotations

from typing import Final

COMMAND_RULES: Final = 2
"""The rules of this version. To be raised, with a row below, by every change that decides something otherwise."""

_UNNUMBERED: Final = 0
"""What journals hold that were made under the rules 1, before these had a number."""

CHANGES: Final[dict[int, str]] = {
    2: "drive and engage echo a challenge instead of a tick, so all of before are refused as malformed; "
    "the speed is bounded by the age of the commands; commands up to 1 s old are accepted",
}
"""What each version of the rules changed."""


def rules_notice(rules: int) -> str:
    """What to expect of a journal that was made under these rules; empty if they are those of this version."""
    if rules == COMMAND_RULES:
        return ""
    made = max(rules, _UNNUMBERED + 1)
    changes = "; ".join(text for number, text in CHANGES.items() if number > made)
    what = changes or "this version does not know what that changed"
    return f"made under rules {made}, today's are {COMMAND_RULES}: {what}; differences are expected"
