"""Tables of an experiment's page: parameters, data beside the model, what was published, inputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pipeline.config.experiment import Experiment
from pipeline.config.measured import QUANTITIES
from pipeline.config.messages import shown
from pipeline.effects import declared_effects
from pipeline.report.page import Badge, Data, Table, decimals_of, parts
from pipeline.report.results import ASSUMED, Results, is_assumed, quantity_words
from pipeline.validate.validation import CALIBRATED, DECLARED, FALLEN

PARAMETERS = {  # name in calibration.json: (words, key in the experiment's file, acts in draw only)
    "E": ("E: share of its load that a cell at rest passes on", "stress.E", False),
    "s.mean": ("mean of the spreading exponent s", "stress.s.mean", False),
    "s.std": ("sd of s from cell to cell", "stress.s.std", False),
    "R": ("R: relaxation of weights onto the movement zone", "stress.R", True),
    "E_min": ("E_min: shift of log(1 − E_min)", "stress.E_min", True),
    "exponent": ("n: flow exponent", "flow.exponent", True),
    "bulking": ("q: bulking", "flow.bulking", True),
}


def parameter_table(results: Results, data: Data) -> Table:
    """Each parameter's start, value, interval and what is to be said of it."""
    experiment, calibration = results.experiment, results.calibration
    published = experiment.published is not None
    table = Table(
        "parameters",
        "Parameters of the run. ℓ = c / (1 − E) is the length over which load is shed, K the "
        "ratio of horizontal to vertical stress that Janssen's law asks for with this ℓ and the "
        "wall friction angle.",
        [
            "Parameter",
            f"Start, {'published' if published else 'as declared'}",
            "Used",
            "90 % interval: from",
            "90 % interval: to",
            "Unit",
            "Remarks",
        ],
        data,
    )
    unreached = {
        name
        for target in calibration["targets"]
        if target["reached"] is False
        for name in target["fitted_by"]
    }
    for name, (words, key, draw_only) in PARAMETERS.items():
        entry = calibration["parameters"].get(name)
        if entry is None or (draw_only and not experiment.is_draw):
            continue
        remarks = [Badge("calibrated", "good") if entry["calibrated"] else "kept at its start"]
        if entry["at_bound"]:
            remarks.append(Badge("at the end of its range: not a fit", "bad"))
        if entry.get("interval_open"):
            remarks.append(Badge("interval open: reaches the end of the range", "warn"))
        if name in unreached:
            remarks.append(Badge("its target is out of reach", "bad"))
        if is_assumed(experiment, key):
            remarks.append(ASSUMED)
        table.rows.append(
            _parameter_row(table, words, entry["start"], entry, entry["unit"], remarks)
        )
    for name, words in (
        ("attenuation_length", "ℓ: length over which load is shed"),
        ("janssen_K", "K: stress ratio that this ℓ implies"),
    ):
        if name in calibration["derived"]:
            entry = calibration["derived"][name]
            table.rows.append(
                _parameter_row(table, words, None, entry, entry["unit"], "follows from E")
            )
    return table.without_empty_columns()


def _parameter_row(table, words, start, entry, unit, remarks):
    low, high = entry["interval_90"] or (None, None)
    values = (start, entry["value"], low, high)
    cells = (
        table.number(words, column, value, None, unit)
        for column, value in zip(table.columns[1:5], values, strict=True)
    )
    return [words, *cells, "–" if unit == "1" else unit, remarks]


def reading_table(results: Results, data: Data) -> Table | None:
    """Every value beside the model, calibrated and as declared; None without values."""
    readings = results.validation["readings"]
    if not readings:
        return None
    runs = _runs(results)
    runs.pop("without_zone", None)
    columns = ["Quantity", "Load cell", "Fill height (m)", "Mass drawn (kg)"]
    columns += [f"Data, {results.label}: value", f"Data, {results.label}: sd"]
    for words in runs.values():
        columns += [f"Model, {words}: {name}" for name in ("mean", "se", "error", "in sd")]
    columns += ["Published simulation", "Used in calibration"]
    table = Table(
        "readings",
        parts(
            "The {} data beside the model. Error: model less value, in the unit of the quantity "
            "and in standard deviations of the value (sd). se: standard error of the model's mean "
            "over {} replicates.",
            results.label,
            data.number("readings", "", "replicates", results.count),
        ),
        columns,
        data,
    )
    for i, reading in enumerate(readings, start=1):
        row = f"{i}: {reading['quantity']} {reading['load_cell'] or 'whole base'}"
        places = decimals_of(reading["measured"])
        numbers = [
            (reading["fill_height"], None),
            (reading["mass_drawn"], None),
            (reading["measured"], places),
            (reading["measured_sd"], places),
        ]
        for run in runs:
            found = reading[run]
            numbers += [
                (found["mean"], places),
                (found["standard_error"], places),
                (found["error"], places),
                (found["error_in_sd"], 2),
            ]
        numbers.append((_published_value(results, reading), None))
        cells = zip(table.columns[2:-1], numbers, strict=True)
        table.rows.append(
            [
                quantity_words(reading["quantity"]),
                reading["load_cell"] or ("whole base" if results.experiment.load_cells else ""),
                *(table.number(row, column, *number) for column, number in cells),
                Badge("yes", "warn") if reading["used_in_calibration"] else "no",
            ]
        )
    return table.without_empty_columns()


def _runs(results: Results) -> dict[str, str]:
    """Key in validation.json and words of each run that was compared with the data."""
    overall = results.validation["overall"]
    words = {
        CALIBRATED: "calibrated" if DECLARED in overall else "as declared",
        DECLARED: "as declared",
        "without_zone": "without R and E_min",
    }
    return {run: words[run] for run in words if run in overall}


def _published_value(results: Results, reading: Mapping[str, Any]) -> float | None:
    published = results.validation["published"]
    height = results.experiment.geometry.height
    full = reading["load_cell"] is None and reading["fill_height"] in (None, height)
    if not published or not full or results.experiment.is_draw:
        return None
    key = {
        "vertical_stress": "vertical_stress_mean",
        "vertical_stress_spatial_std": "vertical_stress_std",
    }.get(reading["quantity"])
    return published.get(key)


def overall_table(results: Results, data: Data) -> Table | None:
    """Bias, mean absolute error and rmse by quantity, where one has several readings."""
    overall = results.validation["overall"]
    if not any(entry["n"] > 1 for entry in overall[CALIBRATED].values()):
        return None
    runs = _runs(results)
    table = Table(
        "overall",
        parts(
            "Errors over all values of a quantity in the {} data: model less value, in its unit "
            "and in standard deviations of the value.",
            results.label,
        ),
        [
            "Quantity, run",
            "Values",
            *(
                f"{group}: {name}"
                for group in ("Error", "Error in sd")
                for name in ("bias", "mean absolute", "rmse")
            ),
        ],
        data,
    )
    for quantity in QUANTITIES:
        for run, words in runs.items():
            entry = overall[run].get(quantity)
            if entry is None:
                continue
            numbers = [(entry["n"], 0)]
            for suffix, places in (("", None), ("_in_sd", 2)):
                numbers += [
                    (entry[f"{name}{suffix}"], places)
                    for name in ("bias", "mean_absolute_error", "rmse")
                ]
            table.add_numbers(f"{quantity_words(quantity)}, {words}", numbers)
    return table


def published_table(results: Results, data: Data) -> Table | None:
    """What was published beside the experiment, as published, and ours."""
    published = results.validation["published"]
    if not published:
        return None
    source = published["source"] or results.experiment.source
    table = Table(
        "published",
        parts(
            "Numbers as published ({}), and ours where they compare. {}", source, published["note"]
        ),
        ["Quantity", "Measured", "Simulated, published", "Ours", "Ours / published"],
        data,
    )
    between = published["measured_std_between"]
    ours, theirs = published.get("ours_mean"), published["vertical_stress_mean"]
    rows = (
        ("mean vertical stress (kPa)", published["measured_mean"], theirs, ours),
        (
            f"standard deviation (kPa){f', measured between {between}' if between else ''}",
            published["measured_std"],
            published["vertical_stress_std"],
            published.get("ours_std"),
        ),
    )
    for words, measured, simulated, own in rows:
        if any(value is not None for value in (measured, simulated)):
            ratio = own / simulated if own and simulated else None
            places = decimals_of(max(v for v in (measured, simulated, own) if v is not None))
            table.add_numbers(
                words, [(measured, places), (simulated, places), (own, places), (ratio, 3)]
            )
    error = published["mean_absolute_error"]
    if error is not None:
        entry = results.validation["overall"].get(CALIBRATED, {}).get("vertical_stress")
        own = entry["mean_absolute_error"] if entry else None
        table.add_numbers(
            "mean |experiment − simulation| (kPa)",
            [(None, None), (error, 2), (own, 2), (None, None)],
        )
    ours = published.get("ours_ratio_range") or (None, None)
    for words, theirs, own in zip(
        ("lowest", "highest"), published.get("ratio_range") or (), ours, strict=False
    ):
        table.add_numbers(
            f"{words} σᵥ/σᵥ₀ (measured: of all published scenarios)",
            [(theirs, 2), (None, None), (own, 2), (None, None)],
        )
    return table.without_empty_columns()


def fact_table(results: Results, data: Data) -> Table | None:
    """Published signs and orders of σᵥ/σᵥ₀ and whether they hold; None without any."""
    facts = (results.validation["published"] or {}).get("facts")
    if not facts:
        return None
    table = Table(
        "facts",
        parts(
            "Published signs and orders of σᵥ/σᵥ₀, and the mean over {} replicates. The published "
            "curves themselves are pictures: no value of them is compared.",
            data.number("facts", "", "replicates", results.count),
        ),
        [
            "Published",
            "Holds in the model",
            "Load cell",
            "Model: highest",
            "Model: at mass (kg)",
            "Model: lowest",
            "Model: last",
            f"Model: below {FALLEN:g} from (kg)",
            "Source",
        ],
        data,
    )
    for i, fact in enumerate(facts, start=1):
        words = fact["change"].replace("_", " ")
        holds = Badge("yes", "good") if fact["holds"] else Badge("no", "bad")
        for j, cell in enumerate(fact["load_cells"]):
            numbers = (
                (fact["highest"][j], 2),
                (fact["highest_at_mass_drawn"][j], None),
                (fact["lowest"][j], 2),
                (fact["last"][j], 2),
                (fact[f"falls_below_{FALLEN:g}_at_mass_drawn"][j], None),
            )
            cells = zip(table.columns[3:8], numbers, strict=True)
            table.rows.append(
                [
                    words if j == 0 else "",
                    holds if j == 0 else "",
                    cell,
                    *(table.number(f"{i}: {words} {cell}", c, *number) for c, number in cells),
                    fact["source"] if j == 0 else "",
                ]
            )
    return table


def setup_table(results: Results, data: Data) -> Table:
    """The declared inputs, those that are assumed flagged."""
    experiment, lattice = results.experiment, results.lattice
    g, m = experiment.geometry, experiment.material
    sizes = m.particle_size or (None, None)
    radius = results.calibration["derived"]["hydraulic_radius"]["value"]
    rows = (
        ("width along x", g.width, "m", "geometry.width"),
        ("length along y", g.length, "m", "geometry.length"),
        ("height", g.height, "m", "geometry.height"),
        ("diameter of the cylinder", g.diameter, "m", "geometry.mask"),
        ("cell size c", g.cell_size, "m", "geometry.cell_size"),
        ("cells along x", lattice.nx, "", "geometry"),
        ("cells along y", lattice.ny, "", "geometry"),
        ("cells along z", lattice.nz, "", "geometry"),
        ("hydraulic radius R_h of the base", radius, "m", "geometry"),
        (f"bulk density of {m.name}", m.bulk_density, "kg/m³", "material.bulk_density"),
        ("particle density", m.particle_density, "kg/m³", "material.particle_density"),
        ("smallest particle", sizes[0], "m", "material.particle_size"),
        ("largest particle", sizes[1], "m", "material.particle_size"),
        ("internal friction angle", m.internal_friction_angle, "°",
         "material.internal_friction_angle"),
        ("wall friction angle", experiment.walls and experiment.walls.friction_angle, "°",
         "walls.friction_angle"),
        *_effect_rows(experiment),
        *_replicate_rows(results),
        ("seed", experiment.seed, "", "seed"),
    )  # fmt: skip
    table = Table("setup", "Inputs as declared.", ["Input", "Value", "Unit", "Remarks"], data)
    for words, value, unit, key, *remark in rows:
        if value is not None:
            flag = ASSUMED if is_assumed(experiment, key) else remark
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            cell = table.number(words, "value", value, None, unit) if is_number else shown(value)
            table.rows.append([words, cell, unit, flag])
    return table.without_empty_columns()


def _replicate_rows(results: Results) -> Iterator[tuple]:
    """How many replicates were asked for, and with `stop_at` how many were enough."""
    experiment = results.experiment
    stop_at, asked = experiment.stop_at, experiment.replicates
    if stop_at is None:
        yield "replicates", asked, "", "replicates"
        return
    largest = float(results.statistics["vertical_stress_se"].max())
    reached = largest <= stop_at.standard_error
    badge = Badge("reached", "good") if reached else Badge("not reached", "bad")
    words = "standard error of a load cell's mean"
    yield "replicates, at most", asked, "", "replicates"
    yield f"{words} at which to stop", stop_at.standard_error, "kPa", "stop_at", badge
    yield f"{words}, the largest of this run", largest, "kPa", "statistics"
    yield "replicates of this run", results.count, "", "statistics"


def _effect_rows(experiment: Experiment) -> Iterator[tuple]:
    """The declared effects with all their values: words, value, unit, key."""
    for active in declared_effects(experiment):
        units = {p.name: p.unit for p in active.effect.parameters if p.unit != "1"}
        place = f" of {active.load_cell}" if active.load_cell else ""
        key = ".".join(filter(None, ("effects", active.name, active.load_cell)))
        for name, value in active.values.items():
            words = f"effect {active.name}{place}: {name}"
            yield words, value, units.get(name, ""), f"{key}.{name}"


def area_table(results: Results, data: Data) -> Table | None:
    """Drawpoints and load cells; None without any."""
    experiment = results.experiment
    columns = ["Name", "x (m)", "y (m)", "width (m)", "length (m)", "Kind", "Remarks"]
    table = Table("areas", "Drawpoints and load cells: centers and extents.", columns, data)
    for key, kind in (("drawpoints", "drawpoint"), ("load_cells", "load cell")):
        for area in getattr(experiment, key):
            values = (area.x, area.y, area.width, area.length)
            cells = zip(columns[1:5], values, strict=True)
            table.rows.append(
                [
                    area.name,
                    *(table.number(area.name, column, value) for column, value in cells),
                    kind,
                    ASSUMED if is_assumed(experiment, key) else "",
                ]
            )
    return table.without_empty_columns() if table.rows else None


def schedule_table(results: Results, data: Data) -> Table | None:
    """The draw schedule; None for a static experiment."""
    if not results.experiment.is_draw:
        return None
    factor, unit = results.mass_unit
    columns = ["Line", f"mass ({unit})", f"increment ({unit})", "Drawpoints, in turn"]
    table = Table("schedule", "Draw schedule, line after line.", columns, data)
    for i, line in enumerate(results.experiment.draw, start=1):
        table.rows.append(
            [
                table.number(f"line {i}", "line", i),
                table.number(f"line {i}", columns[1], factor * line.mass),
                table.number(f"line {i}", columns[2], factor * line.increment),
                ", ".join(line.drawpoints),
            ]
        )
    return table
