"""Who computes: this process, threads, forked processes, or the workers of a Dask cluster."""

from __future__ import annotations

import ctypes
import gc
import hashlib
import logging
import math
import multiprocessing
import os
import pickle
import queue
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from concurrent.futures import wait as wait_for
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parents[1]
PATIENCE = 60.0  # s without any worker of the cluster
CONNECT = "10s"  # for the scheduler to answer
LOSSES = 4  # times that a result may be lost with its worker
# of glibc: what may stay free at the end of the heap, and the size from which arrays are mapped
MALLOC_SETTINGS = {-1: 2**28, -3: 2**25}
KEPT = "What is finished is kept: the next run goes on from there."

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Execution:
    """Where replicates run: on `workers` cores here, or on the Dask cluster at `scheduler`.

    `chunk` is the number of replicates in a task (None: a few tasks for each worker). None of the
    three changes a bit of the results.
    """

    workers: int = 1
    scheduler: str = ""
    chunk: int | None = None


class WorkersLostError(RuntimeError):
    """Workers died, or the cluster cannot be reached; says what would help."""


# calls `function(shared, *job)` for each job; gives (place of the job, result) as they finish
Each = Callable[[Callable[..., Any], Sequence[tuple], Any], Iterator[tuple[int, Any]]]


@dataclass(frozen=True)
class Crew:
    """Workers that are ready: how many, and how they do jobs."""

    workers: int
    each: Each


@contextmanager
def crew(execution: Execution, what: str = "tasks", processes: bool = False) -> Iterator[Crew]:
    """The workers of an execution; `what` they work on stands in messages.

    Parameters
    ----------
    processes : here in forked processes instead of threads, which share one interpreter: for
        jobs that are more Python than kernel. Their results must be picklable.

    Raises
    ------
    WorkersLostError
        If the cluster cannot be reached, has no worker, or loses those that it has.
    """
    if execution.scheduler:
        with dask_session(execution.scheduler, what) as cluster:
            yield Crew(cluster.workers, partial(cluster.each, what=what))
    elif execution.workers == 1:
        yield Crew(1, _each_here)
    elif processes and hasattr(os, "fork"):
        yield Crew(execution.workers, partial(_each_forked, execution.workers, what))
    else:
        yield Crew(execution.workers, partial(_each_in_threads, execution.workers))


def run_tasks(
    tasks: Sequence[Callable[[], Any]], execution: Execution, processes: bool = False
) -> list[Any]:
    """Results of tasks without arguments, in order; for `processes` see `crew`."""
    with crew(execution, processes=processes) as workers:
        results = dict(workers.each(_call, [(place,) for place in range(len(tasks))], tasks))
    return [results[place] for place in range(len(tasks))]


def _call(tasks, place):
    return tasks[place]()


# ---------------------------------------------------------------------------------------------
# on this machine


def _each_here(function, jobs, shared):
    for place, job in enumerate(jobs):
        yield place, function(shared, *job)


def _each_in_threads(workers, function, jobs, shared):
    with ThreadPoolExecutor(min(workers, len(jobs) or 1)) as pool:
        yield from _in_turn(pool, workers, partial(function, shared), jobs)


def _each_forked(workers, what, function, jobs, shared):
    # a forked process has `shared` already, and would not run a job's script again
    global _inherited
    _inherited = partial(function, shared)
    context = multiprocessing.get_context("fork")
    try:
        with ProcessPoolExecutor(
            min(workers, len(jobs) or 1), context, _end_with, (os.getpid(),)
        ) as pool:
            yield from _in_turn(pool, workers, _run_inherited, jobs)
    except BrokenProcessPool:
        raise WorkersLostError(
            f"{what}: a worker process was killed, most likely because memory ran out. {KEPT} "
            f"Run it with fewer --cores, or with fewer cells."
        ) from None
    finally:
        _inherited = None


_inherited: Callable[..., Any] | None = None


def _run_inherited(*job):
    return _inherited(*job)


def _end_with(parent: int) -> None:
    """See that this process does not outlive its parent, even one that is killed."""

    def watch():
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _in_turn(pool: Executor, workers: int, function, jobs) -> Iterator[tuple[int, Any]]:
    """Jobs through a pool, only as many at once as keep it busy: results do not pile up."""
    todo = iter(enumerate(jobs))
    running = {}
    try:
        while True:
            for place, job in todo:
                running[pool.submit(function, *job)] = place
                if len(running) > workers:
                    break
            if not running:
                return
            for future in wait_for(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
                del future
    finally:
        for future in running:
            future.cancel()


# ---------------------------------------------------------------------------------------------
# on a cluster


_sessions: dict[str, _Cluster] = {}


@contextmanager
def dask_session(scheduler: str, what: str) -> Iterator[_Cluster]:
    """The only place that configures Dask: a client of the cluster at `scheduler`.

    Within an open session it is the same one.
    """
    if scheduler in _sessions:
        yield _sessions[scheduler]
        return
    import dask
    from distributed import Client

    settings = {
        # what all tasks share goes to the scheduler once, and from there to each worker
        "distributed.admin.large-graph-warning-threshold": "100GB",
        "distributed.comm.timeouts.connect": CONNECT,
    }
    with dask.config.set(settings):
        client, silence = None, ""
        try:
            client = Client(scheduler, set_as_default=False)
        except (OSError, ValueError, AssertionError) as error:  # the last: its loop did not start
            silence = _first_line(error)
        if client is None:
            # a client that failed closes itself when it is collected; were that while the next one
            # starts, each would wait for the other
            gc.collect()
            raise WorkersLostError(
                f"{what}: no Dask scheduler answers at {scheduler} ({silence}). "
                "Expected dask_scheduler=tcp://HOST:PORT of a running `dask scheduler`"
            )
        with closing(client):
            _sessions[scheduler] = _Cluster(client, scheduler, what)
            try:
                yield _sessions[scheduler]
            finally:
                del _sessions[scheduler]


class _Cluster:
    """Workers of a running Dask cluster."""

    def __init__(self, client, scheduler: str, what: str):
        self._client, self._scheduler = client, scheduler
        self._sent: tuple[Any, Any] = (None, None)  # what was shared last, and its future
        self._losses: Counter[str] = Counter()  # how often results were lost, by their key
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise WorkersLostError(self._no_worker(what)) from None
        threads = [worker["nthreads"] for worker in self._workers().values()]
        self.workers = sum(threads)
        client.subscribe_topic("all", self._count_losses)
        log.info(
            "Dask cluster at %s: %d workers, %d threads", scheduler, len(threads), sum(threads)
        )

    def _workers(self) -> dict[str, dict]:
        return self._client.scheduler_info(n_workers=-1)["workers"]

    def each(self, function, jobs, shared, what: str) -> Iterator[tuple[int, Any]]:
        """As `Each`. The scheduler repeats what a worker that died had not handed over."""
        import distributed

        run, futures = uuid.uuid4().hex, {}
        done, results = queue.SimpleQueue(), queue.SimpleQueue()
        try:
            sent = self._send(shared)
            for place, job in enumerate(jobs):
                futures[place] = self._client.submit(
                    _run_on_worker,
                    _versions(),
                    function,
                    sent,
                    job,
                    key=f"{function.__name__}-{run}-{place}",
                    pure=False,
                )
                futures[place].add_done_callback(lambda _, place=place: done.put(place))
            threading.Thread(target=_fetch, args=(futures, done, results), daemon=True).start()
            while futures:
                place, result, error = self._next(results, futures, what)
                del futures[place]
                if error is not None:
                    raise error
                yield place, result
        except distributed.scheduler.KilledWorker as error:
            raise WorkersLostError(self._out_of_memory(what, error.allowed_failures + 1)) from None
        except (distributed.client.FutureCancelledError, OSError, TimeoutError) as error:
            raise WorkersLostError(
                f"{what}: the Dask cluster at {self._scheduler} was lost "
                f"({_first_line(error)}). {KEPT} See that `dask scheduler` and its workers run, "
                "then run it again, or leave dask_scheduler out to run it here."
            ) from None
        finally:
            done.put(None)
            if futures and self._client.status == "running":
                self._client.cancel(list(futures.values()))

    def _send(self, shared):
        """The future of what all jobs share.

        A task's result, not scattered data: the scheduler makes it again if its worker dies.
        """
        if self._sent[0] is not shared:
            future = self._client.submit(pickle.loads, pickle.dumps(shared), pure=False)
            self._sent = (shared, future)
        return self._sent[1]

    def _next(self, results, futures, what: str) -> tuple[int, Any, BaseException | None]:
        """What comes next: (place, result, None) or (place, None, error)."""
        since = time.monotonic()
        while True:
            with suppress(queue.Empty):
                return results.get(timeout=1.0)
            losses = max(self._losses[future.key] for future in futures.values())
            if losses >= LOSSES:
                raise WorkersLostError(self._out_of_memory(what, losses))
            if self._client.status != "running" or self._workers():
                since = time.monotonic()
            elif time.monotonic() - since > PATIENCE:
                raise WorkersLostError(self._no_worker(what))

    def _count_losses(self, event) -> None:
        """A worker that dies with results counts as no failure to the scheduler."""
        _, told = event
        if isinstance(told, dict) and told.get("action") == "remove-worker":
            self._losses.update(map(str, told.get("lost-computed-tasks", ())))

    def _out_of_memory(self, what: str, times: int) -> str:
        return (
            f"{what}: workers of the Dask cluster at {self._scheduler} died over the same task "
            f"({times} of {times} times), most likely because memory ran out. {KEPT} Give each "
            "worker more memory (`dask worker --memory-limit`) or one thread (`--nthreads 1`), or "
            "run it with fewer cells."
        )

    def _no_worker(self, what: str) -> str:
        return (
            f"{what}: the Dask cluster at {self._scheduler} has had no worker for {PATIENCE:.0f} "
            f"s. {KEPT} Start some (`dask worker {self._scheduler} --nthreads 1`), or leave "
            "dask_scheduler out to run it here."
        )


def _fetch(futures, done, results) -> None:
    """Bring results here as they finish.

    In a thread of its own: a client waits without end for a result whose workers keep dying.
    """
    while (place := done.get()) is not None:
        try:
            results.put((place, futures[place].result(), None))
        except BaseException as error:
            results.put((place, None, error))


def _run_on_worker(versions, function, shared, job):
    if _versions() != versions:
        ours, theirs = (", ".join(map(" ".join, those)) for those in (versions, _versions()))
        raise WorkersLostError(
            f"a Dask worker runs other code ({theirs}) than this run ({ours}), which could give "
            "other numbers; start the workers in the same environment and revision"
        )
    _keep_freed_memory()
    return function(shared, *job)


@cache
def _keep_freed_memory() -> None:
    """Let this process use the memory of freed arrays again, instead of asking for new pages.

    Dask starts its workers so that they give back whatever is larger than 64 kB
    (MALLOC_TRIM_THRESHOLD_): a small replicate then takes more than twice as long.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # not glibc
        return
    for setting, size in MALLOC_SETTINGS.items():
        mallopt(setting, size)


@cache
def _versions() -> tuple[tuple[str, str], ...]:
    """What must be the same on a worker: libraries, and this package's code."""
    import numba
    import numpy

    code = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        code.update(path.read_bytes())
    return (
        ("numpy", numpy.__version__),
        ("numba", numba.__version__),
        ("pipeline", code.hexdigest()[:12]),
    )


def _first_line(error: BaseException) -> str:
    return next(iter(str(error).splitlines()), "") or type(error).__name__


def pieces(seconds: float, workers: int) -> int:
    """Into how many tasks to cut work of about so many seconds of one core.

    One for each worker where it is short; else some for each, so that they end together, and so
    many that a stop loses little.
    """
    if seconds < 1.0:
        return workers
    return max(4 * workers, math.ceil(seconds / 15.0))
