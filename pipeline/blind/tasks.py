"""A task on many worlds, of which none may stop the others, with the time that is left."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import Any

from pipeline.montecarlo.workers import Execution, crew

log = logging.getLogger(__name__)


def each(what: str, task: Callable[[Any], Any], items: Sequence[Any], workers: int = 1) -> list:
    """Results of `task` on each item, in the items' order, logged as they come.

    More than one of the `workers` are processes; results and errors must then be picklable.

    Raises
    ------
    ExceptionGroup
        After all items, with the errors of those that failed.
    """
    start = time.perf_counter()
    results, errors = {}, []
    with crew(Execution(workers), what, processes=True) as ready:
        for place, (result, error) in ready.each(_tried, [(item,) for item in items], (what, task)):
            if error is None:
                results[place] = result
            else:
                errors.append(error)
            done = len(results) + len(errors)
            spent = time.perf_counter() - start
            left = spent / done * (len(items) - done)
            words = "%s: %d of %d in %.0f s, about %.0f s left"
            log.info(words, what, done, len(items), spent, left)
    if errors:
        raise ExceptionGroup(f"{what}: {len(errors)} of {len(items)} failed", errors)
    return [results[place] for place in range(len(items))]


def _tried(shared, item) -> tuple[Any, Exception | None]:
    """(result, None) or (None, error), which is logged here: on its way it loses its traceback."""
    what, task = shared
    try:
        return task(item), None
    except Exception as error:
        log.exception("%s: %s failed", what, item)
        return None, error
