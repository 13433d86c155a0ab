"""Many worlds one by one or in processes, with the time that is left."""

from __future__ import annotations

import logging
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from typing import Any

log = logging.getLogger(__name__)


def each(what: str, task: Callable[[Any], Any], items: Sequence[Any], workers: int = 1) -> list:
    """Results of `task` on each item, in the items' order, logged as they come.

    More than one of the `workers` are processes; `task` and the items must then be picklable.

    Raises
    ------
    ExceptionGroup
        After all items, with the errors of those that failed.
    """
    start = time.perf_counter()
    results, errors = {}, []
    for place, future in _done(task, items, workers):
        error = future.exception()
        if error is None:
            results[place] = future.result()
        else:
            errors.append(error)
            log.error("%s: %s failed", what, items[place], exc_info=error)
        done = len(results) + len(errors)
        spent = time.perf_counter() - start
        left = spent / done * (len(items) - done)
        log.info("%s: %d of %d in %.0f s, about %.0f s left", what, done, len(items), spent, left)
    if errors:
        raise ExceptionGroup(f"{what}: {len(errors)} of {len(items)} failed", errors)
    return [results[place] for place in range(len(items))]


def _done(task, items: Sequence[Any], workers: int) -> Iterator[tuple[int, Future]]:
    """(place of the item, its finished future) as they come."""
    if workers == 1:
        for place, item in enumerate(items):
            yield place, _here(task, item)
        return
    # forked: other processes would run the job's script again
    context = multiprocessing.get_context("fork" if hasattr(os, "fork") else None)
    with ProcessPoolExecutor(workers, context) as pool:
        places = {pool.submit(task, item): place for place, item in enumerate(items)}
        for future in as_completed(places):
            yield places[future], future


def _here(task, item) -> Future:
    future: Future = Future()
    try:
        future.set_result(task(item))
    except Exception as error:
        future.set_exception(error)
    return future
