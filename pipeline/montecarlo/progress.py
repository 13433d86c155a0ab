"""How far replicates are, and when they end: in the log, and on a terminal."""

from __future__ import annotations

import logging
import sys
import time

EVERY = 10.0  # s between lines of a log

log = logging.getLogger(__name__)


class Progress:
    """Counts replicates of `name` up to `count` at most; the time left goes by those computed."""

    def __init__(self, name: str, count: int):
        self._name, self._count = name, count
        self._found = self._computed = 0
        self._start = self._said = time.perf_counter()
        self._bar = sys.stderr if sys.stderr.isatty() else None
        log.info("%s: %d replicates", name, count)

    def found(self, count: int) -> None:
        """So many were there already."""
        self._found = count
        if count:
            text = "%s: %d of %d replicates were kept by an earlier run and are not run again"
            log.info(text, self._name, count, self._count)

    def computed(self, count: int) -> None:
        """So many more have been computed."""
        self._computed += count
        now = time.perf_counter()
        text = f"{self._name}: {self._done} of {self._count} replicates{self._left(now)}"
        if self._bar:
            self._bar.write(f"\r{text:<78}")
            self._bar.flush()
        if now - self._said >= EVERY:
            self._said = now
            log.info(text)

    def end(self) -> None:
        """No more are wanted."""
        if self._bar:
            self._bar.write("\n")
        seconds = time.perf_counter() - self._start
        log.info("%s: %d replicates took %.2f s", self._name, self._computed, seconds)

    @property
    def _done(self) -> int:
        return self._found + self._computed

    def _left(self, now: float) -> str:
        seconds = (now - self._start) / self._computed * (self._count - self._done)
        return f", about {duration(seconds)} left" if seconds > 0 else ""


def duration(seconds: float) -> str:
    """Seconds in words: 45 s, 12 min, 3 h 20 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
