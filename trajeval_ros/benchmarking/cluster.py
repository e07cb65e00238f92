# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tasks on a Dask cluster: this machine's cores, or a scheduler somewhere."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from typing import Any

from trajeval_ros.benchmarking.plan import Task
from trajeval_ros.benchmarking.work import LOST, Row, failed, rows_of

PATIENCE = 10.0
"""How long a scheduler may take to answer, s."""


class ClusterError(RuntimeError):
    """The cluster cannot be reached, or is gone; the message is one line."""


@contextlib.contextmanager
def cluster(scheduler: str | None = None, workers: int | None = None) -> Iterator[Any]:
    """A client of the ``scheduler``, or of so many processes of this machine while it lasts.

    Processes, of one thread each: the mathematics holds the interpreter's lock half of the time.

    Raises :class:`ClusterError` where there is no such scheduler.
    """
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
        LocalCluster(
            n_workers=workers or cores(),
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=50,
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


def evaluate(client: Any, tasks: Iterable[Task]) -> Iterator[list[Row]]:
    """Yield the rows of each task as it is done.

    Dask gives the tasks of a worker that dies to another. A task at which one after another dies
    is cut into its runs; a run at which they die has a row that says so.

    Raises :class:`ClusterError` where the scheduler is gone.
    """
    from distributed import KilledWorker, as_completed

    waiting = {_submit(client, task): task for task in tasks}
    done = as_completed(list(waiting))
    for future in done:
        task = waiting.pop(future)
        if future.cancelled() or future.status == "lost":
            raise ClusterError("the scheduler is gone")
        error = future.exception()
        if error is None:
            rows: list[Row] = future.result()
            # The worker may forget them.
            future.release()
            yield rows
        elif len(task.runs) > 1:
            for one in task.runs:
                alone = Task(task.ground_truth, task.parameters, (one,))
                again = _submit(client, alone)
                waiting[again] = alone
                done.add(again)
        elif isinstance(error, KilledWorker):
            yield [failed(task.runs[0], "every worker died that evaluated it", LOST)]
        else:
            said = " ".join(f"{type(error).__name__}: {error}".split())
            yield [failed(task.runs[0], said, LOST)]


def _submit(client: Any, task: Task) -> Any:
    # Not pure: by what Dask makes of the arguments two tasks would be one.
    return client.submit(rows_of, task, pure=False)
