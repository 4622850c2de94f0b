"""The view of a person who drives. Pure."""

from __future__ import annotations

import msgspec
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.text import Text

from gateway.cli.held_keys import Wish
from gateway.client.link import Sighting
from gateway.client.reasons_text import link_line, reason_line, state_line
from gateway.client.view import BAD, GOOD, LOUD, NO_VALUE
from schemas.command_line import plain
from schemas.decisions import ArbiterState


class Cockpit(msgspec.Struct, frozen=True):
    """All that is shown.

    Attributes:
        lease: its number.
        speed_mps, angle_deg: the target of a held key.
        wish: the motion that the held key asks for.
        message: the last one for the person.
    """

    robot: str
    lease: int
    sighting: Sighting
    speed_mps: float
    angle_deg: float
    wish: Wish
    message: str


def panel(cockpit: Cockpit) -> RenderableType:
    """The view."""
    state, chassis = cockpit.sighting.state, cockpit.sighting.chassis
    good = state.state is ArbiterState.ENGAGED
    lines = [
        Text(state_line(state), style=GOOD if good else BAD),
        Text(_speeds(cockpit)),
    ]
    link = link_line(state)
    if link:
        lines.append(Text(link))
    if chassis is not None:
        hit = [side for side, on in (("front", chassis.front_bumper), ("rear", chassis.rear_bumper)) if on]
        text = f"mode {chassis.mode.value}, gear {chassis.gear_position.value}, bumpers {' '.join(hit) or 'clear'}"
        lines.append(Text(text, style=BAD if hit else ""))
    lines += [Text(reason_line(reason, cockpit.robot, state.blocked_by), style=BAD) for reason in state.blocked_by]
    if cockpit.message:
        lines.append(Text(plain(cockpit.message), style=LOUD))
    lines += [Text(text, style="dim") for text in _keys(cockpit)]
    return Panel(Group(*lines), title=Text(f"{cockpit.robot}, lease {cockpit.lease}"), expand=False)


def _speeds(cockpit: Cockpit) -> str:
    state, chassis = cockpit.sighting.state, cockpit.sighting.chassis
    measured = NO_VALUE if chassis is None or chassis.speed_mps is None else f"{chassis.speed_mps:+z.2f} m/s"
    asked = (
        f"{cockpit.speed_mps * cockpit.wish.forward:+z.2f} m/s {cockpit.angle_deg * cockpit.wish.left:+z.0f} deg"
    )
    told = f"{state.output_speed_mps:+z.2f} m/s {state.output_angle_deg:+z.0f} deg"
    return f"asked {asked}, told {told}, measured {measured}, limit {state.speed_limit_mps:.2f} m/s"


def _keys(cockpit: Cockpit) -> list[str]:
    limit_mps = cockpit.sighting.state.speed_limit_mps
    bound = f", of which the limit leaves {limit_mps:.2f}" if cockpit.speed_mps > limit_mps else ""
    return [
        "hold to move, which begins when the key repeats: w s or arrows, a d steer; any other key: stand",
        "u o forward and m . backward in a curve, to the left and to the right",
        f"+ - speed ({cockpit.speed_mps:.2f} m/s{bound})",
        "g engage, r reset; x, q or Ctrl-C: stop and leave",
    ]
