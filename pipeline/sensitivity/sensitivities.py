"""Derivatives of simulated readings with respect to parameters and amplitudes of effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import xarray as xr

from pipeline import effects as catalogue
from pipeline.calibrate.calibration import SCALES
from pipeline.config.effects import NOT_MEASURED
from pipeline.config.experiment import DRAW_PARAMETERS
from pipeline.config.measured import QUANTITIES, MeasuredRow
from pipeline.config.stress import EMinTable
from pipeline.effects import Active, State, apply, lacking, ordered
from pipeline.lattice.adjoint import Influence
from pipeline.lattice.cells import MOVEMENT, STAGNANT
from pipeline.montecarlo.replicates import run_replicates
from pipeline.montecarlo.streams import CALIBRATION_FLOW, CALIBRATION_PACKING, replicate_streams
from pipeline.montecarlo.workers import Execution, run_tasks
from pipeline.observe import GEOMETRY, simulated_rows
from pipeline.parameters import Parameters
from pipeline.sensitivity.footprints import row_gradients
from pipeline.simulate.setup import Setup, make_setup
from pipeline.simulate.sweeps import Sweep

ADJOINT, DIFFERENCE, ABSENT = "adjoint", "difference", "absent"
DENSITY = "density_misdeclared.factor"
STEP = 0.05  # of differences, in a parameter's scale
STEPPED_STEP = 0.25  # where the flow changes with the parameter, cell by cell,
STEPPED_REPLICATES = 4  # with so many times the replicates
HALVINGS = 3  # of the step, until halving it changes nothing that matters:
RELATIVE = 0.02  # of the derivative, or
NEGLIGIBLE = 1e-3  # of the reading, for a change of the parameter by its scale


class Case(NamedTuple):
    """An experiment whose readings are differentiated: at `parameters`, with `effects` in force.

    `setup` is made with `rows`, its measured rows; the effects that it was made with give way to
    `effects`.
    """

    setup: Setup
    parameters: Parameters
    effects: tuple[Active, ...]
    rows: Sequence[MeasuredRow]


@dataclass(frozen=True)
class Coordinate:
    """What a derivative is taken with respect to, and the size of a usual change of it."""

    words: str
    unit: str
    scale: float


COORDINATES = {  # of the parameters, as `calibrate` searches them
    "E": Coordinate("log(1 - E)", "1", 1.0),
    "s.std": Coordinate("log(s.std)", "1", 1.0),
    "s.mean": Coordinate("s.mean", "1", 2.0),
    "R": Coordinate("R", "1", 0.5),
    "E_min": Coordinate("shift of log(1 - E_min)", "1", 1.0),
    "exponent": Coordinate("log(exponent)", "1", 1.0),
    "bulking": Coordinate("log(bulking)", "1", 1.0),
}


def coordinates() -> dict[str, Coordinate]:
    """All that readings can be differentiated with respect to: parameters, then EFFECT.PARAMETER.

    An effect's parameter is its own coordinate, with the scale of its prior.
    """
    found = dict(COORDINATES)
    for name, effect in catalogue.effects().items():
        for p in effect.parameters:
            found[f"{name}.{p.name}"] = Coordinate(f"{name}.{p.name}", p.unit, p.scale)
    return found


def sensitivities(
    cases: Sequence[Case],
    replicates: int = 20,
    parameters: Iterable[str] | None = None,
    execution: Execution = Execution(),
    purposes: tuple[int, int] = (CALIBRATION_PACKING, CALIBRATION_FLOW),
) -> xr.Dataset:
    """Derivatives of all readings of some experiments, means over common-random replicates.

    Each is with respect to the parameter of the reading's own experiment (of its own load cell,
    for an effect with that scope); who shares one value among experiments adds nothing, who
    doesn't splits the column by `experiment`.

    E and, without draw, a misdeclared density come exactly, from the adjoint of the sweep, as
    long as no effect acts. The others come from central differences on the same streams, one-sided
    where a bound or the neutral value of a one-sided effect is near. The step is `STEP` of the
    parameter's scale and is halved until that changes nothing that matters, at most `HALVINGS`
    times; the last two are extrapolated to no step. Where the drawn cells change with the
    parameter, readings answer in steps of whole cells: there it is one step of `STEPPED_STEP`
    of the scale, with `STEPPED_REPLICATES` times the replicates and no extrapolation.

    Parameters
    ----------
    cases : experiments in the order of their readings; see `Case`
    replicates : number of common-random replicates of each evaluation
    parameters : names out of `coordinates()`; None: all
    purposes : stream purposes of packing and flow

    Returns
    -------
    Dataset on (reading, parameter):

    - `sensitivity`: in the reading's unit per the unit of the coordinate, and its
      `standard_error` over the replicates (NaN with one);
    - `step_error`: estimate of the error that the step leaves, same unit, and `step_ok`, whether
      it is within 2 % of the derivative, 0.1 % of the reading for a change by the scale, or two
      standard errors of itself;
    - `step` of the difference, in the coordinate; NaN without;
    - `method`: "adjoint", "difference" or "absent" where the experiment has no such parameter
      or lacks an input of the effect: sensitivity 0;
    - `replicate_count`;
    - `value` of the parameter (not of its coordinate), NaN where absent;

    and `simulated` with `simulated_se` on (reading). Coordinates: `experiment`, `load_cell`
    ("" for the base), `quantity`, `unit`, `fill_height`, `mass_drawn` (NaN where there is none)
    by reading; `coordinate`, `parameter_unit`, `scale` by parameter.

    Raises
    ------
    KeyError
        If `parameters` names one that does not exist.
    """
    known = coordinates()
    names = list(known) if parameters is None else list(parameters)
    wanted = {name: known[name] for name in names}
    parts = [_of_case(Case(*case), wanted, replicates, execution, purposes) for case in cases]
    dataset = xr.concat(parts, "reading") if len(parts) > 1 else parts[0]
    return dataset.assign_coords(
        parameter=names,
        coordinate=("parameter", [c.words for c in wanted.values()]),
        parameter_unit=("parameter", [c.unit for c in wanted.values()]),
        scale=("parameter", [c.scale for c in wanted.values()]),
    )


# ---------------------------------------------------------------------------------------------
# one experiment


@dataclass(frozen=True)
class _Column:
    """Derivatives by one parameter: values (row), or (replicate, row) for `each`."""

    method: str
    each: np.ndarray
    value: np.ndarray
    step: float = math.nan
    error: np.ndarray | float = 0.0
    ok: np.ndarray | bool = True


@dataclass(frozen=True)
class _Direction:
    """How one parameter is varied: `at(change)` of its coordinate, within `low` and `high`.

    `value` (row) is where it stands; `of_flow` says whether other cells may be drawn with it.
    """

    at: Callable[[float], tuple[Parameters, tuple[Active, ...]]]
    low: float
    high: float
    value: np.ndarray
    of_flow: bool


def _of_case(case, wanted, count, execution, purposes) -> xr.Dataset:
    model = _Model(case, execution, purposes)
    base = model.rows_at(case.parameters, model.effects, count).values
    exact = _adjoint(model, count, wanted)
    columns = []
    for name, coordinate in wanted.items():
        direction = _direction(model, name)
        if direction is None:
            nothing = np.full(len(case.rows), math.nan)
            columns.append(_Column(ABSENT, np.zeros_like(base), nothing))
        elif name in exact:
            columns.append(_Column(ADJOINT, exact[name], direction.value))
        else:
            columns.append(_differences(model, direction, coordinate.scale, count))
    return _dataset(case, base, columns)


def _dataset(case, simulated, columns) -> xr.Dataset:
    size = (len(columns), len(case.rows))
    named = {
        "sensitivity": [column.each.mean(axis=0) for column in columns],
        "standard_error": [_standard_error(column.each) for column in columns],
        "step_error": [np.broadcast_to(column.error, size[1]) for column in columns],
        "step_ok": [np.broadcast_to(column.ok, size[1]) for column in columns],
        "step": [np.full(size[1], column.step) for column in columns],
        "method": [np.full(size[1], column.method) for column in columns],
        "replicate_count": [np.full(size[1], len(column.each)) for column in columns],
        "value": [column.value for column in columns],
    }
    data = {
        name: (("reading", "parameter"), np.reshape(values, size).T)
        for name, values in named.items()
    }
    data["simulated"] = ("reading", simulated.mean(axis=0))
    data["simulated_se"] = ("reading", _standard_error(simulated))
    rows, experiment = case.rows, case.setup.experiment
    coords = {
        "experiment": [experiment.name] * len(rows),
        "load_cell": [row.load_cell or "" for row in rows],
        "quantity": [row.quantity for row in rows],
        "unit": [QUANTITIES[row.quantity] for row in rows],
        "fill_height": [_number(row.fill_height) for row in rows],
        "mass_drawn": [_number(row.mass_drawn) for row in rows],
    }
    return xr.Dataset(data, coords={name: ("reading", value) for name, value in coords.items()})


class _Evaluation(NamedTuple):
    """Rows (replicate, row), and the cells (replicate, extraction) that were drawn, in order."""

    values: np.ndarray
    drawn: np.ndarray


class _Model:
    """Simulated rows of a case at other parameters and effects, on common random numbers."""

    def __init__(self, case: Case, execution: Execution, purposes: tuple[int, int]):
        self.case, self.execution, self.purposes = case, execution, purposes
        self.effects = ordered(case.effects)
        self.setup = self.with_effects(self.effects)
        self._unmoved: dict[int, _Evaluation] = {}

    @property
    def experiment(self):
        return self.case.setup.experiment

    def rows_at(self, parameters, effects, count) -> _Evaluation:
        """Rows of `count` replicates; those of the case itself are run once."""
        if (parameters, effects) != (self.case.parameters, self.effects):
            return self._run(parameters, effects, count)
        if count not in self._unmoved:
            self._unmoved[count] = self._run(parameters, effects, count)
        return self._unmoved[count]

    def _run(self, parameters, effects, count) -> _Evaluation:
        setup = self.with_effects(effects)
        dataset, _ = run_replicates(
            setup, parameters, count, self.execution, self.purposes, fields=False
        )
        drawn = dataset["drawn_cell"].values if setup.masses else np.zeros(0)
        return _Evaluation(simulated_rows(setup.experiment, dataset, self.case.rows), drawn)

    def with_effects(self, effects: tuple[Active, ...]) -> Setup:
        """The case's setup under these effects; made anew where they change the geometry."""
        setup, rows = self.case.setup, self.case.rows
        height = setup.experiment.geometry.height
        if apply(effects, "geometry", height) != apply(setup.effects, "geometry", height):
            dtype = setup.cell_weight.dtype.type
            made = make_setup(setup.experiment, rows=rows, dtype=dtype, effects=effects)
            levels = setup.fill_levels
            setup = replace(
                made,
                fill_levels=levels,
                true_levels=tuple(float(apply(effects, "geometry", level)) for level in levels),
                masses=setup.masses,
                to_the_end=setup.to_the_end,
            )
        return replace(setup, effects=effects)


def _direction(model: _Model, name: str) -> _Direction | None:
    if name in SCALES:
        return _of_parameter(model, name)
    effect, _, parameter = name.partition(".")
    return _of_effect(model, effect, parameter)


def _of_parameter(model: _Model, name: str) -> _Direction | None:
    parameters, scale = model.case.parameters, SCALES[name]
    if name in DRAW_PARAMETERS and not model.setup.masses:
        return None
    value = parameters.value(name)
    if value is None or (name == "E_min" and parameters.E_min is None):
        return None
    start = scale.forward(min(max(value, scale.low), scale.high))
    low, high = scale.bounds

    def at(change):
        if change == 0.0 and scale.low <= value <= scale.high:
            return parameters, model.effects
        return parameters.with_values({name: scale.backward(start + change)}), model.effects

    values = np.full(len(model.case.rows), value)
    return _Direction(at, low - start, high - start, values, scale.targets == GEOMETRY)


def _of_effect(model: _Model, name: str, parameter: str) -> _Direction | None:
    effect, experiment = catalogue.effects()[name], model.experiment
    places: tuple[str | None, ...] = (None,)
    if effect.scope == "load_cell":
        if experiment.data_label in NOT_MEASURED:
            return None
        places = tuple(cell.name for cell in experiment.load_cells)
    given = {one.load_cell: one for one in model.effects if one.name == name}
    active = [given.get(place, Active(name, effect.neutral, place)) for place in places]
    if not active or lacking(effect, experiment, active[0].values):
        return None
    (described,) = (p for p in effect.parameters if p.name == parameter)
    values = {one.load_cell: one.values[parameter] for one in active}
    others = [one for one in model.effects if one.name != name]

    def at(change):
        if change == 0.0:
            return model.case.parameters, model.effects
        moved = [
            replace(one, values={**one.values, parameter: one.values[parameter] + change})
            for one in active
        ]
        return model.case.parameters, ordered([*others, *moved])

    low, high = described.low, described.high
    if described.sign > 0:
        low = max(low, described.neutral)
    elif described.sign < 0:
        high = min(high, described.neutral)
    of_row = [values.get(row.load_cell if None not in values else None) for row in model.case.rows]
    return _Direction(
        at,
        max(low - value for value in values.values()),
        min(high - value for value in values.values()),
        np.array([_number(value) for value in of_row]),
        effect.geometry is not None or effect.packing is not None,
    )


# ---------------------------------------------------------------------------------------------
# differences


class _Stencil:
    """Difference quotients of a case's rows in one direction, central where the bounds allow."""

    def __init__(self, model: _Model, direction: _Direction, step: float, count: int):
        self._model, self._at, self._count = model, direction.at, count
        self.step = min(step, 0.5 * (direction.high - direction.low))
        if direction.low <= -self.step and direction.high >= self.step:
            self._ends, self.order = (1.0, -1.0), 2
        else:
            self._ends, self.order = (1.0 if direction.high >= self.step else -1.0, 0.0), 1
        self._known: dict[float, _Evaluation] = {}

    def _end(self, change: float) -> _Evaluation:
        if change not in self._known:
            self._known[change] = self._model.rows_at(*self._at(change), self._count)
        return self._known[change]

    def slope(self, part: float) -> np.ndarray:
        """Quotient (replicate, row) over `part` of the step."""
        above, below = (end * part * self.step for end in self._ends)
        return (self._end(above).values - self._end(below).values) / (above - below)

    def draws_otherwise(self) -> bool:
        """Whether other cells are drawn at the two ends of the step."""
        one, other = (self._end(end * self.step).drawn for end in self._ends)
        return not np.array_equal(one, other)


def _differences(model: _Model, direction: _Direction, scale: float, count: int) -> _Column:
    """Column of one parameter; see `sensitivities` for the steps."""
    simulated = model.rows_at(model.case.parameters, model.effects, count).values.mean(axis=0)
    tolerance = NEGLIGIBLE * np.abs(simulated) / scale
    large = STEPPED_STEP * scale
    if direction.of_flow and _Stencil(model, direction, large, count).draws_otherwise():
        stencil = _Stencil(model, direction, large, STEPPED_REPLICATES * count)
        each, half = stencil.slope(1.0), stencil.slope(0.5)
        error, ok = _judge(each, half - each, tolerance)
        return _Column(DIFFERENCE, each, direction.value, stencil.step, error, ok)
    stencil = _Stencil(model, direction, STEP * scale, count)
    whole = stencil.slope(1.0)
    for halving in range(1, HALVINGS + 1):
        half = stencil.slope(0.5**halving)
        rest = (half - whole) / (2**stencil.order - 1)  # Richardson: what no step would add
        error, ok = _judge(half + rest, rest, tolerance)
        if ok.all():
            break
        whole = half
    step = stencil.step * 0.5**halving
    return _Column(DIFFERENCE, half + rest, direction.value, step, error, ok)


def _judge(each, off, tolerance) -> tuple[np.ndarray, np.ndarray]:
    """Error (row) that the step leaves, and whether it is small enough."""
    error = np.abs(off.mean(axis=0))
    allowed = np.maximum(RELATIVE * np.abs(each.mean(axis=0)), tolerance)
    if len(off) > 1:
        allowed = np.maximum(allowed, 2.0 * _standard_error(off))
    return error, error <= allowed


def _standard_error(each: np.ndarray) -> np.ndarray:
    """Of the mean over replicates, (row); NaN with one."""
    count = len(each)
    if count == 1:
        return np.full(each.shape[1], math.nan)
    return each.std(axis=0, ddof=1) / math.sqrt(count)


def _number(value: float | None) -> float:
    return math.nan if value is None else value


# ---------------------------------------------------------------------------------------------
# the adjoint


def _adjoint(model: _Model, count: int, wanted: Iterable[str]) -> dict[str, np.ndarray]:
    """Derivatives (replicate, row) that one adjoint sweep for each row gives without a step.

    By log(1 − E), and without draw by the factor on all weights. An effect that changes what
    the sweep takes or what the sensors say may hang on E or on weights itself: then none.
    """
    setup, parameters, rows = model.setup, model.case.parameters, model.case.rows
    if any(setup.acts_on(stage) for stage in ("packing", "state", "readings")):
        return {}
    names = {"E": 0} if setup.masses else {"E": 0, DENSITY: 1}
    names = {name: place for name, place in names.items() if name in wanted}
    if not names:
        return {}

    def project(sweep: Sweep, state: State, found: Influence) -> np.ndarray:
        shed = np.where(_follows_E(sweep, parameters), sweep.shed_fraction, 0.0)
        by_log_shed = np.tensordot(found.shed, shed, axes=3)
        by_factor = np.tensordot(found.weight, sweep.weight.astype(np.float64), axes=3)
        return np.column_stack([by_log_shed, by_factor])

    def gradient(k: int) -> np.ndarray:
        streams = replicate_streams(setup.experiment, k, model.purposes)
        return row_gradients(setup, parameters, rows, project, *streams)

    gradients = run_tasks([partial(gradient, k) for k in range(count)], model.execution)
    return {name: np.array(gradients)[:, :, place] for name, place in names.items()}


def _follows_E(sweep: Sweep, parameters: Parameters) -> np.ndarray:
    """Cells (z, y, x) that shed 1 − E: stagnant ones, and moving ones where E_min is no less."""
    follows = sweep.code == STAGNANT
    if not isinstance(parameters.E_min, EMinTable) or parameters.E_min_shift:
        own = sweep.shed_fraction.dtype.type(1.0 - parameters.E)
        follows |= (sweep.code == MOVEMENT) & (sweep.shed_fraction == own)
    return follows
