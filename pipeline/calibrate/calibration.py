"""Calibration of an experiment on its own measured rows (eq 6), on common random numbers.

Parameters are fitted in groups, each on the quantities that it acts on: the flow parameters on
the movement zone's height and width, E, E_min and R on stresses, the spread of s on the spatial
standard deviation. The mean stress on a base does not depend on s, so the groups do not fight.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from pipeline.config.experiment import Experiment
from pipeline.config.measured import MeasuredRow
from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.streams import CALIBRATION_FLOW, CALIBRATION_PACKING
from pipeline.montecarlo.workers import Execution
from pipeline.observe import (
    GEOMETRY,
    SPREAD,
    STRESS,
    only_measured,
    row_covariance,
    simulated_rows,
)
from pipeline.parameters import Parameters
from pipeline.simulate.setup import Setup

log = logging.getLogger(__name__)

REPLICATES = {"static": 20, "draw": 5}  # common random numbers of one evaluation
SCAN = 24  # points of the scan that finds the start, for each parameter of a group,
SCAN_REPLICATES = 2  # on the first few of the common random numbers
Z90 = NormalDist().inv_cdf(0.95)
UNTOLD = 1e-10  # of the largest slope: directions in which rows tell nothing of parameters
NOT_SEPARATED = 0.9  # correlation from which two parameters count as not separated
CLOSE = 1e-3  # relative misfit below which a single target counts as reached


@dataclass(frozen=True)
class Scale:
    """How a parameter is searched: bounds of its value and the coordinate it is searched in."""

    unit: str
    low: float
    high: float
    forward: Callable[[float], float]
    backward: Callable[[float], float]
    targets: tuple[str, ...]
    step: float = 1e-4  # of finite differences, in the coordinate

    @property
    def bounds(self) -> tuple[float, float]:
        """Ends of the coordinate, increasing."""
        return tuple(sorted((self.forward(self.low), self.forward(self.high))))


def at_end(u: float, low: float, high: float) -> bool:
    """Whether a coordinate lies at the end of its range, where a fit is none."""
    return bool(min(u - low, high - u) < 1e-3 * (high - low))


def _log_shed(E: float) -> float:
    return math.log1p(-E)


def _from_log_shed(u: float) -> float:
    return -math.expm1(u)


def _same(value: float) -> float:
    return value


SCALES = {
    "E": Scale("1", 1e-4, 1 - 1e-7, _log_shed, _from_log_shed, STRESS),
    "E_min": Scale("1", -5.0, 5.0, _same, _same, STRESS),
    "R": Scale("1", 0.0, 1.0, _same, _same, STRESS),
    "s.std": Scale("1", 1e-2, 1e3, math.log, math.exp, SPREAD),
    "s.mean": Scale("1", -100.0, 200.0, _same, _same, SPREAD),
    "exponent": Scale("1", 0.1, 30.0, math.log, math.exp, GEOMETRY, 0.1),
    "bulking": Scale("1", 1e-3, 0.9, math.log, math.exp, GEOMETRY, 0.1),
}
ALIASES = {"s": "s.std"}
GROUPS = (GEOMETRY, STRESS, SPREAD)


class _Model:
    """Mean over common random numbers of simulated rows, and their scatter.

    `of(targets)` is the same for some of the rows: only their readings are simulated.
    """

    def __init__(self, setup, rows, execution):
        self.setup = only_measured(setup, rows)
        self.rows, self.execution = tuple(rows), execution
        self.count = REPLICATES["draw" if setup.masses else "static"]
        self.simulated = [0]  # replicates, shared with the parts

    def of(self, targets: Sequence[int]) -> _Model:
        part = _Model(self.setup, [self.rows[i] for i in targets], self.execution)
        part.simulated = self.simulated
        return part

    def replicates(self, parameters: Parameters, count: int | None = None) -> np.ndarray:
        """Rows (replicate, row) of all common random numbers, or of the first `count`."""
        count = count or self.count
        self.simulated[0] += count
        dataset, _ = run_replicates(
            self.setup,
            parameters,
            count,
            self.execution,
            (CALIBRATION_PACKING, CALIBRATION_FLOW),
            fields=False,
        )
        return simulated_rows(self.setup.experiment, dataset, self.rows)

    def mean(self, parameters: Parameters, count: int | None = None) -> np.ndarray:
        """Rows (row)."""
        return self.replicates(parameters, count).mean(axis=0)


def calibrate(
    experiment: Experiment,
    setup: Setup,
    declared: Parameters,
    rows: Sequence[MeasuredRow],
    execution: Execution = Execution(),
) -> dict:
    """Fit the experiment's `calibrate` parameters to its measured rows.

    Parameters
    ----------
    setup : made with `rows`; only their readings are simulated
    declared : parameters to start from; the others keep these values

    Returns
    -------
    dict, the content of `calibration.json`: for each parameter `value`, `interval_90`, `unit`,
    `start`, `calibrated`, `at_bound` and `note`; `derived` has ℓ = c / (1 − E) and the Janssen K
    that it implies; `targets` each row with its simulated value and whether it was reached;
    `posterior` the covariance of the fitted parameters in the coordinates of `SCALES`;
    `messages` what a reader must know; `parameters_used` all parameters of a run.
    """
    names = [ALIASES.get(name, name) for name in experiment.calibrate]
    model = _Model(setup, rows, execution)
    parameters = declared
    fitted: list[tuple[list[str], np.ndarray]] = []  # names and their rows, by group
    idle = list(names)
    for group in GROUPS:
        members = [name for name in names if SCALES[name].targets == group]
        targets = np.array([i for i, row in enumerate(rows) if row.quantity in group], dtype=int)
        if members and len(targets):
            fitted.append((members, targets))
            idle = [name for name in idle if name not in members]
    passes = 2 if setup.masses and len(fitted) > 1 else 1
    for turn in range(passes):
        for members, targets in fitted:
            parameters = _fit(model.of(targets), parameters, members, scan=turn == 0)
    return _document(experiment, model, declared, parameters, fitted, idle)


def _fit(model: _Model, parameters: Parameters, names: list[str], scan: bool) -> Parameters:
    """Least squares of a group on all rows of `model`, each over its standard deviation."""
    from scipy.optimize import least_squares, minimize  # here: jobs without a fit do without it

    scales = [SCALES[name] for name in names]
    measured = np.array([row.value for row in model.rows])
    weight = 1.0 / np.array([row.std for row in model.rows])
    low, high = np.array([scale.bounds for scale in scales]).T

    def at(u):
        values = [scale.backward(x) for scale, x in zip(scales, u, strict=True)]
        return parameters.with_values(dict(zip(names, values, strict=True)))

    def residuals(u, count=None):
        return (model.mean(at(u), count) - measured) * weight

    start = np.array([s.forward(parameters.value(n)) for s, n in zip(scales, names, strict=True)])
    start = np.clip(start, low + 1e-9, high - 1e-9)
    if scan:
        starts = [start, *_scan_points(low, high)]
        start = min(starts, key=lambda u: np.sum(residuals(u, SCAN_REPLICATES) ** 2))
    if scales[0].targets == GEOMETRY:  # whole cells: the sum of squares has steps
        solution = minimize(
            lambda u: np.sum(residuals(u) ** 2),
            start,
            method="Nelder-Mead",
            bounds=list(zip(low, high, strict=True)),
            options={"xatol": 0.02, "fatol": 1e-3, "maxfev": 60 * len(names)},
        )
    else:
        steps = [scale.step for scale in scales]
        solution = least_squares(
            residuals,
            start,
            jac=lambda u: _differences(residuals, u, steps, low, high),
            bounds=(low, high),
            xtol=1e-8,
            ftol=1e-10,
            gtol=1e-10,
            max_nfev=40,
        )
    log.info("%s: %s fitted", model.setup.experiment.name, ", ".join(names))
    return at(solution.x)


def _scan_points(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Starts that fill the box between the bounds evenly, (point, coordinate)."""
    if len(low) == 1:
        return np.linspace(low, high, SCAN + 2)[1:-1]
    from scipy.stats import qmc

    sobol = qmc.Sobol(len(low), scramble=False)
    points = sobol.random_base2(math.ceil(math.log2(SCAN * len(low))))
    return qmc.scale(points[1:], low, high)


def _differences(function, u, steps, low, high):
    """Jacobian (value, coordinate) by central differences, one-sided at a bound."""
    columns = []
    for i, step in enumerate(steps):
        ends = np.repeat(u[None], 2, axis=0)
        ends[:, i] = np.clip([u[i] - step, u[i] + step], low[i], high[i])
        columns.append((function(ends[1]) - function(ends[0])) / (ends[1, i] - ends[0, i]))
    return np.column_stack(columns)


def _uncertainty(model, parameters, scatter, fitted) -> tuple[list[str], np.ndarray, list[str]]:
    """Names and covariance of the fitted coordinates, and names of those with a prior's part.

    Each group solves its own normal equations; the sandwich carries the errors of its rows and,
    through the other groups' parameters, of theirs. Row errors: `row_covariance` plus the error
    of a mean over the common random numbers. A parameter or a combination that no row tells of
    gets a prior as wide as its range, where the least squares alone would take it as sure.
    """
    names = [name for members, _ in fitted for name in members]
    if not names:
        return [], np.zeros((0, 0)), []
    scales = [SCALES[name] for name in names]

    def at(u):
        values = [scale.backward(x) for scale, x in zip(scales, u, strict=True)]
        return model.mean(parameters.with_values(dict(zip(names, values, strict=True))))

    u = np.array([s.forward(parameters.value(n)) for s, n in zip(scales, names, strict=True)])
    low, high = np.array([scale.bounds for scale in scales]).T
    jacobian = _differences(at, u, [max(3 * scale.step, 1e-2) for scale in scales], low, high)
    errors = row_covariance(model.rows, scatter) + scatter / model.count
    bread, filling = np.zeros((len(names), len(names))), np.zeros((len(names), len(model.rows)))
    prior = np.zeros_like(bread)
    for members, targets in fitted:
        own = [names.index(name) for name in members]
        weight = np.array([model.rows[i].std for i in targets]) ** -2.0
        weighted = jacobian[np.ix_(targets, own)].T * weight
        bread[own] = weighted @ jacobian[targets]
        filling[np.ix_(own, targets)] = weighted
        white = np.sqrt(weight)[:, None] * jacobian[np.ix_(targets, own)]
        prior[np.ix_(own, own)] = _prior_of_untold(white, (high - low)[own])
    inverse = np.linalg.inv(bread + prior)
    covariance = inverse @ (filling @ errors @ filling.T + prior) @ inverse.T
    return names, covariance, [names[i] for i in np.flatnonzero(prior.diagonal())]


def _prior_of_untold(white: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Precision (parameter, parameter) of a prior where whitened slopes (row, parameter) are 0.

    `sd` (parameter) is the prior's; along what the rows tell of there is none.
    """
    _, told, directions = np.linalg.svd(white * sd)
    untold = directions[np.sum(told > UNTOLD * told.max()) :]
    untold[np.abs(untold) < UNTOLD] = 0.0
    return (untold / sd).T @ (untold / sd)


def _document(experiment, model, declared, parameters, fitted, idle):
    simulated, scatter = np.zeros(0), np.zeros((0, 0))
    if fitted:
        replicates = model.replicates(parameters)
        simulated = replicates.mean(axis=0)
        scatter = np.atleast_2d(np.cov(replicates, rowvar=False))
    names, covariance, untold = _uncertainty(model, parameters, scatter, fitted)
    messages: list[str] = []
    entries = {}
    for name, scale in SCALES.items():
        if parameters.value(name) is None or (name == "E_min" and parameters.E_min is None):
            continue
        value = parameters.value(name)
        entry = {
            "value": value,
            "interval_90": None,
            "unit": scale.unit,
            "start": declared.value(name),
            "calibrated": name in names,
            "at_bound": False,
        }
        if name in names:
            u = scale.forward(value)
            half = Z90 * math.sqrt(covariance[names.index(name), names.index(name)])
            low, high = scale.bounds
            ends = [scale.backward(x) for x in np.clip([u - half, u + half], low, high)]
            entry["interval_90"] = sorted(ends)
            entry["interval_open"] = bool(u - half < low or u + half > high)
            entry["at_bound"] = at_end(u, low, high)
            if name in untold:
                messages.append(
                    f"{name}: no measured value tells of it, or tells it from the others; a prior "
                    "as wide as its range stands in"
                )
            elif entry["interval_open"] and not entry["at_bound"]:
                messages.append(f"{name}: its 90 % interval is open, the data do not bound it")
            if entry["at_bound"]:
                messages.append(f"{name} = {value:.4g} lies at the end of its range: not a fit")
        if name in idle:
            wanted = ", ".join(scale.targets)
            messages.append(f"{name} keeps its start: no measured {wanted} to fit it to")
        entries[name] = entry
    messages += _not_separated(names, covariance)
    standard_error = np.sqrt(np.diag(scatter) / model.count)
    targets = _targets(model, simulated, standard_error, fitted, messages)
    return {
        "experiment": experiment.name,
        "schema_version": "1.0",
        "data_label": experiment.data_label,
        "objective": "eq 6: sum of squared differences, each over its standard deviation",
        "parameters": entries,
        "derived": _derived(experiment, parameters, entries.get("E")),
        "correlation": {"parameters": names, "matrix": _correlation(covariance).tolist()},
        "posterior": {
            "parameters": names,
            "coordinates": [SCALES[name].forward(parameters.value(name)) for name in names],
            "covariance": covariance.tolist(),
        },
        "targets": targets,
        "messages": messages,
        "common_random_replicates": model.count,
        "simulated_replicates": model.simulated[0],
        "declared": declared.to_document(),
        "parameters_used": parameters.to_document(),
    }


def _correlation(covariance: np.ndarray) -> np.ndarray:
    sd = np.sqrt(np.diag(covariance))
    return covariance / np.maximum(np.outer(sd, sd), np.finfo(float).tiny)


def _not_separated(names: list[str], covariance: np.ndarray) -> list[str]:
    """What the data cannot tell apart: pairs of parameters that trade for each other."""
    correlation = _correlation(covariance)
    return [
        f"the data hardly separate {names[i]} and {names[j]}: correlation {correlation[i, j]:+.2f}"
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) > NOT_SEPARATED
    ]


def _targets(model, simulated, standard_error, fitted, messages):
    """Each fitted row beside its simulated value; a lone target out of reach is said so."""
    targets = []
    for members, indices in fitted:
        exact = len(indices) <= len(members)
        for i in indices:
            row, value = model.rows[i], float(simulated[i])
            reached = abs(value - row.value) <= CLOSE * abs(row.value) if exact else None
            target = {
                "quantity": row.quantity,
                "load_cell": row.load_cell,
                "fill_height": row.fill_height,
                "mass_drawn": row.mass_drawn,
                "measured": row.value,
                "std": row.std,
                "simulated": value,
                "simulated_standard_error": float(standard_error[i]),
                "fitted_by": members,
                "reached": reached,
            }
            if reached is False:
                limit = "ceiling" if value < row.value else "floor"
                target[limit] = value
                messages.append(_out_of_reach(model, members, row, value, limit))
            targets.append(target)
    return targets


def _out_of_reach(model, members, row, value, limit):
    text = (
        f"measured {row.quantity} {row.value:.4g} is out of reach of {', '.join(members)}: "
        f"the {limit} is {value:.4g}"
    )
    if row.quantity in SPREAD:
        means = [r.value for r in model.rows if r.quantity == "vertical_stress"]
        if len(means) == 1:
            text += f", {value / means[0]:.2f} of the mean (measured: {row.value / means[0]:.2f})"
    return text


def _derived(experiment: Experiment, parameters: Parameters, entry: dict) -> dict:
    """ℓ = c / (1 − E) and, with a wall friction angle, K = R_h / (ℓ tan φ_w) (Janssen)."""
    interval = entry["interval_90"]

    def length(E: float) -> float:
        return math.inf if E >= 1.0 else parameters.cell_size / (1.0 - E)

    derived = {
        "attenuation_length": {
            "value": length(entry["value"]),
            "interval_90": [length(E) for E in interval] if interval else None,
            "unit": "m",
        },
        "hydraulic_radius": {"value": experiment.geometry.hydraulic_radius, "unit": "m"},
    }
    if experiment.walls is not None and experiment.walls.friction_angle > 0:
        per_length = experiment.geometry.hydraulic_radius / math.tan(
            math.radians(experiment.walls.friction_angle)
        )
        derived["janssen_K"] = {
            "value": per_length / length(entry["value"]),
            "interval_90": sorted(per_length / length(E) for E in interval) if interval else None,
            "unit": "1",
        }
    return derived
