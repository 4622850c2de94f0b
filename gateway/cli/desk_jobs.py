"""The one starter of questions to logs, each a process of its own: a log may be made to take all that there is."""

from __future__ import annotations

import asyncio
import os
import resource
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

import msgspec

from schemas.command_line import module_command

JOB_S: Final = 120.0
"""The longest time that an answer may take; who needs more asks ``cruiser review`` itself."""

JOB_BYTES: Final = 2 << 30
"""The memory that an answer may take: a log can be made to unpack to much more than it is."""

WAITING_MAX: Final = 16
"""Questions that wait for their turn; any more are refused at once."""

SAID_BYTES: Final = 4 << 20
"""The longest answer that is read."""

NICENESS: Final = 10
"""A tenth of the processor where others want it: a robot that is driven through the same server comes first."""

END_S: Final = 5.0
"""Time to end in, once it is told to."""


class JobDone(msgspec.Struct, frozen=True):
    """A process that has ended.

    Attributes:
        code: its exit code; None if it was given up, or could not be started.
        output: its stdout.
        fault: the end of its stderr, or the reason that there is no answer.
    """

    code: int | None
    output: bytes
    fault: str


class JobsBusyError(Exception):
    """Too many questions wait already."""


class Jobs:
    """Runs a few questions at a time; the others wait, in a line that is not endless.

    Args:
        at_a_time: processes that run at once.
    """

    def __init__(self, at_a_time: int = 1) -> None:
        self._turns = asyncio.Semaphore(at_a_time)
        self._waiting = 0

    async def __aenter__(self) -> None:
        """Wait for a turn.

        Raises:
            JobsBusyError: too many wait.
        """
        if self._waiting >= WAITING_MAX:
            raise JobsBusyError
        self._waiting += 1
        try:
            await self._turns.acquire()
        finally:
            self._waiting -= 1

    async def __aexit__(self, *_: object) -> None:
        """Let the next one have its turn."""
        self._turns.release()


async def ask_review(words: Sequence[str], seconds: float = JOB_S) -> JobDone:
    """Ask ``cruiser review``, and wait for the answer.

    Args:
        words: the question and its arguments.
        seconds: the time, and the processor's time, that it may take. It is then told to end, and to keep
            what it has.
    """
    try:
        process = await asyncio.create_subprocess_exec(
            *module_command("gateway", "review", *words),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
    except OSError as error:
        # Browsers may hold all files that this process may open, or others all processes.
        return JobDone(None, b"", f"no process can be started: {error.strerror}")
    with suppress(ProcessLookupError):
        os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
        resource.prlimit(process.pid, resource.RLIMIT_DATA, (JOB_BYTES, JOB_BYTES))
        processor_s = max(1, int(seconds))
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (processor_s, processor_s + int(END_S)))
    reading = asyncio.gather(_read(process.stdout, SAID_BYTES), _read(process.stderr, SAID_BYTES))
    try:
        output, said = await asyncio.wait_for(asyncio.shield(reading), seconds)
        fault = said.decode("utf-8", "replace").strip()[-1000:]
        code = await process.wait()
        if code < 0:
            return JobDone(None, b"", f"no answer: the process was ended by signal {-code}")
        return JobDone(code, output, fault)
    except TimeoutError:
        with suppress(ProcessLookupError):
            process.terminate()
        with suppress(TimeoutError):
            await asyncio.wait_for(asyncio.shield(reading), END_S)
        return JobDone(None, b"", f"no answer within {seconds:.0f} s: ask 'cruiser review {words[0]}' itself")
    finally:
        if process.returncode is None:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        reading.cancel()
        with suppress(asyncio.CancelledError):
            await reading


async def _read(stream: asyncio.StreamReader | None, most: int) -> bytes:
    """Read to the end; what is beyond ``most`` is left out."""
    kept = bytearray()
    while stream is not None and (piece := await stream.read(65_536)):
        kept += piece[: most - len(kept)]
    return bytes(kept)
