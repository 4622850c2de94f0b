"""Tasks, one a log, done in this process, in several of this machine, or by a Ray cluster.

What a task does is a function of a module, and what it is given and returns can be pickled. On a cluster every
machine needs this package, and the files that tasks name under the same paths.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from typing import Any, Final, Protocol, TypeVar

import msgspec

from recorder.reading.rows import Progress
from schemas.command_line import SAFE_PATH_VARIABLE, CommandError, ExitCode, missing_extra

LOOK_S: Final = 0.1
"""Interval at which whoever waits for a task looks for a stop."""

TRIES_AGAIN: Final = 3
"""A cluster begins a task anew so often: where its process or machine dies, or a file cannot be read."""

SCHEME: Final = "ray://"


class LogTask(Protocol):
    """A task of a log."""

    @property
    def bytes(self) -> int:
        """The length of the log."""


Task = TypeVar("Task", bound=LogTask)
Outcome = TypeVar("Outcome")

Act = Callable[[Task, Progress], Outcome]
"""Does a task; the progress receives the numbers of bytes that were read."""


class TaskRunner(msgspec.Struct, frozen=True):
    """The place where tasks are done.

    Attributes:
        processes: so many tasks at once, each in a process of its own; one is this process. They are begun anew: a
            script that calls this has to be importable without doing so again.
        ray: the address of a Ray cluster that does them; empty for none.
    """

    processes: int = 1
    ray: str = ""

    def __call__(self, act: Act[Task, Outcome], tasks: Sequence[Task], progress: Progress) -> Iterator[Outcome]:
        """Do all tasks; yields their outcomes in the same order.

        Raises:
            CommandError: a process was killed, or the cluster is not there.
        """
        if self.ray:
            with ray_cluster(self.ray) as cluster:
                yield from _spread(cluster, act, tasks, progress)
        elif self.processes > 1 and len(tasks) > 1:
            with processes(min(self.processes, len(tasks))) as pool:
                yield from _spread(pool, act, tasks, progress)
        else:
            for task in tasks:
                yield act(task, progress)


HERE: Final = TaskRunner()
"""This process."""


def _spread(
    pool: Executor, act: Act[Task, Outcome], tasks: Sequence[Task], progress: Progress
) -> Iterator[Outcome]:
    # All are begun before the first is waited for.
    futures = [pool.submit(act, task, look) for task in tasks]
    for task, future in zip(tasks, futures, strict=True):
        outcome = outcome_of(future, progress)
        progress(task.bytes)
        yield outcome


def outcome_of(future: Future[Outcome], progress: Progress) -> Outcome:
    """Wait for the result of a task; the progress is called meanwhile, with no bytes.

    Raises:
        CommandError: its process was killed.
    """
    while not wait([future], LOOK_S).done:
        progress(0)
    try:
        return future.result()
    except BrokenProcessPool as error:
        raise CommandError(
            "a process was killed in the middle of a log; with --processes 1 there is one alone"
        ) from error


@contextmanager
def processes(count: int) -> Generator[ProcessPoolExecutor, None, None]:
    """Processes that end on request, and not by a signal that is meant for this one."""
    context = get_context("spawn")
    # They begin with `python -c`, which would take modules from the working directory.
    os.environ[SAFE_PATH_VARIABLE] = "1"
    stop = context.Event()
    pool = ProcessPoolExecutor(count, context, _enter, (stop,))
    try:
        yield pool
    finally:
        stop.set()
        pool.shutdown(cancel_futures=True)


_stop: Event | None = None
"""Of a process that runs tasks: it is to end."""


def _enter(stop: Event) -> None:
    global _stop  # noqa: PLW0603 - a process of the pool has no other place
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _stop = stop


def look(_count: int) -> None:
    """End the task if the process is to end; a progress that counts nothing.

    Raises:
        KeyboardInterrupt: it is.
    """
    if _stop is not None and _stop.is_set():
        raise KeyboardInterrupt


class RayCluster(Executor):
    """Has tasks done by a cluster that is there. What a task raises is its own exception."""

    def __init__(self, ray: Any) -> None:  # noqa: ANN401 - a module that is not everywhere
        self._ray = ray
        self._remote = ray.remote(max_retries=TRIES_AGAIN, retry_exceptions=[OSError])
        self._acts: dict[Callable[..., Any], Any] = {}
        """As the cluster knows them: each is sent there once."""

    def submit(self, act: Callable[..., Any], /, *words: Any, **named: Any) -> Future[Any]:  # noqa: ANN401 - an Executor's
        """Have a task done."""
        future = Future[Any]()
        if act not in self._acts:
            self._acts[act] = self._remote(act)

        def settle(done: Future[Any]) -> None:
            error = done.exception()
            if error is None:
                future.set_result(done.result())
            elif isinstance(error, self._ray.exceptions.RayTaskError):
                future.set_exception(error.cause)
            else:
                future.set_exception(CommandError(f"the cluster has lost a task: {error}"))

        self._acts[act].remote(*words, **named).future().add_done_callback(settle)
        return future


@contextmanager
def ray_cluster(address: str) -> Generator[RayCluster, None, None]:
    """Connect to a Ray cluster; tasks that are not done at the end are given up.

    Raises:
        CommandError: Ray is not installed, or no cluster is there.
    """
    if not address.startswith(SCHEME):
        # A process that joins the cluster itself gets Ray's messages printed among its answers.
        raise CommandError(f"the address of a Ray cluster is {SCHEME}HOST:PORT", ExitCode.USAGE)
    # Ray reports to its makers, unless this is set before.
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    try:
        import ray  # type: ignore[import-not-found,unused-ignore]  # noqa: PLC0415 - it is not everywhere
    except ImportError:
        raise missing_extra("Ray", "ray") from None
    try:
        ray.init(address, log_to_driver=False, logging_level="ERROR")
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise CommandError(f"no Ray cluster answers at {address}: {error}", ExitCode.UNREACHABLE) from error
    try:
        yield RayCluster(ray)
    finally:
        ray.shutdown()
