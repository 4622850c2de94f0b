"""Tasks on a cluster, with a stand-in for Ray's module."""

import sys
from collections.abc import Callable
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import pytest

from recorder.review.tasks import TRIES_AGAIN, RayCluster, ray_cluster
from schemas.command_line import CommandError, ExitCode


class TaskError(Exception):
    def __init__(self, cause: Exception) -> None:
        super().__init__(f"many lines about {cause!r}")
        self.cause = cause


class FakeRay:
    exceptions = SimpleNamespace(RayTaskError=TaskError)

    def __init__(self) -> None:
        self.loses = False
        self.options: dict[str, object] = {}

    def remote(self, **options: object) -> Callable[[Callable[..., Any]], Any]:
        self.options = options
        return lambda act: SimpleNamespace(
            remote=lambda *words: SimpleNamespace(future=lambda: self.do(act, words))
        )

    def do(self, act: Callable[..., Any], words: tuple[Any, ...]) -> Future[Any]:
        future = Future[Any]()
        if self.loses:
            future.set_exception(ConnectionError("the node is gone"))
            return future
        try:
            future.set_result(act(*words))
        except Exception as error:  # noqa: BLE001 - as Ray does
            future.set_exception(TaskError(error))
        return future


def test_a_task_is_done_and_begun_anew_where_that_may_help() -> None:
    ray = FakeRay()
    cluster = RayCluster(ray)
    assert cluster.submit(divmod, 7, 2).result() == (3, 1)
    assert ray.options == {"max_retries": TRIES_AGAIN, "retry_exceptions": [OSError]}
    with pytest.raises(ZeroDivisionError):
        cluster.submit(divmod, 7, 0).result()


def test_a_task_that_is_lost_is_one_clear_error() -> None:
    ray = FakeRay()
    ray.loses = True
    with pytest.raises(CommandError, match="lost a task: the node is gone"):
        RayCluster(ray).submit(divmod, 7, 2).result()


def test_ray_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(CommandError, match=r"pip install -e '\.\[ray\]'"), ray_cluster("ray://here:1"):
        pass


@pytest.mark.parametrize("address", ["auto", "local", "10.0.0.5:6379"])
def test_an_address_at_which_ray_prints_among_the_answers_is_refused(address: str) -> None:
    with pytest.raises(CommandError, match="ray://HOST:PORT") as raised, ray_cluster(address):
        pass
    assert raised.value.code is ExitCode.USAGE
