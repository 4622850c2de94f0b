"""The edge process: telemetry out, commands in.

Two flows, which touch once::

    TELEMETRY  CAN bus > frame > check and decode > message > sample > zenoh > recorder > MCAP > review
                                                       |
                                                       v chassis state
    COMMAND    zenoh > request > arbiter > decision > encode > gate > frame > CAN bus

``core`` has both on one page, without I/O and without a clock; ``loop`` is the one thread that runs them. What a
frame means is in ``chassis``, what is published of it in ``telemetry``. The command flow is in ``command``:
``flow`` has its steps, ``arbiter`` judges each request, and ``gate`` looks at each frame once more before it is
sent. ``guard`` is a second process, which stops the robot when this one dies or hangs. ``can``, ``zenoh`` and
``host`` touch the world: the bus, the network, the computer of the robot. ``client`` is the operator's library,
``sim`` a virtual chassis, ``rerun`` runs a recorded journal again, and ``cli`` has the commands.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gateway.client.refusal import LeaseLost, Refused, Stopped, Unreachable
    from gateway.client.robot import Robot
    from schemas.command_line import CommandError

__all__ = ["CommandError", "LeaseLost", "Refused", "Robot", "Stopped", "Unreachable"]


def __getattr__(name: str) -> object:
    """``from gateway import Robot``: loaded when it is asked for, because the guard's process needs no Zenoh."""
    if name in __all__:
        from gateway.client import robot  # noqa: PLC0415 - as said

        return getattr(robot, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
