"""Tiny studies written to a folder, with readings that a known truth gives."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from specs import COLUMN, DRAWN, merged

from pipeline.config.experiment import Experiment
from pipeline.config.load import load_experiments, load_studies
from pipeline.config.measured import COLUMNS, MeasuredRow
from pipeline.config.study import Study
from pipeline.effects import Active, effects
from pipeline.files.atomic import read_json, write_json
from pipeline.lattice.block_model import build_block_model
from pipeline.loop.problem import Problem, make_problem, measured_rows
from pipeline.montecarlo.streams import FLOW, PACKING, random_stream
from pipeline.montecarlo.workers import Execution
from pipeline.observe import RowReader
from pipeline.parameters import declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup

NOISE = 0.02  # of a reading
WALLED = {  # columns of one material: width in m and wall friction angle in degrees
    "a": (0.3, 30),
    "b": (0.4, 15),
    "c": (0.6, 35),
    "d": (0.8, 20),
    "e": (1.2, 25),
}
LEVELS = (0.3, 0.6, None)  # fill heights of the readings, m; None: full
CELLS = [
    {"name": "west", "x": 0.1, "y": 0.2, "width": 0.2, "length": 0.4},
    {"name": "east", "x": 0.4, "y": 0.2, "width": 0.2, "length": 0.4},
]


@dataclass(frozen=True)
class World:
    """A study in its folder: `experiments/`, with `measured.csv`, and `studies/`."""

    folder: Path

    @property
    def experiments(self) -> dict[str, Experiment]:
        """Its experiments, from their files."""
        return load_experiments(self.folder / "experiments")

    @property
    def study(self) -> Study:
        """Its study, from its file."""
        (study,) = load_studies(self.folder / "studies", self.experiments).values()
        return study

    def problem(self, workers: int = 1) -> Problem:
        """The study taken apart."""
        return make_problem(self.study, self.experiments, Execution(workers))

    def measured(self) -> list[MeasuredRow]:
        """All rows of the table, in the model's order."""
        return measured_rows(self.study, self.experiments)

    def as_written(self, document: Mapping[str, Any]) -> dict[str, Any]:
        """What another job of the workflow reads of a document."""
        write_json(self.folder / "document.json", document)
        return read_json(self.folder / "document.json")

    def edit(self, change: Callable[[dict[str, str]], Mapping[str, Any] | None]) -> None:
        """Change rows of the measured table; a row for which `change` gives None stays."""
        path = self.folder / "experiments" / "measured.csv"
        with open(path, encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        changed = [row | {k: str(v) for k, v in (change(row) or {}).items()} for row in rows]
        assert changed != rows
        _write_table(path, changed)


def walled(width: float, angle: float, **changes) -> dict[str, Any]:
    """File of a column between walls, with room for wall friction."""
    walls = {
        "geometry": {"width": width, "length": width},
        "walls": {"friction_angle": angle},
        "filling": {"levels": [level for level in LEVELS if level]},
        "stress": {"E": 0.95},
    }
    return merged(merged(COLUMN, walls), changes)


def drawing(**changes) -> dict[str, Any]:
    """File of a small draw experiment with two load cells."""
    return merged(merged(COLUMN, DRAWN), changes)


def at_levels(**more) -> list[dict[str, Any]]:
    """Readings of the mean over the base at each fill height."""
    return [{"fill_height": level, "quantity": "vertical_stress", **more} for level in LEVELS]


def make_world(
    folder: Path,
    experiments: Mapping[str, Mapping[str, Any]],
    readings: Mapping[str, Sequence[Mapping[str, Any]]],
    study: Mapping[str, Any],
    truth: Mapping[str, Mapping[str, Any]] | None = None,
    noise: float = NOISE,
    seed: int = 1,
    true_E: float | None = None,
) -> World:
    """Write a study whose values are one packing of the truth, with independent errors.

    `truth` are the effects that act in truth and `true_E` is E in truth, neither of them declared;
    `noise` is the relative sd of the errors, declared as it is. `readings` are rows of the table
    for each experiment, without values.
    """
    (folder / "experiments").mkdir(parents=True)
    (folder / "studies").mkdir()
    for name, content in experiments.items():
        text = yaml.safe_dump(dict(content))
        (folder / "experiments" / f"{name}.yaml").write_text(text, encoding="utf-8")
    random = np.random.default_rng(seed)
    active = [Active(name, effects()[name].neutral | dict(v)) for name, v in (truth or {}).items()]
    rows = []
    for name, experiment in load_experiments(folder / "experiments").items():
        wanted = [_row(**row) for row in readings[name]]
        for row, value in zip(wanted, _true(experiment, wanted, active, true_E), strict=True):
            value *= 1.0 + noise * random.standard_normal()
            cells = vars(row) | {"experiment": name, "value": value, "std": noise * value}
            cells |= {"std_shared": row.std_shared * value}
            rows.append({k: "" if cells[k] is None else cells[k] for k in COLUMNS})
        path = folder / "experiments" / f"{name}.yaml"
        path.write_text(path.read_text("utf-8") + "measured: measured.csv\n", encoding="utf-8")
    _write_table(folder / "experiments" / "measured.csv", rows)
    (folder / "studies" / "tiny.yaml").write_text(yaml.safe_dump(dict(study)), encoding="utf-8")
    return World(folder)


def walled_world(folder: Path, names: str = "abcde", **changes) -> World:
    """Columns of different hydraulic radius and wall angle, read at three fill heights."""
    study = {
        "experiments": list(names),
        "hold_out": [names[-1]],
        "parameters": [{"name": "E", "shared_by": "material"}],
    } | changes.pop("study", {})
    experiments = {name: walled(*WALLED[name]) for name in names}
    readings = dict.fromkeys(names, at_levels())
    return make_world(folder, experiments, readings, study, **changes)


def mixed_world(folder: Path, **changes) -> World:
    """A static column and a draw of one material, all quantities among their readings."""
    study = {
        "experiments": ["drawn", "filled"],
        "hold_out": ["filled"],
        "parameters": [{"name": n, "shared_by": "material"} for n in ("E", "s", "R")],
    } | changes.pop("study", {})
    filled = merged(COLUMN, {"load_cells": CELLS, "filling": {"levels": [0.6]}})
    stress = {"quantity": "vertical_stress"}
    spread = {"quantity": "vertical_stress_spatial_std"}
    ratio = {"quantity": "vertical_stress_ratio", "load_cell": "above"}
    west, above = {"load_cell": "west", "count": 1}, {"load_cell": "above", "count": 1}
    readings = {
        "filled": [
            {**stress, **west, "fill_height": 0.6, "std_shared": 0.01},
            {**stress, **west, "std_shared": 0.01},
            {**stress, "load_cell": "east", "count": 5},
            {**stress},
            {**spread, "count": 5},
        ],
        "drawn": [
            {**stress, **above, "mass_drawn": 0.0},
            {**stress, **above, "mass_drawn": 8.0},
            {**stress, "load_cell": "beside", "mass_drawn": 8.0, "count": 5},
            {**ratio, "mass_drawn": 4.0},
            {"quantity": "movement_zone_height", "mass_drawn": 8.0, "count": 1},
        ],
    }
    experiments = {"drawn": drawing(), "filled": filled}
    return make_world(folder, experiments, readings, study, **changes)


def drawn_world(folder: Path, **changes) -> World:
    """One draw with two load cells, its end held out."""
    study = {
        "experiments": ["drawn"],
        "hold_out": {"mass_drawn_above": 8.0},
        "parameters": [{"name": "E", "shared_by": "study"}, {"name": "R", "shared_by": "study"}],
        "candidates": ["arching", "sensor_gain", "local_rule"],
    } | changes.pop("study", {})
    cells = [cell["name"] for cell in DRAWN["load_cells"]]
    masses = (0.0, 4.0, 8.0, 12.0)
    row = {"quantity": "vertical_stress", "count": 1}
    rows = [{"load_cell": cell, "mass_drawn": mass, **row} for cell in cells for mass in masses]
    return make_world(folder, {"drawn": drawing()}, {"drawn": rows}, study, **changes)


def _row(quantity: str, **given) -> MeasuredRow:
    nothing = {"load_cell": None, "fill_height": None, "mass_drawn": None, "count": None}
    empty = {"value": np.nan, "std": np.nan, "std_shared": 0.0, "line": 0}
    return MeasuredRow(**(nothing | empty | given | {"quantity": quantity}))


def _true(experiment, rows, active, true_E) -> np.ndarray:
    setup = make_setup(experiment, build_block_model(experiment), rows, effects=tuple(active))
    parameters = declared_parameters(experiment)
    if true_E is not None:
        parameters = parameters.with_values({"E": true_E})
    packing, flow = (random_stream(7, experiment.name, p, 0) for p in (PACKING, FLOW))
    reader = RowReader(setup, rows)
    values = reader.values(simulate(setup, parameters, packing, flow))
    return reader.sensed(values[None], replace(setup, effects=()))[0]  # sensors acted already


def _write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
