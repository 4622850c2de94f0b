"""Tasks, one a log, run in this process, in several of this machine, or by a Ray cluster.

A task's function is a module's, and its arguments and result can be pickled. On a cluster every machine needs this
package, and the logs under the same paths.
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

LOOK_S: Final = 0.1  # period of checks for a stop
TRIES_AGAIN: Final = 3  # of a cluster when a task's process or machine dies, or a file cannot be read
SCHEME: Final = "ray://"


class LogTask(Protocol):
    """A task; ``bytes`` is the size of its log."""

    @property
    def bytes(self) -> int: ...


Task = TypeVar("Task", bound=LogTask)
Outcome = TypeVar("Outcome")

Act = Callable[[Task, Progress], Outcome]
"""Runs a task; the progress gets the numbers of bytes read."""


class TaskRunner(msgspec.Struct, frozen=True):
    """Runs tasks.

    Attributes:
        processes: number of spawned processes; one is this process. A calling script must be importable without
            side effects.
        ray: the address of a Ray cluster; empty for none.
    """

    processes: int = 1
    ray: str = ""

    def __call__(self, act: Act[Task, Outcome], tasks: Sequence[Task], progress: Progress) -> Iterator[Outcome]:
        """Run all tasks, and yield their outcomes in order; CommandError if a process or the cluster is lost."""
        if self.ray:
            with ray_cluster(self.ray) as cluster:
                yield from _spread(cluster, act, tasks, progress)
        elif self.processes > 1 and len(tasks) > 1:
            with processes(min(self.processes, len(tasks))) as pool:
                yield from _spread(pool, act, tasks, progress)
        else:
            for task in tasks:
                yield act(task, progress)


HERE: Final = TaskRunner()  # this process


def _spread(
    pool: Executor, act: Act[Task, Outcome], tasks: Sequence[Task], progress: Progress
) -> Iterator[Outcome]:
    # Submit all before waiting for the first.
    futures = [pool.submit(act, task, look) for task in tasks]
    for task, future in zip(tasks, futures, strict=True):
        outcome = outcome_of(future, progress)
        progress(task.bytes)
        yield outcome


def outcome_of(future: Future[Outcome], progress: Progress) -> Outcome:
    """Wait for the outcome of a task, and call the progress meanwhile; CommandError if its process was killed."""
    while not wait([future], LOOK_S).done:
        progress(0)
    try:
        return future.result()
    except BrokenProcessPool as error:
        raise CommandError("a process was killed in the middle of a log; try --processes 1") from error


@contextmanager
def processes(count: int) -> Generator[ProcessPoolExecutor, None, None]:
    """Processes that end on request, and not by a signal for this one."""
    context = get_context("spawn")
    # They start with `python -c`, which would import modules from the working directory.
    os.environ[SAFE_PATH_VARIABLE] = "1"
    stop = context.Event()
    pool = ProcessPoolExecutor(count, context, _enter, (stop,))
    try:
        yield pool
    finally:
        stop.set()
        pool.shutdown(cancel_futures=True)


_stop: Event | None = None  # in a process that runs tasks: it must end


def _enter(stop: Event) -> None:
    global _stop  # noqa: PLW0603 - a process of the pool has no other place
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _stop = stop


def look(_count: int) -> None:
    """A progress that ends the task by KeyboardInterrupt when the process must end."""
    if _stop is not None and _stop.is_set():
        raise KeyboardInterrupt


class RayCluster(Executor):
    """Runs tasks on a cluster. A task's exception is raised as it is."""

    def __init__(self, ray: Any) -> None:  # noqa: ANN401 - a module that is not everywhere
        self._ray = ray
        self._remote = ray.remote(max_retries=TRIES_AGAIN, retry_exceptions=[OSError])
        self._acts: dict[Callable[..., Any], Any] = {}  # functions sent to the cluster

    def submit(self, act: Callable[..., Any], /, *words: Any, **named: Any) -> Future[Any]:  # noqa: ANN401 - an Executor's
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
                future.set_exception(CommandError(f"the cluster lost a task: {error}"))

        self._acts[act].remote(*words, **named).future().add_done_callback(settle)
        return future


@contextmanager
def ray_cluster(address: str) -> Generator[RayCluster, None, None]:
    """Connect to a Ray cluster, and cancel unfinished tasks at the end; CommandError if that is not possible."""
    if not address.startswith(SCHEME):
        # In a process that joins the cluster, Ray prints messages to its output.
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
