"""Readings of replicates first … last − 1 as arrays, and their field sums; parts join exactly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.montecarlo.fields import FieldSums
from pipeline.simulate.readings import Readings

DIMS = {  # of a Readings attribute, after `replicate`
    "vertical_stress": ("time", "load_cell"),
    "base_vertical_stress": ("time",),
    "base_vertical_stress_std": ("time",),
    "weight_balance_error": ("time",),
    "negative_s_share": (),
    "movement_zone_height": ("time",),
    "movement_zone_width": ("time",),
    "replicate_mass_drawn": ("time",),
    "drawpoint_shortfall": ("drawpoint",),
    "hang_ups": (),
    "drawn_cell": ("extraction",),
    "drawn_drawpoint": ("extraction",),
    "drawn_mass": ("extraction",),
    "replicate_vertical_stress": ("time", "z", "y", "x"),
}
RAGGED = ("extraction",)  # as long as the replicate has it; padded with -1


@dataclass
class Part:
    """Replicates `first` … `last` − 1.

    Attributes
    ----------
    readings : by name, (replicate, ...) on `DIMS`; only what these replicates have, extraction
        records padded with -1
    sums : of their fields; None where not asked for
    seconds : that they took
    """

    first: int
    last: int
    readings: dict[str, np.ndarray]
    sums: FieldSums | None
    seconds: float

    @property
    def nbytes(self) -> int:
        """Bytes that its arrays take."""
        sums = () if self.sums is None else vars(self.sums).values()
        return sum(getattr(part, "nbytes", 0) for part in (*self.readings.values(), *sums))


def stack(replicates: Sequence[Readings]) -> dict[str, np.ndarray]:
    """Readings of some replicates in order, as in `Part`."""
    stacked = {}
    for name, dims in DIMS.items():
        values = [getattr(readings, name) for readings in replicates]
        if any(value is None for value in values):
            continue
        if dims == RAGGED:
            values = _padded(values)
        stacked[name] = np.array(values)
    return stacked


class Collected:
    """Parts that have been computed or found, in any order; sums are added as they come."""

    def __init__(self):
        self._parts: list[Part] = []
        self.sums: FieldSums | None = None
        self.count = 0

    def add(self, part: Part) -> None:
        """Take a part in; its sums may be changed by it."""
        if self.sums is None:
            self.sums = part.sums
        elif part.sums is not None:
            self.sums += part.sums
        self._parts.append(Part(part.first, part.last, part.readings, None, part.seconds))
        self.count += part.last - part.first

    def gaps(self, count: int) -> list[tuple[int, int]]:
        """What is missing of the first `count` replicates, as (first, last)."""
        missing, reached = [], 0
        for part in self._in_order():
            missing.append((reached, min(part.first, count)))
            reached = part.last
        missing.append((reached, count))
        return [(first, last) for first, last in missing if first < last]

    def first_stresses(self, count: int) -> np.ndarray:
        """Vertical stress (replicate, time, load_cell) of the first `count`, kPa."""
        parts = [part.readings["vertical_stress"] for part in self._in_order()]
        return np.concatenate(parts)[:count]

    def whole(self) -> Part:
        """All of them as one part, in order."""
        parts = self._in_order()
        readings = {}
        for name in parts[0].readings:
            values = [part.readings[name] for part in parts]
            if DIMS[name] == RAGGED:
                width = max(block.shape[1] for block in values)
                values = [_widened(block, width) for block in values]
            readings[name] = np.concatenate(values)
        seconds = sum(part.seconds for part in parts)
        return Part(0, self.count, readings, self.sums, seconds)

    def _in_order(self) -> list[Part]:
        return sorted(self._parts, key=lambda part: part.first)


def _padded(values: Iterable[np.ndarray]) -> list[np.ndarray]:
    width = max(len(value) for value in values)
    return [_widened(value[None], width)[0] for value in values]


def _widened(block: np.ndarray, width: int) -> np.ndarray:
    return np.pad(block, ((0, 0), (0, width - block.shape[1])), constant_values=-1)
