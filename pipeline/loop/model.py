"""What the readings of a study should be: their log means and scatter at any point of the model.

A point is the calibrated parameters and the amplitudes of effects. Everything is on common random
numbers; nothing here knows a measured value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from pipeline.calibrate.calibration import ALIASES, SCALES, Scale
from pipeline.config.experiment import DRAW_PARAMETERS, Experiment
from pipeline.config.measured import MeasuredRow
from pipeline.config.study import Shared
from pipeline.effects import Active, apply, declared_effects, effects, ordered
from pipeline.montecarlo.streams import LOOP_FLOW, LOOP_PACKING, random_stream
from pipeline.montecarlo.workers import Execution, run_tasks
from pipeline.observe import GEOMETRY, RowReader, only_measured
from pipeline.parameters import Parameters, carry_transmission, declared_parameters
from pipeline.simulate.flow import FlowRecord
from pipeline.simulate.replicate import record_flow, simulate
from pipeline.simulate.setup import Setup, make_setup

CRN, FEW = 4, 2  # common random replicates of an evaluation; where packings do not differ
SCATTER, OTHERS = 90, 54  # replicates that the covariance is made of, and others for null laws
CLEAR = 4.0  # a derivative's square over that of its error, from which it is one
SAME = 1e-9  # relative difference within which packings do not differ
LEAST = 0.01  # of the largest replicate: a simulated stress below it is taken for it
FLOW_BYTES = 600_000_000  # that kept flows may take together
MOST_POINTS = 20_000  # whose parameters are remembered
CHUNK = 16  # replicates of a task
# of a calibrated coordinate: sd of the weak prior about its declared value, and a usual change
PRIOR_SD = {"E": 100.0, "s.std": 1.0, "s.mean": 4.0, "R": 0.6, "E_min": 2.0}
SIZE = {"s.std": 0.5, "s.mean": 2.0, "R": 0.3, "exponent": 0.5}
STEP, FLOW_STEP = 0.02, 0.25  # of differences, in a coordinate's scale
FAR_STEP = 8.0  # of an amplitude's scale: where what saturates has done so


@dataclass(frozen=True)
class Case:
    """An experiment of a study and the places of its rows; their values are withheld (NaN)."""

    experiment: Experiment
    rows: tuple[MeasuredRow, ...]
    declared: Parameters


@dataclass(frozen=True)
class Coordinate:
    """A calibrated parameter of a group of cases, in the coordinate of `SCALES`."""

    name: str
    key: str | None
    cases: tuple[int, ...]
    start: float
    low: float
    high: float

    @property
    def scale(self) -> Scale:
        """How the parameter is searched."""
        return SCALES[self.name]

    @property
    def size(self) -> float:
        """Size of a usual change of the coordinate."""
        return SIZE.get(self.name, 1.0)

    @property
    def label(self) -> str:
        """Name with what shares the value."""
        return self.name if self.key is None else f"{self.name} [{self.key}]"


@dataclass(frozen=True)
class Term:
    """An amplitude: one parameter of an effect for all cases that share its value.

    `key` is the material, experiment or load cell that it belongs to; None for the whole study.
    `options` are the effect's choices, as (name, choice).
    """

    effect: str
    parameter: str
    scope: str
    key: str | None
    cases: tuple[int, ...]
    options: tuple[tuple[str, object], ...] = ()

    @property
    def described(self):
        """The effect's `Parameter`."""
        (found,) = (p for p in effects()[self.effect].parameters if p.name == self.parameter)
        return found

    @property
    def label(self) -> str:
        """Effect, parameter and key."""
        options = "".join(f" {choice}" for _, choice in self.options)
        where = f" [{self.key}]" if self.key is not None else ""
        return f"{self.effect}.{self.parameter}{options}{where}"


@dataclass(frozen=True)
class Point:
    """Where the model stands: coordinates, and the amplitudes of the terms that were added."""

    coordinates: tuple[float, ...]
    terms: tuple[Term, ...] = ()
    amplitudes: tuple[float, ...] = ()

    def moved(self, coordinates: Iterable[float], amplitudes: Iterable[float]) -> Point:
        """The same model elsewhere."""
        return Point(tuple(map(float, coordinates)), self.terms, tuple(map(float, amplitudes)))

    def without(self, terms: Sequence[Term]) -> Point:
        """With some terms taken out."""
        pairs = zip(self.terms, self.amplitudes, strict=True)
        kept = [(t, a) for t, a in pairs if t not in terms]
        return Point(self.coordinates, tuple(t for t, _ in kept), tuple(a for _, a in kept))

    def with_terms(self, terms: Sequence[Term], amplitudes: Sequence[float]) -> Point:
        """With more terms."""
        return Point(
            self.coordinates,
            (*self.terms, *terms),
            (*self.amplitudes, *map(float, amplitudes)),
        )


@dataclass
class Model:
    """Simulated rows of all cases, of all their replicates, remembered.

    Rows are numbered through all cases. Positive quantities are taken as logarithms, geometry as
    it is.
    """

    cases: tuple[Case, ...]
    shared: tuple[Shared, ...]
    execution: Execution = field(default_factory=Execution)
    _setups: list[Setup] = field(init=False)
    _readers: list[RowReader] = field(init=False)
    _values: dict = field(init=False, default_factory=dict)
    _flows: dict = field(init=False, default_factory=dict)
    _at: dict = field(init=False, default_factory=dict)
    _count: dict[str, int] = field(init=False)

    def __post_init__(self):
        self._count = {"simulated": 0, "flow_bytes": 0}
        self._setups = [self._setup(case, ()) for case in self.cases]
        self._readers = [
            RowReader(setup, case.rows)
            for setup, case in zip(self._setups, self.cases, strict=True)
        ]
        sizes = [len(case.rows) for case in self.cases]
        ends = np.cumsum([0, *sizes])
        self.slices = [slice(a, b) for a, b in pairwise(ends)]
        self.rows = [row for case in self.cases for row in case.rows]
        self.case_of = np.repeat(np.arange(len(self.cases)), sizes)
        self.is_log = np.array([row.quantity not in GEOMETRY for row in self.rows], dtype=bool)
        self._share = np.array([1.0 / row.count if row.count else 0.0 for row in self.rows])
        self.coordinates = tuple(self._coordinates())
        self.active = tuple(range(len(self.cases)))
        self._crn = [self._common(case) for case in self.active]

    def __getstate__(self) -> dict:
        """Without what it remembers: another process simulates for itself."""
        return self.__dict__ | {"_values": {}, "_flows": {}, "_at": {}}

    def _common(self, case: int) -> int:
        """Common replicates of a case: few where the means over its base are all alike."""
        rows, setup = self.cases[case].rows, self._setups[case]
        if setup.masses or any(r.load_cell or r.quantity != "vertical_stress" for r in rows):
            return CRN
        ground = declared_effects(self.cases[case].experiment)
        values = self._simulate(case, self.cases[case].declared, ground, (None, ()), range(3))
        rows = self._readers[case].sensed(values, replace(setup, effects=()))
        return FEW if np.ptp(rows, axis=0).max() <= SAME * rows.max() else CRN

    def _view(self, **replaced) -> Model:
        """The same model with other attributes, and what either remembers in common."""
        view = object.__new__(Model)
        view.__dict__ = self.__dict__ | replaced
        return view

    def alone(self) -> Model:
        """The same model for a process of its own, without workers."""
        return self._view(execution=Execution())

    def only(self, rows: Sequence[int]) -> Model:
        """The same model, which simulates nothing but the cases of some rows: others are NaN."""
        return self._view(active=tuple(sorted({int(self.case_of[i]) for i in rows})))

    # -- points ------------------------------------------------------------------------------

    @property
    def simulated(self) -> int:
        """Replicates of cases that were simulated so far."""
        return self._count["simulated"]

    @property
    def start(self) -> Point:
        """The model as declared."""
        return Point(tuple(c.start for c in self.coordinates))

    @property
    def prior_sd(self) -> np.ndarray:
        """Sd (coordinate) of the weak priors about the declared values."""
        return np.array([PRIOR_SD.get(c.name, 1.0) for c in self.coordinates])

    def _coordinates(self):
        for shared in self.shared:
            name = ALIASES.get(shared.name, shared.name)
            groups: dict[str | None, list[int]] = {}
            for i, case in enumerate(self.cases):
                if not _has(case, name):
                    continue
                experiment = case.experiment
                key = {"material": experiment.material.name, "experiment": experiment.name}
                groups.setdefault(key.get(shared.shared_by), []).append(i)
            scale = SCALES[name]
            low, high = scale.bounds
            for key, members in groups.items():
                starts = [self._start_of(i, members[0], name) for i in members]
                start = float(np.clip(np.mean(starts), low, high))
                yield Coordinate(name, key, tuple(members), start, low, high)

    def _start_of(self, case: int, reference: int, name: str) -> float:
        """Declared coordinate of a case, its E on the reference's lattice."""
        scale, declared = SCALES[name], self.cases[case].declared
        value = declared.value(name)
        if name == "E":
            to = self.cases[reference].declared.cell_size
            height = self.cases[case].experiment.geometry.height
            value = carry_transmission(value, declared.cell_size, to, height)
        return scale.forward(float(np.clip(value, scale.low, scale.high)))

    def at(self, point: Point, case: int) -> tuple[Parameters, tuple[Active, ...]]:
        """Parameters and effects of a case at a point."""
        known = self._at.get((id(point), case))
        if known is None or known[0] is not point:
            if len(self._at) > MOST_POINTS:
                self._at.clear()
            known = self._at[id(point), case] = point, self._found_at(point, case)
        return known[1]

    def _found_at(self, point: Point, case: int) -> tuple[Parameters, tuple[Active, ...]]:
        subject = self.cases[case]
        values = {}
        for coordinate, u in zip(self.coordinates, point.coordinates, strict=True):
            if case not in coordinate.cases:
                continue
            value = coordinate.scale.backward(u)
            if coordinate.name == "E":
                reference = self.cases[coordinate.cases[0]].declared.cell_size
                height = subject.experiment.geometry.height
                value = carry_transmission(value, reference, subject.declared.cell_size, height)
            values[coordinate.name] = value
        return subject.declared.with_values(values), self._active(point, case)

    def _active(self, point: Point, case: int) -> tuple[Active, ...]:
        found: dict[tuple, dict] = {}
        names = {cell.name for cell in self.cases[case].experiment.load_cells}
        for term, amplitude in zip(point.terms, point.amplitudes, strict=True):
            if case not in term.cases:
                continue
            effect = effects()[term.effect]
            cell = term.key if effect.scope == "load_cell" else None
            if cell is not None and cell not in names:
                continue
            values = found.setdefault(
                (term.effect, cell, term.options), effect.neutral | dict(term.options)
            )
            values[term.parameter] = amplitude
        active = [Active(name, values, cell) for (name, cell, _), values in found.items()]
        active = [one for one in active if not one.is_neutral]
        return ordered([*declared_effects(self.cases[case].experiment), *active])

    # -- values ------------------------------------------------------------------------------

    def mean(self, point: Point, flow_at: Point | None = None) -> np.ndarray:
        """Expected rows (row) on the common random replicates.

        `flow_at` keeps the flow of another point, for a derivative without the noise of other
        paths.
        """
        self.prepare([(point, flow_at)])
        rows = np.full(len(self.rows), np.nan)
        for case in self.active:
            rows[self.slices[case]] = self._of_case(case, point, flow_at)
        return rows

    def prepare(self, points: Iterable[tuple[Point, Point | None]]) -> None:
        """Simulate what `mean` will want of these points, all at once."""
        wanted = {}
        for point, flow_at in points:
            for case in self.active:
                key, job = self._job(case, point, flow_at)
                if key not in self._values:
                    wanted[key] = *job, range(self._crn[case])
        self._count["simulated"] += sum(len(job[-1]) for job in wanted.values())
        results = self._run(list(wanted.values()))
        for key, values in zip(wanted, results, strict=True):
            self._values[key] = values

    def _job(self, case: int, point: Point, flow_at: Point | None):
        parameters, active = self.at(point, case)
        flow = self.at(flow_at or point, case)
        ground = tuple(a for a in active if not _is_sensor(a))
        key = (case, parameters, _key(ground), _flow_key(*flow) if self._is_draw(case) else None)
        return key, (case, parameters, ground, flow)

    def _of_case(self, case: int, point: Point, flow_at: Point | None) -> np.ndarray:
        key, (_, _, ground, flow) = self._job(case, point, flow_at)
        values = self._values[key]
        sensors = tuple(a for a in self.at(point, case)[1] if _is_sensor(a))
        rows = self._readers[case].sensed(values, replace(self._setups[case], effects=sensors))
        expected = self._expected(case, rows)
        if self._is_draw(case) and self._height(case, ground) != self._height(case, flow[1]):
            return self._as_before_draw(case, point, flow_at, expected)
        return expected

    def _as_before_draw(self, case, point, flow_at, expected):
        """Rows of the flow's own point, moved by what its readings before draw are moved by.

        A lattice of another height has no flow in common: the change before draw is taken for all
        masses, and ratios stay.
        """
        reader, kept = self._readers[case], self._of_case(case, flow_at, None)
        same = [row.quantity == "vertical_stress_ratio" for row in self.cases[case].rows]
        first = reader.before_draw
        moved = expected[first] - kept[first]
        return kept + np.where(np.array(same) | (first < 0), 0.0, moved)

    def common(self, case: int) -> int:
        """Number of common random replicates of a case."""
        return self._crn[case]

    def counts(self, case: int) -> tuple[int, int]:
        """Replicates of `scatter` for the covariance and others; few without any scatter."""
        of_packings = any(row.count for row in self.cases[case].rows)
        return (SCATTER, OTHERS) if of_packings else (self._crn[case], self._crn[case])

    def scatter(self, point: Point, case: int, count: int | None = None) -> np.ndarray:
        """Rows (replicate, row) of many replicates, see `counts`; the first are the common ones.

        Positive quantities as logarithms.
        """
        count = count or sum(self.counts(case))
        key, (_, parameters, ground, _) = self._job(case, point, None)
        known = self._values.get(("scatter", key))
        if known is not None:
            known = known[:count]
        elif count == self._crn[case]:
            self.prepare([(point, None)])
            known = self._values[key]
        if known is None:
            self._count["simulated"] += count
            here = (case, parameters, ground, (parameters, ground))
            starts = range(0, count, CHUNK)
            parts = self._run([(*here, range(a, min(a + CHUNK, count))) for a in starts])
            known = self._values["scatter", key] = np.concatenate(parts)
        sensors = tuple(a for a in self.at(point, case)[1] if _is_sensor(a))
        rows = self._readers[case].sensed(known, replace(self._setups[case], effects=sensors))
        return np.where(self.is_log[self.slices[case]], np.log(_floored(rows)), rows)

    def kept(self, point: Point, case: int) -> np.ndarray:
        """What `scatter` keeps of its replicates, (replicate, value), for `recall`."""
        self.scatter(point, case)
        return self._values["scatter", self._job(case, point, None)[0]]

    def recall(self, point: Point, case: int, values: np.ndarray) -> None:
        """Take `values` of an earlier run for what `scatter` would simulate at a point."""
        key = self._job(case, point, None)[0]
        self._values["scatter", key] = values
        self._values[key] = values[: self._crn[case]]

    def scatter_mean(self, point: Point, case: int) -> np.ndarray:
        """Expected rows (row) of a case over all replicates of `scatter`."""
        values = self.scatter(point, case)
        is_log = self.is_log[self.slices[case]]
        return self._expected(case, np.where(is_log, np.exp(np.where(is_log, values, 0.0)), values))

    def _expected(self, case: int, rows: np.ndarray) -> np.ndarray:
        """Expected value of a mean over as many packings as each row's `count` says.

        Of one packing the mean logarithm, of many the logarithm of the mean; between them in
        1 / count.
        """
        where = self.slices[case]
        share, is_log = self._share[where], self.is_log[where]
        mean = rows.mean(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            whole = np.log(np.where(is_log, np.maximum(mean, 1e-300), 1.0))
            each = np.log(np.where(is_log, _floored(rows), 1.0)).mean(axis=0)
        return np.where(is_log, whole + share * (each - whole), mean)

    # -- simulation --------------------------------------------------------------------------

    def _run(self, jobs: Sequence[tuple]) -> list[np.ndarray]:
        """Raw values (replicate, value) of each job, see `RowReader`."""
        return run_tasks([partial(self._simulate, *job) for job in jobs], self.execution)

    def _simulate(self, case, parameters, ground, flow, replicates) -> np.ndarray:
        setup, reader = self._setups[case], self._readers[case]
        setup = self._with_effects(case, setup, ground)
        same_lattice = self._height(case, ground) == self._height(case, flow[1])
        if self._is_draw(case) and not same_lattice:
            setup = replace(setup, masses=setup.masses[:1])
        values = []
        for k in replicates:
            packing, drawn = self.stream(LOOP_PACKING, case, k), None
            if self._is_draw(case) and same_lattice:
                drawn = self.flow(case, flow, k)
            elif self._is_draw(case):
                drawn = self.stream(LOOP_FLOW, case, k)
            readings = simulate(setup, parameters, packing, drawn)
            values.append(reader.values(readings))
        return np.array(values)

    def stream(self, purpose: int, case: int, replicate: int) -> np.random.Generator:
        """Stream of packing or flow of a case's replicate."""
        experiment = self.cases[case].experiment
        return random_stream(experiment.seed, experiment.name, purpose, replicate)

    def flow(self, case: int, at: tuple, replicate: int) -> FlowRecord:
        """Flow of a case's replicate at (parameters, effects); kept while there is room."""
        key = (case, *_flow_key(*at), replicate)
        record = self._flows.get(key)
        if record is None:
            setup = self._with_effects(case, self._setups[case], at[1])
            streams = (self.stream(what, case, replicate) for what in (LOOP_PACKING, LOOP_FLOW))
            record = record_flow(setup, at[0], *streams)
            if self._count["flow_bytes"] + record.nbytes <= FLOW_BYTES:
                self._flows[key] = record
                self._count["flow_bytes"] += record.nbytes
        return record

    def setup_at(self, point: Point, case: int) -> tuple[Setup, Parameters, tuple]:
        """Setup, parameters and flow key of a case at a point, for derivatives."""
        parameters, active = self.at(point, case)
        ground = tuple(a for a in active if not _is_sensor(a))
        setup = self._with_effects(case, self._setups[case], ground)
        return setup, parameters, (parameters, ground)

    def _with_effects(self, case: int, setup: Setup, active: tuple[Active, ...]) -> Setup:
        if self._height(case, active) != self._height(case, setup.effects):
            return self._setup(self.cases[case], active)
        return replace(setup, effects=active)

    def _setup(self, case: Case, active: tuple[Active, ...]) -> Setup:
        experiment = case.experiment
        made = make_setup(experiment, rows=case.rows, effects=active)
        return only_measured(made, case.rows)

    def _height(self, case: int, active: tuple[Active, ...]) -> float:
        return float(apply(active, "geometry", self.cases[case].experiment.geometry.height))

    def _is_draw(self, case: int) -> bool:
        return self.cases[case].experiment.is_draw

    # -- derivatives -------------------------------------------------------------------------

    def jacobian(
        self, point: Point, terms: Sequence[Term] = (), steps: float = STEP
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of `mean` by the coordinates (row, coordinate) and by terms (row, term).

        Terms are those given: of the point (where they stand), or others (at neutral).
        """
        moves = [self._ends_of_coordinate(point, j, steps) for j in range(len(self.coordinates))]
        moves += [self._ends_of_term(point, term, steps) for term in terms]
        whole = self._differences(moves)
        return whole[:, : len(self.coordinates)], whole[:, len(self.coordinates) :]

    def chords(self, point: Point, terms: Sequence[Term]) -> np.ndarray:
        """Mean change (row, term) of `mean` by terms, out to `FAR_STEP` of their scales.

        What saturates points elsewhere there than its derivative does.
        """
        return self._differences([self._ends_of_term(point, term, FAR_STEP) for term in terms])

    def _differences(self, moves: Sequence[tuple]) -> np.ndarray:
        """Differences (row, move) of `mean` between the ends of each move, by its length."""
        self.prepare((end, flow_at) for ends in moves for end, _, flow_at in ends)
        columns = []
        for (above, up, flow_up), (below, down, flow_down) in moves:
            difference = self.mean(above, flow_up) - self.mean(below, flow_down)
            columns.append(difference / (up - down))
            if not self._is_clear(above, flow_up, below, flow_down):
                columns[-1] = np.zeros(len(self.rows))
        return np.column_stack(columns) if columns else np.zeros((len(self.rows), 0))

    def _is_clear(self, above: Point, flow_above, below: Point, flow_below) -> bool:
        """Whether two points differ by more than a few replicates' chance.

        What acts through random draws of its own alone, such as another factor in each packing,
        moves no mean, but the mean of few replicates.
        """
        signal = error = 0.0
        for case in self.active:
            ends = [self._job(case, above, flow_above)[0], self._job(case, below, flow_below)[0]]
            if ends[0] == ends[1]:
                continue
            one, other = (self._values[key] for key in ends)
            with np.errstate(invalid="ignore", divide="ignore"):
                each = np.log(_floored(one)) - np.log(_floored(other))
            each = each[:, np.isfinite(each).all(axis=0)]
            signal += float((each.mean(axis=0) ** 2).sum())
            error += float(each.var(axis=0, ddof=1).sum()) / len(each)
        return signal == 0.0 or signal > CLEAR * error

    def _ends_of_coordinate(self, point: Point, j: int, steps: float):
        coordinate, u = self.coordinates[j], point.coordinates[j]
        of_flow = coordinate.scale.targets == GEOMETRY
        step = (FLOW_STEP if of_flow else steps) * coordinate.size

        def end(change: float):
            moved = list(point.coordinates)
            moved[j] = u + change
            return point.moved(moved, point.amplitudes), change, None if of_flow else point

        room = coordinate.high - u >= step
        return end(step if room else -step), end(-step if of_flow and room else 0.0)

    def _ends_of_term(self, point: Point, term: Term, steps: float):
        described = term.described
        if term not in point.terms:
            point = point.with_terms([term], [described.neutral])
        place = point.terms.index(term)
        at = point.amplitudes[place]
        _, high = limits(term)
        step = steps * described.scale

        def end(change: float):
            moved = list(point.amplitudes)
            moved[place] = at + change
            return point.moved(point.coordinates, moved), change, point

        return end(step if high - at >= step else -step), end(0.0)

    def log_slopes(self, point: Point, case: int, slopes: np.ndarray) -> np.ndarray:
        """Derivatives (row, direction) of `mean`, from those of raw rows.

        `slopes` are (replicate, row, direction), of the first of the common replicates.
        """
        self.prepare([(point, None)])
        key, _ = self._job(case, point, None)
        unsensed = replace(self._setups[case], effects=())
        values = self._readers[case].sensed(self._values[key][: len(slopes)], unsensed)[..., None]
        where = self.slices[case]
        share, is_log = self._share[where][:, None], self.is_log[where][:, None]
        values = np.where(is_log, _floored(values), 1.0)
        each = (slopes / values).mean(axis=0)
        whole = slopes.mean(axis=0) / values.mean(axis=0)
        return whole + share * (each - whole)


def has_chord(term: Term) -> bool:
    """Whether a term may go as far to one side as `Model.chords` looks, and to no other."""
    low, high = limits(term)
    p = term.described
    return p.neutral == low and high - low > FAR_STEP * p.scale


def limits(term: Term) -> tuple[float, float]:
    """Bounds of a term's amplitude, on the side that physics leaves it."""
    p = term.described
    low = max(p.low, p.neutral) if p.sign > 0 else p.low
    high = min(p.high, p.neutral) if p.sign < 0 else p.high
    return low, high


def declared_of(experiments: Mapping[str, Experiment], name: str) -> Parameters:
    """Parameters as declared, through what `stress: {from: NAME}` refers to."""
    source = experiments[name].stress.from_
    sources = {} if source is None else {source: declared_of(experiments, source)}
    return declared_parameters(experiments[name], sources)


def _has(case: Case, name: str) -> bool:
    if name in DRAW_PARAMETERS and not case.experiment.is_draw:
        return False
    if name == "E_min":
        return case.declared.E_min is not None
    return case.declared.value(name) is not None


def _is_sensor(active: Active) -> bool:
    effect = active.effect
    return effect.readings is not None and not (effect.geometry or effect.packing or effect.state)


def _key(active: tuple[Active, ...]) -> tuple:
    return tuple((a.name, a.load_cell, tuple(sorted(a.values.items()))) for a in active)


def _flow_key(parameters: Parameters, active: tuple[Active, ...]) -> tuple:
    masses = tuple(a for a in active if a.effect.geometry or a.effect.packing)
    return parameters.exponent, parameters.bulking, _key(masses)


def _floored(rows: np.ndarray) -> np.ndarray:
    """Rows (replicate, row) without zeros."""
    return np.maximum(rows, LEAST * np.maximum(rows.max(axis=0), 1e-9))
