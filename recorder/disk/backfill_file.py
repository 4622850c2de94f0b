"""The logs of what was missing: written as parts beside the logs that lack it, and renamed when they are whole."""

from __future__ import annotations

import os
from io import FileIO
from pathlib import Path
from typing import Final

from recorder.backfill.backfilling import BACKFILLED_FROM
from recorder.backfill.excerpt import LoggedBytes
from recorder.disk.log_directory import PART_SUFFIX, SUFFIX, free_path, lock, start_in_name
from recorder.disk.part_file import clear_errors, sync_directory
from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import ChunkBuilder
from recorder.mcap.writer import McapFile

BACKFILL_NAME: Final = "cruiser.backfill"
"""The metadata record that says where the messages are from, and what is missing still."""

INFIX: Final = ".backfill"
CHUNK_BYTES: Final = 262_144


class BackfillFile:
    """One log of what was missing. It is made when it is begun, and locked until it is whole.

    Args:
        directory: the directory of the file.
        name: begins its name.
        start_ns: since 1970; goes into its name.
        library: the writer's name, for its header.

    Raises:
        CommandError: it cannot be made; and so do the methods.
    """

    def __init__(self, directory: Path, name: str, start_ns: int, library: str) -> None:
        stem = f"{name}-{start_in_name(start_ns)}{INFIX}"
        with clear_errors(directory):
            self.path = free_path(directory, stem, SUFFIX)
            self.part = self.path.with_name(self.path.name.removesuffix(SUFFIX) + PART_SUFFIX)
            self._stream = FileIO(self.part, "xb")
            # A recorder that starts here takes a part that nobody holds for a leftover.
            lock(self._stream.fileno())
            self._mcap = McapFile(self._stream, library)
        self._chunk = ChunkBuilder()
        self._ids: dict[tuple[str, str, str], int] = {}
        self._schemas: dict[str, bytes] = {}

    def fits(self, message: LoggedBytes) -> bool:
        """True if its schema is none of another version than the one of that name here."""
        channel = message.channel
        return self._schemas.get(channel.schema_name, channel.schema_data) == channel.schema_data

    def write(self, message: LoggedBytes, recorder: str) -> None:
        """Write a message that fits, and which recorder sent it: each has channels of its own."""
        channel = message.channel
        key = channel.topic, channel.schema_name, recorder
        number = self._ids.get(key)
        with clear_errors(self.part):
            if number is None:
                number = self._ids[key] = len(self._ids) + 1
                self._schemas[channel.schema_name] = channel.schema_data
                marked = LogChannel(
                    number,
                    channel.topic,
                    channel.schema_name,
                    channel.schema_data,
                    metadata={BACKFILLED_FROM: recorder},
                )
                self._mcap.add_channel(marked)
            self._chunk.add(number, message.sequence, message.log_ns, message.publish_ns, message.data)
            if len(self._chunk) >= CHUNK_BYTES:
                self.flush()

    def flush(self) -> None:
        """Have all that was written be in the file."""
        chunk = self._chunk.seal()
        if chunk is not None:
            with clear_errors(self.part):
                self._mcap.write_chunk(chunk)

    def finish(self, about: dict[str, str]) -> Path:
        """Make it whole, on the disk, and give it its name."""
        self.flush()
        with clear_errors(self.part):
            self._mcap.add_metadata(BACKFILL_NAME, about)
            self._mcap.finish()
            os.fsync(self._stream.fileno())
            self.part.rename(self.path)
            self._stream.close()
            sync_directory(self.path.parent)
        return self.path

    def close(self) -> None:
        """Leave it as it is, if it was not finished: a part that the next recorder here makes whole."""
        self._stream.close()


class BackfillFiles:
    """The logs of one backfill: one for each robot, and another one where schemas of a name differ.

    Args:
        library: the writer's name.
    """

    def __init__(self, library: str) -> None:
        self._library = library
        self._files: dict[str, list[BackfillFile]] = {}

    def write(self, directory: Path, name: str, message: LoggedBytes, recorder: str) -> None:
        """Write a message of this recorder into the log of that name."""
        files = self._files.setdefault(name, [])
        file = next((one for one in files if one.fits(message)), None)
        if file is None:
            file = BackfillFile(directory, name, message.publish_ns, self._library)
            files.append(file)
        file.write(message, recorder)

    def parts(self) -> list[Path]:
        """The logs as they are now; all that was written is in them."""
        files = [file for files in self._files.values() for file in files]
        for file in files:
            file.flush()
        return [file.part for file in files]

    def finish(self, about: dict[str, str]) -> list[Path]:
        """Make all of them whole."""
        return [file.finish(about) for files in self._files.values() for file in files]

    def close(self) -> None:
        """Leave those that were not finished as they are."""
        for files in self._files.values():
            for file in files:
                file.close()
