# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tasks on a Dask cluster: this machine's cores, or a scheduler somewhere."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from trajeval_ros.benchmarking import interrupts
from trajeval_ros.benchmarking.plan import Task
from trajeval_ros.benchmarking.work import LOST, Outcome, failed, outcomes_of

Work = Callable[[Task], list[Outcome]]

PATIENCE = 10.0
"""How long a scheduler may take to answer, s."""

# Of the processes that are started here. Dask's own keep a profile, 10 MB a minute and worker; they
# ask whether the event loop is awake fifty times a second, and for the memory ten times: together
# 5 % of a core, a fifth of which is left.
_QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.scheduler.active-memory-manager.start": False,
}


class ClusterError(RuntimeError):
    """The cluster cannot be reached, or is gone; the message is one line."""


@contextlib.contextmanager
def cluster(scheduler: str | None = None, workers: int | None = None) -> Iterator[Any]:
    """A client of the ``scheduler``, or of so many processes of this machine while it lasts.

    Processes, of one thread each: the mathematics holds the interpreter's lock half of the time.

    Raises :class:`ClusterError` where there is no such scheduler.
    """
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=PATIENCE)
        except (OSError, TimeoutError, ValueError) as error:
            raise ClusterError(f"no scheduler answers at {scheduler}") from error
        with client:
            yield client
        return
    with (
        dask.config.set(_QUIET),
        LocalCluster(
            n_workers=workers or cores(),
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=50,
            preload=[interrupts.__name__],
        ) as local,
        Client(local) as client,
    ):
        yield client


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def workers_of(client: Any) -> int:
    """The threads of a client's workers, at least one: a cluster may yet grow."""
    return max(sum(client.nthreads().values()), 1)


def evaluate(
    client: Any, tasks: Iterable[Task], work: Work = outcomes_of
) -> Iterator[list[Outcome]]:
    """Yield the outcomes of each task as it is done. ``work``: what the workers do with one.

    Dask gives the tasks of a worker that dies to another, and gives up those at which several died.
    Which of them killed the workers cannot be told, as others were there: so each run of theirs is
    done once more at the end, with no other beside it. One at which workers die then has a row
    that says so.

    Raises :class:`ClusterError` where the scheduler is gone.
    """
    from distributed import as_completed

    waiting = {_submit(client, work, task): task for task in tasks}
    suspects: list[Task] = []
    for future in as_completed(list(waiting)):
        task = waiting.pop(future)
        outcomes = _result(future)
        if isinstance(outcomes, list):
            yield outcomes
        else:
            suspects += [dataclasses.replace(task, runs=(one,)) for one in task.runs]
    for task in suspects:
        outcomes = _result(_submit(client, work, task))
        if isinstance(outcomes, list):
            yield outcomes
        else:
            yield [Outcome(failed(task.runs[0], _said(outcomes), LOST))]


def _result(future: Any) -> list[Outcome] | Exception:
    """Wait for the outcomes of a task, or what became of it instead."""
    from distributed import CancelledError

    try:
        outcomes: list[Outcome] = future.result()
    except CancelledError as error:
        raise ClusterError("the scheduler is gone") from error
    except Exception as error:  # noqa: BLE001 (what Dask has to say of workers, whatever it is)
        return error
    # The worker may forget them.
    future.release()
    return outcomes


def _said(error: Exception) -> str:
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return "every worker died that evaluated it"
    return " ".join(f"{type(error).__name__}: {error}".split())


def _submit(client: Any, work: Work, task: Task) -> Any:
    # Not pure: by what Dask makes of the arguments two tasks would be one.
    return client.submit(work, task, pure=False)
