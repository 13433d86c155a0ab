"""Errors before and after, on what was fitted and on what was not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.config.measured import QUANTITIES, MeasuredRow
from pipeline.loop.fit import offset_at
from pipeline.loop.model import Model, Point

BOOTSTRAPS = 2000
VARIANTS = ("before", "after", "recalibrated_only", "gaussian_process")


def predicted(model: Model, point: Point, rows: Sequence[int]) -> np.ndarray:
    """Expected rows (row) at a point, over all replicates; NaN but for `rows`' cases."""
    view = model.only(rows)
    return view.mean(point) + offset_at(view, point)


def errors(
    model: Model, measured: Sequence[MeasuredRow], rows: Sequence[int], expected: np.ndarray
) -> dict:
    """`rms_kpa`, `rms_log`, `mean_absolute_kpa` and `n` of expected values (rows).

    kPa over stresses, logarithms over all positive quantities; None where there are none.
    """
    rows = np.asarray(rows, dtype=int)
    value = np.array([measured[i].value for i in rows])
    is_log = model.is_log[rows]
    in_kpa = np.array([QUANTITIES[measured[i].quantity] == "kPa" for i in rows], dtype=bool)
    plain = np.where(is_log, np.exp(np.where(is_log, expected, 0.0)), expected)
    off = (plain - value)[in_kpa]
    logs = (expected - np.log(np.where(is_log, value, 1.0)))[is_log]
    return {
        "rms_kpa": _rms(off),
        "rms_log": _rms(logs),
        "mean_absolute_kpa": float(np.abs(off).mean()) if off.size else None,
        "n": len(rows),
    }


def ratio_interval(
    model: Model,
    measured: Sequence[MeasuredRow],
    rows: Sequence[int],
    before: np.ndarray,
    after: np.ndarray,
    random: np.random.Generator,
) -> tuple[float | None, list[float] | None]:
    """RMS log error after over before, and its 90 % interval over blocks drawn anew.

    Blocks are load cells of an experiment; where each has but one reading, experiments.
    """
    rows = np.asarray(rows, dtype=int)
    keep = model.is_log[rows]
    if not keep.any():
        return None, None
    logs = np.log([measured[i].value for i in rows[keep]])
    old, new = (before[keep] - logs) ** 2, (after[keep] - logs) ** 2
    if not old.sum() > 0.0:
        return None, None
    ratio = float(np.sqrt(new.sum() / old.sum()))
    keys = [(model.case_of[i], model.rows[i].load_cell) for i in rows[keep]]
    numbers = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    blocks = np.array([numbers[key] for key in keys])
    if len(numbers) < 2:
        return ratio, None
    sums = np.array([np.bincount(blocks, weights=part) for part in (old, new)])
    chosen = random.integers(len(numbers), size=(BOOTSTRAPS, len(numbers)))
    drawn_old, drawn_new = sums[:, chosen].sum(axis=2)
    ratios = np.sqrt(drawn_new / np.maximum(drawn_old, 1e-300))
    return ratio, [float(q) for q in np.quantile(ratios, [0.05, 0.95])]


def _rms(values: np.ndarray) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None
