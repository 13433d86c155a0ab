"""Figures: what is measured, its yardstick, the paired ratios and what they should reach."""

from __future__ import annotations

import math
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import psutil

LEAST_SECONDS = 0.005  # a timing goes over as many calls as take so long


class Target(NamedTuple):
    """A bound on the median of a figure's "value" or "ratio"; the least, or the most."""

    of: str
    bound: float
    is_most: bool = False

    def is_met(self, median: float) -> bool:
        """Whether a median keeps within the bound."""
        return median <= self.bound if self.is_most else median >= self.bound


@dataclass(frozen=True)
class Figure:
    """Something measured beside a yardstick, both (repeat); units are SI, rates per second."""

    name: str
    unit: str
    values: np.ndarray
    yardstick: str
    yardstick_values: np.ndarray
    shapes: tuple[tuple[int, ...], ...]
    dtype: str
    remark: str = ""
    targets: tuple[Target, ...] = ()
    quoted: bool = False  # the yardstick was not measured here
    yardstick_unit: str | None = None  # None: as the figure's

    @property
    def ratios(self) -> np.ndarray:
        """Value over yardstick, repeat by repeat."""
        return self.values / self.yardstick_values

    def document(self) -> dict[str, Any]:
        """As JSON-able data."""
        parts = {"value": _spread(self.values), "ratio": _spread(self.ratios)}
        return {
            "name": self.name,
            "unit": self.unit,
            "value": parts["value"],
            "yardstick": {
                "name": self.yardstick,
                "quoted": self.quoted,
                "unit": self.unit if self.yardstick_unit is None else self.yardstick_unit,
                **_spread(self.yardstick_values),
            },
            "ratio": parts["ratio"],
            "sizes": {
                "shapes": [list(shape) for shape in self.shapes],
                "cells": [math.prod(shape) for shape in self.shapes],
                "remark": self.remark,
            },
            "dtype": self.dtype,
            "repeats": len(self.values),
            "targets": [
                {
                    "of": target.of,
                    "bound": target.bound,
                    "is": "most" if target.is_most else "least",
                    "met": target.is_met(parts[target.of]["median"]),
                }
                for target in self.targets
            ],
        }


def _spread(values: np.ndarray) -> dict[str, float]:
    return {name: float(getattr(np, name)(values)) for name in ("min", "median", "max")}


class Action(NamedTuple):
    """`run(prepared)` returns how much it did; `prepare()` is not timed."""

    run: Callable[[Any], float]
    prepare: Callable[[], Any] = lambda: None


def measure(actions: Mapping[str, Action], repeats: int) -> dict[str, np.ndarray]:
    """Rates (repeat) of actions that take turns, in what they did a second.

    In a repeat each is called as often as it takes to fill `LEAST_SECONDS`; finding out how often
    warms it up.
    """
    calls = {}
    for name, action in actions.items():
        _rate(action, 1)
        calls[name] = 1
        while _rate(action, calls[name])[1] < LEAST_SECONDS:
            calls[name] *= 2
    rounds = [
        [_rate(action, calls[name])[0] for name, action in actions.items()] for _ in range(repeats)
    ]
    return dict(zip(actions, np.array(rounds).T, strict=True))


def _rate(action: Action, calls: int) -> tuple[float, float]:
    done = seconds = 0.0
    for _ in range(calls):
        prepared = action.prepare()
        start = time.perf_counter()
        done += action.run(prepared)
        seconds += time.perf_counter() - start
    return done / seconds, seconds


def figures_beside(
    rates: Mapping[str, np.ndarray], yardstick: str, targets: Mapping = {}, **about
) -> Iterator[Figure]:
    """A figure for each of some rates but their yardstick's."""
    for name, values in rates.items():
        if name != yardstick:
            about["targets"] = targets.get(name, ())
            yield Figure(
                name, values=values, yardstick=yardstick, yardstick_values=rates[yardstick], **about
            )


def describe_machine() -> dict[str, Any]:
    """What the figures hang on; what the machine does not tell is None or left out."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    caches = {}
    for cache in sorted(Path("/sys/devices/system/cpu/cpu0/cache").glob("index*")):
        level, kind, size = (
            (cache / part).read_text().strip() for part in ("level", "type", "size")
        )
        caches[f"L{level} {kind.lower()}"] = size
    return {
        "processor": models[0] if models else platform.processor() or None,
        "cores": os.cpu_count(),
        "caches": caches,
        "memory_bytes": psutil.virtual_memory().total,
        "load_average": list(psutil.getloadavg()),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
    }
