"""The flags by which ``cruiser provision sign`` says what is granted, and a grant in words."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import Final

from gateway.authority.enrolment import EnrolmentRequest, EnrolmentRole
from gateway.provisioning.issuer import Wanted
from schemas.authority.proof import Grant, GrantRole
from schemas.authority.trust import in_utc
from schemas.command_line import CommandError, ExitCode
from schemas.subjects import BY_VERB, STOP_VERB

HOUR_S, DAY_S = 3600, 86_400

PERSON_S, OTHERS_S = 12 * HOUR_S, 90 * DAY_S
"""The duration of a grant without ``--lasts``, seconds."""

ROBOT_VERBS: Final = [verb for verb in BY_VERB if verb != STOP_VERB]
"""Verbs that want a grant: a stop wants none."""

PERSONS: Final = (GrantRole.OPERATOR, GrantRole.PROGRAM, GrantRole.SUPERVISOR)

_SPEED_MAX_MPS: Final = 100
_LIFE_MAX_S: Final = 3653 * DAY_S

_GRANT_FLAGS: Final = ("robots", "verbs", "role", "override", "speed_limit")
_FOR_ALL: Final = {"robots"}


def add_grant_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags that ``wanted_grant`` reads."""
    grant = parser.add_argument_group(
        "grant", "what is not said is as in the last grant of the same key, or usual"
    )
    grant.add_argument(
        "--robots",
        action="append",
        type=matching("[a-z0-9*-]{1,64}", "no pattern of robots: lower case, digits, '-' and '*'"),
        metavar="PATTERN",
        help="such as 'depot-*'; may be repeated (all)",
    )
    grant.add_argument("--verbs", type=_verbs, metavar="LIST", help="with commas (all)")
    grant.add_argument(
        "--role",
        choices=[role.value for role in PERSONS],
        metavar="ROLE",
        help="operator (the default), program or supervisor",
    )
    grant.add_argument("--override", action="store_true", help="may take the lease of a robot that moves")
    grant.add_argument("--speed-limit", type=_speed, metavar="M/S", help="no robot drives faster for this holder")
    lasts = grant.add_mutually_exclusive_group()
    lasts.add_argument("--hours", dest="lasts", type=_times(HOUR_S), metavar="H", help="a person's life (12)")
    lasts.add_argument("--days", dest="lasts", type=_times(DAY_S), metavar="D", help="all others' (90)")


def wanted_grant(arguments: argparse.Namespace, request: EnrolmentRequest, last: Grant | None) -> Wanted:
    """Return the grant that the flags ask for; where they are silent, as the same key had it, or else the usual.

    Args:
        arguments: as ``add_grant_arguments`` declares them.
        request: the applicant's.
        last: the last grant to the same key; None if there was none.

    Raises:
        CommandError: a flag does not fit the applicant's role.
    """
    given = [name for name in _GRANT_FLAGS if getattr(arguments, name) not in (None, False)]
    if request.role is not EnrolmentRole.OPERATOR and set(given) - _FOR_ALL:
        flags = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise CommandError(f"{flags}: nothing of that is for a {request.role.value}", ExitCode.USAGE)
    usual_s = PERSON_S if request.role in {EnrolmentRole.OPERATOR, EnrolmentRole.VIEWER} else OTHERS_S
    usual = [] if request.role is EnrolmentRole.RECORDER else ROBOT_VERBS
    last_role = last.role if last and last.role in PERSONS else GrantRole.OPERATOR
    return Wanted(
        verbs=arguments.verbs or (last.verbs if last else usual),
        robots=arguments.robots or (last.robots if last else ["*"]),
        lasts_s=usual_s if arguments.lasts is None else round(arguments.lasts),
        role=GrantRole(arguments.role) if arguments.role else last_role,
        override=arguments.override or (last is not None and last.override),
        speed_limit_mps=arguments.speed_limit or (last.speed_limit_mps if last else None),
    )


def unlimited_warning(arguments: argparse.Namespace, request: EnrolmentRequest, last: Grant | None) -> str:
    """Return a warning that all is granted because the key was never let in here; empty if it is not so.

    The list of who was let in is the authority's own: a new authority knows none of the former's limits.
    """
    is_limited = arguments.robots or arguments.verbs or arguments.speed_limit is not None
    if last is not None or is_limited or request.role is not EnrolmentRole.OPERATOR:
        return ""
    return (
        "nothing is known of this key here: all robots, all verbs, no speed limit; --robots and --speed-limit "
        "narrow it"
    )


def grant_line(grant: Grant) -> str:
    """A grant, for people."""
    limit = "" if grant.speed_limit_mps is None else f", at most {grant.speed_limit_mps:g} m/s"
    override = ", may override" if grant.override else ""
    verbs = "all" if set(grant.verbs) >= set(ROBOT_VERBS) else ", ".join(grant.verbs)
    may = f"{grant.role.value} on {', '.join(grant.robots)}" + (f", verbs {verbs}" if verbs else "")
    return f"{may}{limit}{override}, until {in_utc(grant.not_after)}"


def matching(pattern: str, what: str) -> Callable[[str], str]:
    """An argument that matches a pattern; of another one is said what it is."""

    def checked(text: str) -> str:
        if re.fullmatch(pattern, text) is None:
            raise argparse.ArgumentTypeError(f"{text!a} is {what}")
        return text

    return checked


def _verbs(text: str) -> list[str]:
    names = ROBOT_VERBS if text == "all" else list(dict.fromkeys(text.split(",")))
    unknown = [name for name in names if name not in ROBOT_VERBS]
    if unknown:
        raise argparse.ArgumentTypeError(
            f"{unknown[0]!a} is no verb of a robot; there are {', '.join(ROBOT_VERBS)}"
        )
    return names


def _speed(text: str) -> float:
    return _number(text, _SPEED_MAX_MPS, f"no speed in m/s, above 0 and up to {_SPEED_MAX_MPS}")


def _times(unit_s: int) -> Callable[[str], float]:
    def life(text: str) -> float:
        unit = "hours" if unit_s == HOUR_S else "days"
        most = _LIFE_MAX_S // unit_s
        return max(1, _number(text, most, f"no number of {unit}, above 0 and up to {most}") * unit_s)

    return life


def _number(text: str, most: float, otherwise: str) -> float:
    """A number above 0 and not above ``most``.

    Raises:
        argparse.ArgumentTypeError: it is none; the text is what ``otherwise`` calls it.
    """
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value <= most:
        raise argparse.ArgumentTypeError(f"{text!a} is {otherwise}")
    return value
