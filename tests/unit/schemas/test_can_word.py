"""The words of a CAN frame: the C library's header, as Python's socket module has it, is the judge."""

import socket

import pytest
from can.interfaces.socketcan import constants

from schemas import can_word


@pytest.mark.skipif(not hasattr(socket, "CAN_EFF_FLAG"), reason="only Linux has linux/can.h")
def test_the_flags_are_those_of_the_kernel() -> None:
    """Another value would turn one kind of frame into another."""
    assert (can_word.EXTENDED, can_word.REMOTE, can_word.ERROR) == (
        socket.CAN_EFF_FLAG,
        socket.CAN_RTR_FLAG,
        socket.CAN_ERR_FLAG,
    )
    assert (can_word.IDENTIFIER_MASK, can_word.STANDARD_MASK) == (socket.CAN_EFF_MASK, socket.CAN_SFF_MASK)


def test_the_fd_flags_are_those_of_the_kernel() -> None:
    """As python-can writes them to a kernel's socket."""
    assert (can_word.FD, can_word.BITRATE_SWITCH, can_word.ERROR_STATE_INDICATOR) == (
        constants.CANFD_FDF,
        constants.CANFD_BRS,
        constants.CANFD_ESI,
    )
