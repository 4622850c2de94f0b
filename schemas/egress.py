"""Profiles of thin links: of each the subjects that leave a robot seldom or not at all, as rules for Zenoh. Pure.

Zenoh itself leaves samples out, at the robot's end of the links that are named: whoever is connected by another
link gets everything. Replies, and with them history, are left out only of subjects that do not leave at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from schemas import keys
from schemas.subjects import SUBJECTS, Pattern

FULL, OPERATOR, THIN = "full", "operator", "thin"

_RAW: Final = ("can/{bus}/rx", "can/{bus}/tx", "journal")
_DECODED: Final = tuple(subject.name for subject in SUBJECTS if subject.name.startswith("chassis/"))

PROFILES: Final[dict[str, dict[str, float]]] = {
    FULL: {},
    OPERATOR: dict.fromkeys((*_RAW, *_DECODED), 0.0) | {"state": 10.0, "safety/state": 25.0},
    THIN: dict.fromkeys((*_RAW, *_DECODED, "safety/decision"), 0.0)
    | {"state": 2.0, "safety/state": 2.0, "gateway/health": 0.5},
}
"""Of each profile the highest rates in Hz, by subject: 0 leaves it out, and what is not named leaves as it is."""

EVERY_INTERFACE: Final = "*"

PROFILE_PATTERN: Final = rf"^([^=/\s]{{1,15}}|\*)=({FULL}|{OPERATOR}|{THIN})\Z"
"""The form of ``zenoh.profiles``: an interface of Linux, and its profile."""

DOWNSAMPLING: Final = "downsampling"
"""The path of the rules in Zenoh's configuration."""

EARLY: Final = 1.1
"""Zenoh lets a sample pass if the last one was a period before: the rules' are shorter, for some come early."""

SEND_BUFFER_BYTES: Final = 16_384
"""The system's send buffer of each link of a robot with a profile; Linux doubles it.

No priority overtakes what is in it, and by itself Linux lets it grow to seven seconds of a link of 0.5 Mbit/s.
"""

SEND_BATCH_BYTES: Final = 16_384
"""Such a robot's Zenoh sends so much at a time. No priority overtakes a batch that is being sent, and Zenoh's own
64 KiB take a second of that link."""

SEND_BATCHES: Final = 16
"""So many of them, the most that Zenoh allows, wait in the queues of replies that nobody hurries for.

Who a gateway is takes 100 kB, and a reply that does not fit into its queue is dropped.
"""

LINK_SETTINGS: Final = {
    "transport/link/tcp/so_sndbuf": SEND_BUFFER_BYTES,
    "transport/link/tls/so_sndbuf": SEND_BUFFER_BYTES,
    "transport/link/tx/batch_size": SEND_BATCH_BYTES,
    "transport/link/tx/queue/size/data": SEND_BATCHES,
    "transport/link/tx/queue/size/data_low": SEND_BATCHES,
}
"""By their paths in Zenoh's configuration."""


def zenoh_rules(profiles: Sequence[str], root: str, robot: str) -> dict[str, Any]:
    """Return the entries of Zenoh's configuration for a robot's session, by path; none without a profile.

    Args:
        profiles: of the form ``INTERFACE=PROFILE``.
        root: first chunks of the robot's keys.
        robot: its name.
    """
    items: list[dict[str, Any]] = []
    for number, one in enumerate(profiles):
        interface, _, profile = one.rpartition("=")
        rates = PROFILES[profile]
        for name, messages, rules in (
            ("slower", ["put"], [_rule(root, robot, subject, hz) for subject, hz in rates.items() if hz]),
            (
                "none",
                ["put", "reply"],
                [_rule(root, robot, subject, 0) for subject, hz in rates.items() if not hz],
            ),
        ):
            if rules:
                where = {} if interface == EVERY_INTERFACE else {"interfaces": [interface]}
                items.append(
                    {
                        "id": f"profile-{number}-{name}",
                        "flows": ["egress"],
                        "messages": messages,
                        "rules": rules,
                        **where,
                    }
                )
    return {DOWNSAMPLING: items, **LINK_SETTINGS} if items else {}


def _rule(root: str, robot: str, subject: str, hz: float) -> dict[str, Any]:
    return {"key_expr": f"{root}/{robot}/{subject.format(bus=keys.ALL)}", "freq": hz * EARLY}


def rate_in_words(profile: str, subject: str) -> str:
    """A subject's rate in a profile, for people."""
    hz = PROFILES[profile].get(subject)
    if hz is None:
        return "all"
    if not hz:
        return "none"
    return f"at most {hz:g} Hz" if hz >= 1 else f"every {1 / hz:g} s at most"


PUBLISHED: Final = tuple(subject for subject in SUBJECTS if subject.pattern is Pattern.PUBLISHED)
