"""Prediction of an experiment's readings: how wide its bands are, and what makes them so.

What is not known is drawn again and again, each time for two packings (and flows), those of the
plain replicates 2 i and 2 i + 1. Each is simulated up to three times: with parameters and effects
at their best values, with the parameters drawn from their posterior and effects as they imply, and
with the effects drawn too. What two packings have in common under the same draw is due to what was
drawn; what they differ in, to the packing: the law of total variance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment
from pipeline.config.measured import QUANTITIES, MeasuredRow
from pipeline.effects import Active, apply, ordered
from pipeline.files.netcdf import EFFECTS_IMPLIED, PACKING_ONLY
from pipeline.lattice.block_model import build_block_model
from pipeline.montecarlo.checkpoints import Checkpoints
from pipeline.montecarlo.replicates import VARIED, Run, replicates_dataset, run_each
from pipeline.montecarlo.streams import (
    PREDICTION_READINGS,
    PREDICTION_UNKNOWNS,
    random_stream,
)
from pipeline.montecarlo.workers import Execution
from pipeline.observe import simulated_rows
from pipeline.parameters import FIELDS, Parameters
from pipeline.predict.knowledge import AMPLITUDE, Knowledge, Point
from pipeline.simulate.setup import Setup, make_setup

PACKING, CALIBRATION, EFFECT, INTERACTION = "packing", "calibration", "effect", "interaction"
SOURCES = (PACKING, CALIBRATION, EFFECT, INTERACTION)
LEVELS = (PACKING, CALIBRATION, EFFECT)  # of what is drawn: each with those before it
SUFFIXES = {PACKING: PACKING_ONLY, CALIBRATION: EFFECTS_IMPLIED, EFFECT: ""}
PERCENTILES = (5, 10, 50, 90, 95)
STRESSES = ("vertical_stress", "base_vertical_stress")
DRAWN = {FIELDS[name]: f"sampled_{FIELDS[name]}" for name in FIELDS}
SAME = 1e-9  # sd over mean below which readings do not scatter
SCHEMA_VERSION = "1.0"


@dataclass(frozen=True)
class SampledRun(Run):
    """Replicates with parameters and effects that change from pair to pair.

    `points` (pair) are these; `key` is JSON-able data that decides them.
    """

    points: tuple[Point, ...] = ()
    key: Any = None

    def of(self, replicate: int) -> tuple[Setup, Parameters]:
        """Setup and parameters of a replicate."""
        parameters, active = self.points[replicate // 2]
        return with_effects(self.setup, active), parameters

    @property
    def decided_by(self) -> Any:
        """What decides the points, whatever their number."""
        return self.key


def with_effects(setup: Setup, active: Sequence[Active]) -> Setup:
    """The setup with other effects; made anew where they fill the model to another height."""
    active = ordered(tuple(active))
    if active == setup.effects:
        return setup
    declared = setup.experiment.geometry.height
    heights = {float(apply(each, "geometry", declared)) for each in (active, setup.effects)}
    if len(heights) == 1 and not setup.acts_on("geometry"):
        return replace(setup, effects=active)
    made = make_setup(setup.experiment, build_block_model(setup.experiment), effects=active)
    levels = tuple(float(apply(active, "geometry", level)) for level in setup.fill_levels)
    return replace(
        made,
        fill_levels=setup.fill_levels,
        true_levels=levels,
        masses=setup.masses,
        to_the_end=setup.to_the_end,
    )


def predict(
    experiment: Experiment,
    block_model: xr.Dataset,
    known: Knowledge,
    rows: Sequence[MeasuredRow] = (),
    was_fitted: Callable[[MeasuredRow], bool] = lambda row: False,
    execution: Execution = Execution(),
    checkpoints: Checkpoints | None = None,
) -> tuple[xr.Dataset, dict[str, Any]]:
    """Content of `prediction.nc` and `prediction.json`.

    Parameters
    ----------
    block_model : of the experiment as declared
    rows : measured rows to hold against the bands; their heights and masses join the readings
    was_fitted : whether a row has gone into what is `known`

    Returns
    -------
    dataset : stresses (sample, time, load_cell) and (sample, time) in kPa at each level, their
        percentiles (level, percentile, ...), the variance of the whole and the shares of it
        (source, ...) with standard errors, and what was drawn (sample)
    document : where the posterior comes from, its unknowns, and each row with its 90 % band

    Raises
    ------
    ValueError
        If the posterior has no sample within its bounds.
    """
    count = experiment.prediction.samples
    samples = Samples(experiment, known, count // 2)
    quiet = experiment.model_copy(update={"keep_fields": False})
    _, best_effects = known.at(known.best)
    setup = make_setup(quiet, block_model, tuple(rows), effects=best_effects)
    setup = replace(setup, to_the_end=False)
    runs = {
        level: SampledRun(setup, points[0][0], fields=False, points=points, key=samples.key(level))
        for level, points in samples.points.items()
    }
    readings = run_each(runs, count, execution, checkpoints)
    *others, whole = readings
    variants = {SUFFIXES[level]: readings[level] for level in others}
    dataset = replicates_dataset(setup, readings[whole], variants)
    keep = [name for name in dataset if _is_wanted(name)]
    dataset = dataset[keep].rename(replicate="sample")
    levels = _suffixes(list(readings))
    dataset = dataset.assign(_summary(dataset, levels)).assign(samples.variables(experiment))
    dataset = dataset.assign_coords(
        percentile=("percentile", np.array(PERCENTILES, dtype=np.float64)),
        source_name=("source", np.array(SOURCES, dtype="S")),
        level_name=("level", np.array(LEVELS, dtype="S")),
    )
    document = {
        "experiment": experiment.name,
        "schema_version": SCHEMA_VERSION,
        "data_label": experiment.data_label,
        "samples": count,
        "simulated_replicates": count * len(readings),
        "known_from": known.source,
        "remarks": [*known.remarks, *_remarks(known)],
        "unknowns": samples.document(),
        "variance_share": _overall(dataset),
        "readings": _readings(experiment, dataset, levels, rows, was_fitted),
    }
    return dataset, document


def _suffixes(simulated: Sequence[str]) -> list[str]:
    """Suffix of the variables of each level; one that was not simulated is like that before it."""
    suffixes = []
    for level in LEVELS:
        if level in simulated:
            suffix = "" if level == simulated[-1] else SUFFIXES[level]
        suffixes.append(suffix)
    return suffixes


def _is_wanted(name: str) -> bool:
    """Whether a variable of the replicates belongs to a prediction."""
    plain = name.removesuffix(PACKING_ONLY).removesuffix(EFFECTS_IMPLIED)
    kept = ("mass_drawn", "fill_height", "load_cell_width", "load_cell_length")
    return plain in VARIED or name in kept


class Samples:
    """What is drawn, once for each pair: the points of levels that differ from the one before."""

    def __init__(self, experiment: Experiment, known: Knowledge, count: int):
        self._known = known
        drawn = []
        for place in range(count):
            stream = random_stream(experiment.seed, experiment.name, PREDICTION_UNKNOWNS, place)
            drawn.append(known.sample(stream))
        shape = count, len(known.unknowns)
        self.drawn, self.implied = (
            np.array([pair[i] for pair in drawn]).reshape(shape) for i in (0, 1)
        )

    @cached_property
    def points(self) -> dict[str, tuple[Point, ...]]:
        """Points (pair) by level; one where nothing more is drawn is left out."""
        at = self._known.at
        best = at(self._known.best)
        levels = {PACKING: (best,) * len(self.drawn)}
        for level, coordinates in ((CALIBRATION, self.implied), (EFFECT, self.drawn)):
            points = tuple(at(one) for one in coordinates)
            if points != levels[list(levels)[-1]]:
                levels[level] = points
        return levels

    def key(self, level: str) -> list:
        """What decides a level's points, whatever their number."""
        return [level, self._known.document]

    @property
    def values(self) -> np.ndarray:
        """What was drawn (pair, unknown), in the unknowns' units."""
        columns = zip(self._known.unknowns, self.drawn.T, strict=True)
        each = [[one.value(u) for u in column] for one, column in columns]
        return np.array(each, dtype=np.float64).reshape(self.drawn.shape[::-1]).T

    def variables(self, experiment: Experiment) -> dict[str, tuple]:
        """Parameters (sample) of the runs, and amplitudes (sample, amplitude) of effects."""
        last = self.points[list(self.points)[-1]]
        found = {}
        for attribute, name in DRAWN.items():
            values = [getattr(parameters, attribute) for parameters, _ in last]
            acts = attribute not in ("R", "E_min_shift") or experiment.is_draw
            if None not in values and acts:
                found[name] = ("sample", np.repeat(np.array(values, dtype=np.float64), 2))
        places = [i for i, one in enumerate(self._known.unknowns) if one.kind == AMPLITUDE]
        if places:
            labels = [self._known.unknowns[i].label for i in places]
            units = [self._known.unknowns[i].unit for i in places]
            found["sampled_amplitude"] = (
                ("sample", "amplitude"),
                np.repeat(self.values[:, places], 2, axis=0),
            )
            found["amplitude_name"] = ("amplitude", np.array(labels, dtype="S"))
            found["amplitude_unit"] = ("amplitude", np.array(units, dtype="S"))
        return found

    def document(self) -> list[dict[str, Any]]:
        """Each unknown's best value and the percentiles of its samples."""
        untold = self._known.untold
        return [
            {
                "label": one.label,
                "kind": one.kind,
                "unit": one.unit,
                "best": one.value(one.best),
                "mean": float(column.mean()),
                "std": float(column.std(ddof=1)),
                **{f"p{p:02d}": float(np.percentile(column, p)) for p in PERCENTILES},
                "at_bound": one.at_bound,
                "identified": one not in untold,
            }
            for one, column in zip(self._known.unknowns, self.values.T, strict=True)
        ]


def _remarks(known: Knowledge) -> list[str]:
    if not known.unknowns:
        return ["Nothing here was calibrated: the band is that of the packing alone."]
    return [
        *(
            f"The data tell next to nothing of {one.label}, alone or apart from other unknowns: it "
            "is drawn from its prior, and a band that hangs on it claims nothing."
            for one in known.untold
        ),
        *(
            f"The data do not bound {one.label}: its 90 % interval leaves its range, where its "
            "normal posterior is cut off. A band that hangs on it is a guess."
            for one in known.open
        ),
    ]


# ---------------------------------------------------------------------------------------------
# bands and shares


def _summary(dataset: xr.Dataset, levels: Sequence[str]) -> dict[str, tuple]:
    """Percentiles, variance and its shares of load cells and of the base."""
    found = {}
    for name in STRESSES:
        dims = dataset[name].dims[1:]
        steps = [dataset[f"{name}{suffix}"].values for suffix in levels]
        percentiles, error = zip(*map(percentiles_of, steps), strict=True)
        variance, share, share_error = variance_shares(*steps)
        found |= {
            f"{name}_percentile": (("level", "percentile", *dims), np.array(percentiles)),
            f"{name}_percentile_se": (("level", "percentile", *dims), np.array(error)),
            f"{name}_variance": (dims, variance),
            f"{name}_variance_share": (("source", *dims), share),
            f"{name}_variance_share_se": (("source", *dims), share_error),
        }
    return found


def _overall(dataset: xr.Dataset) -> dict[str, float | None]:
    """Shares of the variance of all load cells at all readings together."""
    variance = dataset["vertical_stress_variance"].values
    share = dataset["vertical_stress_variance_share"].values
    weight = np.where(np.isfinite(share[0]), variance, 0.0)
    if not weight.any():
        return dict.fromkeys(SOURCES)
    parts = (np.nansum(share * weight, axis=(1, 2)) / weight.sum()).tolist()
    return dict(zip(SOURCES, parts, strict=True))


def percentiles_of(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`PERCENTILES` over the first axis and their Monte Carlo standard errors, (percentile, ...).

    The error is half the distance of the order statistics whose ranks are one binomial standard
    deviation below and above (Woodruff 1952, J. Am. Stat. Assoc. 47, 635-646), as if each pair
    were one sample: not too small, whatever pairs have in common.
    """
    n, p = len(values) // 2, np.array(PERCENTILES) / 100.0
    off = np.sqrt(p * (1.0 - p) / n)
    found = np.quantile(values, p, axis=0)
    low, high = (np.quantile(values, np.clip(ranks, 0, 1), axis=0) for ranks in (p - off, p + off))
    return found, 0.5 * (high - low)


def variance_shares(
    packing: np.ndarray, calibration: np.ndarray, whole: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The variance of the whole, what each source has of it, and the error of these shares.

    With θ the parameters and a the amplitudes, Var Y = E[Var(Y | θ, a)] + Var E[Y | θ, a]:
    `packing` is Var(Y) at the best values and `interaction` what E[Var(Y | θ, a)] is beyond that;
    `calibration` is Var E[Y | θ], and `effect` what Var E[Y | θ, a] is beyond that. They add up to
    1; none but the first two hangs on whether packings stay alike as parameters change, as those
    of a flow do not. Sequence for unknowns that are correlated: Mara & Tarantola 2012, Reliab. Eng.
    Syst. Saf. 107, 115-121; estimates from pairs: Sobol' 1993, Math. Model. Comput. Exp. 1,
    407-414, with the packing at the best values as control variate.

    Parameters
    ----------
    packing, calibration, whole : (sample, ...) of the three levels, on the same packings; samples
        2 i and 2 i + 1 have the same draw and independent packings

    Returns
    -------
    variance : (...) of `whole`, in its unit squared
    share, error : (source, ...) in the order of `SOURCES`, NaN where nothing scatters. Estimates
        are unbiased and may be below 0 by chance. Errors are the jackknife's over pairs (Efron &
        Stein 1981, Ann. Stat. 9, 586-596).
    """
    pairs = [level.reshape(-1, 2, *level.shape[1:]) for level in (packing, calibration, whole)]
    at_best, with_parameters, with_all = pairs
    n = len(at_best)
    terms = [
        0.5 * (at_best[:, 0] - at_best[:, 1]) ** 2,
        _common(with_parameters, at_best),
        _common(with_all, at_best),
        0.5 * (with_all[:, 0] - with_all[:, 1]) ** 2,
    ]
    each = np.stack(terms)  # (term, pair, ...)
    total = each.mean(axis=1)
    mean = whole.mean(axis=0)
    variance, share = _shares(total, mean)
    without = (n * total[:, None] - each) / (n - 1)
    _, others = _shares(without, mean)
    return variance, share, np.sqrt((n - 1) * others.var(axis=1))


def _common(level: np.ndarray, at_best: np.ndarray) -> np.ndarray:
    """Terms (pair, ...) whose mean is the covariance of a pair's two values (pair, 2, ...).

    Less what each value has of its packing: the values at the best parameters, whose two packings
    have nothing in common, times the slope on them.
    """
    off = level - level.mean(axis=0)
    known = at_best - at_best.mean(axis=0)
    square = (known**2).sum(axis=(0, 1))
    slope = np.where(square > 0.0, (off * known).sum(axis=(0, 1)) / np.maximum(square, 1e-300), 0.0)
    rest = off - slope * known
    n = len(level)
    return rest[:, 0] * rest[:, 1] * n / (n - 1)


def _shares(terms: np.ndarray, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variance of the whole and shares (source, ...) from the means of the four terms."""
    packing, calibration, known, scatter = terms
    variance = known + scatter
    parts = np.stack([packing, calibration, known - calibration, scatter - packing])
    with np.errstate(invalid="ignore", divide="ignore"):
        return variance, np.where(variance > (SAME * mean) ** 2, parts / variance, np.nan)


# ---------------------------------------------------------------------------------------------
# against what was measured


def _readings(experiment, dataset, levels, rows, was_fitted) -> list[dict[str, Any]]:
    """Each measured row with the band of such a reading.

    The band holds the row's own errors, and the packing's scatter as its `count` says: of a mean
    over n packings 1 / √n of it, and none where the row's sd holds it already.
    """
    if not rows:
        return []
    replicates = dataset.rename(sample="replicate")
    values = simulated_rows(experiment, replicates, rows)
    packing = simulated_rows(experiment, replicates, rows, levels[0])
    share = np.array([1.0 / np.sqrt(row.count) if row.count else 0.0 for row in rows])
    errors = np.array([_errors(experiment, rows, place) for place in range(len(values))])
    values = values - (1.0 - share) * (packing - packing.mean(axis=0)) + errors
    found, _ = percentiles_of(values)
    return [
        {
            "quantity": row.quantity,
            "unit": QUANTITIES[row.quantity],
            "load_cell": row.load_cell,
            "fill_height": row.fill_height,
            "mass_drawn": row.mass_drawn,
            "count": row.count,
            "measured": row.value,
            "measured_sd": float(np.hypot(row.std, row.std_shared)),
            **{f"p{p:02d}": float(v) for p, v in zip(PERCENTILES, found[:, i], strict=True)},
            "within_90": bool(found[0, i] <= row.value <= found[-1, i]),
            "used_in_calibration": bool(was_fitted(row)),
        }
        for i, row in enumerate(rows)
    ]


def _errors(experiment: Experiment, rows: Sequence[MeasuredRow], place: int) -> np.ndarray:
    """Errors (row) of the instruments in one sample, own and shared by a load cell's readings."""
    random = random_stream(experiment.seed, experiment.name, PREDICTION_READINGS, place)
    own = random.standard_normal(len(rows)) * [row.std for row in rows]
    groups = {key: random.standard_normal() for key in dict.fromkeys(map(_sensor, rows))}
    return own + np.array([row.std_shared * groups[_sensor(row)] for row in rows])


def _sensor(row: MeasuredRow) -> tuple:
    return row.load_cell, row.quantity
