"""The messages of an MCAP file one by one, and the records around them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

from recorder.mcap.reader import DamagedError, Fault, LoggedMessage, MessageBlock, PackedChunk, Piece, read_pieces


def walk(stream: BinaryIO, size: int) -> Iterator[Piece | LoggedMessage]:
    for piece in read_pieces(stream, size):
        if isinstance(piece, PackedChunk):
            try:
                yield from piece.unpack().messages()
            except DamagedError as error:
                yield Fault(piece.offset, str(error))
        elif isinstance(piece, MessageBlock):
            yield from piece.messages()
        else:
            yield piece
