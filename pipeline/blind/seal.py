"""A folder that this process cannot look into for a while."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

PATHS = {  # audit event: how many of its arguments are paths
    "open": 1,
    "os.listdir": 1,
    "os.scandir": 1,
    "os.rename": 2,
    "os.link": 2,
    "os.symlink": 2,
}
_sealed: list[str] = []


class SealedError(RuntimeError):
    """Something under a sealed folder was opened, listed or linked to."""


@contextmanager
def sealed(folder: Path | str) -> Iterator[None]:
    """Within it, opening or listing anything under `folder` from Python raises SealedError."""
    _watch()
    _sealed.append(os.path.realpath(folder))
    try:
        yield
    finally:
        _sealed.pop()


@cache
def _watch() -> None:
    """Add the hook, once: Python keeps it for as long as the process lives."""
    sys.addaudithook(_refuse)


def _refuse(event: str, arguments: tuple) -> None:
    if not _sealed or event not in PATHS:
        return
    for path in arguments[: PATHS[event]]:
        if not isinstance(path, str | bytes | os.PathLike):
            continue
        real = os.path.realpath(os.fsdecode(path))
        if any(real == root or real.startswith(root + os.sep) for root in _sealed):
            raise SealedError(f"{real} was asked for ({event}) while the truth is sealed")
