"""The edge process: telemetry out, commands in.

Two flows, which touch once::

    TELEMETRY  CAN bus > frame > check and decode > message > sample > zenoh > recorder > MCAP > review
                                                       |
                                                       v chassis state
    COMMAND    zenoh > request > arbiter > decision > encode > gate > frame > CAN bus

``core`` has both on one page, without I/O and without a clock; ``loop`` is the one thread that runs them.
``chassis`` defines the frames, ``telemetry`` publishes them. The command flow is in ``command``: ``flow`` has its
steps, ``arbiter`` judges each request, and the chassis's ``gate`` checks each frame before it is sent. ``guard``
is a second process that stops the robot when this one dies or hangs. ``can``, ``zenoh`` and ``host`` do the I/O:
the bus, the network, the robot's computer. ``client`` is the operator's library, ``sim`` a virtual chassis,
``rerun`` runs a recorded journal again, and ``cli`` has the commands.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gateway.client.refusal import LeaseLost, Refused, Stopped, Unreachable
    from gateway.client.robot import Robot
    from schemas.command_line import CommandError

__all__ = ["CommandError", "LeaseLost", "Refused", "Robot", "Stopped", "Unreachable"]


def __getattr__(name: str) -> object:
    """Load ``Robot`` and others on first use, because the guard's process needs no Zenoh."""
    if name in __all__:
        from gateway.client import robot  # noqa: PLC0415 - as said

        return getattr(robot, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
