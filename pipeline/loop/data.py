"""What was measured, as the loop takes it: logarithms, and what their errors share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.config.measured import MeasuredRow
from pipeline.loop.model import Model


@dataclass(frozen=True)
class Data:
    """Measured values of the rows that a fit may see; nothing of any other row.

    Attributes
    ----------
    use : (n) their numbers among the model's rows
    y : (n) logarithms of positive quantities, geometry as it is
    independent : (n) variance of what is independent from reading to reading
    shared : (n, n) covariance of what the readings of one load cell share
    scatter : (n) part of one packing's scatter that is in the value: 1 / sqrt(count), or 0
    """

    use: np.ndarray
    y: np.ndarray
    independent: np.ndarray
    shared: np.ndarray
    scatter: np.ndarray


def observed(model: Model, measured: Sequence[MeasuredRow], use: Sequence[int]) -> Data:
    """The measured rows `use` (numbers among the model's rows) and nothing else.

    `measured` are in the model's order. Errors are relative to the measured value, as errors of
    load cells are.
    """
    use = np.asarray(use, dtype=int)
    rows = [measured[i] for i in use]
    is_log = model.is_log[use]
    value = np.array([row.value for row in rows])
    size = np.where(is_log, value, 1.0)
    blocks: dict[tuple, int] = {}  # of one experiment, load cell and quantity
    keys = [(model.case_of[i], r.load_cell, r.quantity) for i, r in zip(use, rows, strict=True)]
    groups = np.array([blocks.setdefault(key, len(blocks)) for key in keys], dtype=int)
    together = np.array([row.std_shared for row in rows]) / size
    same = groups[:, None] == groups[None, :]
    with np.errstate(divide="ignore"):
        return Data(
            use=use,
            y=np.where(is_log, np.log(size), value),
            independent=(np.array([row.std for row in rows]) / size) ** 2,
            shared=np.where(same, np.outer(together, together), 0.0),
            scatter=np.array([1.0 / np.sqrt(row.count) if row.count else 0.0 for row in rows]),
        )
