"""The files of one experiment's results, opened for its page."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from pipeline.config.experiment import Experiment, LoadCell
from pipeline.config.measured import QUANTITIES
from pipeline.effects import as_filled
from pipeline.files.atomic import read_json
from pipeline.lattice.block_model import lattice_of
from pipeline.lattice.grid import Lattice
from pipeline.parameters import Parameters
from pipeline.report.page import Badge
from pipeline.report.plan_figures import evenly, mass_unit
from pipeline.simulate.setup import load_cells
from pipeline.validate.validation import CALIBRATED

ASSUMED = Badge("assumed", "warn")
MANY_LOAD_CELLS = 12  # beyond them a map and a table stand for a panel of each
MOST_PANELS = 7  # of single load cells, where there are many


@dataclass(frozen=True)
class Results:
    """What the rules before the report wrote; the datasets read from disk what is asked for.

    `base_stress` holds the load cells' rows of `base_stress.csv`; `grade` is None where nothing
    that is drawn has a grade or a dilution.
    """

    experiment: Experiment
    calibration: Mapping[str, Any]
    validation: Mapping[str, Any]
    replicates: xr.Dataset
    statistics: xr.Dataset
    fields: xr.Dataset
    block_model: xr.Dataset
    base_stress: Sequence[Mapping[str, str]]
    grade: xr.Dataset | None = None

    @property
    def lattice(self) -> Lattice:
        """The lattice of the experiment, as high as it truly was filled."""
        return lattice_of(as_filled(self.experiment))

    @property
    def load_cells(self) -> tuple[LoadCell, ...]:
        """The load cells in the order of the files."""
        return load_cells(self.experiment)

    @property
    def has_many_load_cells(self) -> bool:
        """Whether they are too many for a panel each, as the pillars of a mine are."""
        return len(self.load_cells) > MANY_LOAD_CELLS

    @property
    def shown_load_cells(self) -> list[int]:
        """Indices of the load cells that get a panel each: all, or a few where they are many."""
        count = len(self.load_cells)
        return evenly(count, MOST_PANELS if self.has_many_load_cells else count)

    @property
    def words_of_shown(self) -> str:
        """What a caption says where not all load cells have a panel; else nothing."""
        if not self.has_many_load_cells:
            return ""
        return (
            f" Shown are {len(self.shown_load_cells)} of the {len(self.load_cells)} load cells; "
            "the map of the base has all of them."
        )

    @property
    def parameters(self) -> Parameters:
        """Those that the replicates ran with."""
        return Parameters.from_document(self.calibration["parameters_used"])

    @property
    def is_calibrated(self) -> bool:
        """Whether any parameter was fitted."""
        return any(entry["calibrated"] for entry in self.calibration["parameters"].values())

    @property
    def count(self) -> int:
        """Number of replicates."""
        return self.replicates.sizes["replicate"]

    @property
    def label(self) -> str:
        """What the data are, as the experiment labels them."""
        return self.experiment.data_label

    @property
    def clock(self) -> np.ndarray:
        """Mass drawn (kg), or fill height (m) of a static experiment, at each reading."""
        return self.replicates["mass_drawn" if self.experiment.is_draw else "fill_height"].values

    @property
    def mass_unit(self) -> tuple[float, str]:
        """Factor from kg and unit in which the masses of a draw experiment read well."""
        return mass_unit(self.experiment.mass_scheduled)

    @property
    def drawn(self) -> np.ndarray:
        """Mass drawn at each reading, in that unit."""
        return self.mass_unit[0] * self.clock

    @property
    def at_rest(self) -> int:
        """Index of the reading with the model full and nothing drawn."""
        return 0 if self.experiment.is_draw else len(self.clock) - 1

    @property
    def section_row(self) -> int:
        """Index along y of the x-z sections: the middle, or the drawpoint nearest to it."""
        y = self.fields["y"].values
        middle = 0.5 * self.experiment.geometry.length
        centers = [point.y for point in self.experiment.drawpoints]
        at = min(centers, key=lambda center: abs(center - middle), default=middle)
        return int(np.argmin(np.abs(y - at - 1e-9)))

    def section(self, name: str, time: int) -> np.ndarray:
        """A field on (z, x) at `section_row`."""
        return self.fields[name].isel(time=time, y=self.section_row).values

    def section_in_file(self, name: str, time: int) -> str:
        """Where the cells of `section` stand, for the data beside the page."""
        return f"fields.nc: {name}[time={time}, y={self.section_row}]"

    def base(self, name: str, time: int) -> np.ndarray:
        """A field on (y, x) in the lowest level of cells."""
        return self.fields[name].isel(time=time, z=0).values

    def base_in_file(self, name: str, time: int) -> str:
        """Where the cells of `base` stand, likewise."""
        return f"fields.nc: {name}[time={time}, z=0]"

    def readings(self, quantity: str, load_cell: str | None = None) -> list[Mapping[str, Any]]:
        """Measured values of a quantity at a load cell (None: of the whole base) beside ours."""
        return [
            reading
            for reading in self.validation["readings"]
            if reading["quantity"] == quantity and reading["load_cell"] == load_cell
        ]


@contextmanager
def open_results(experiment: Experiment, files: Mapping[str, str | Path]) -> Iterator[Results]:
    """Results of an experiment from its files by their names in the rule `report`."""
    with ExitStack() as stack:

        def opened(name: str) -> xr.Dataset:
            dataset = xr.open_dataset(files[name], engine="netcdf4", decode_times=False)
            return stack.enter_context(dataset)

        names = ("replicates", "statistics", "fields", "block_model")
        documents = (read_json(files[name]) for name in ("calibration", "validation"))
        with open(files["base_stress"], encoding="utf-8", newline="") as table:
            rows = [row for row in csv.DictReader(table) if row["place"] == "load_cell"]
            grade = opened("grade") if "grade" in files else None
            yield Results(experiment, *documents, *map(opened, names), rows, grade)


QUANTITY_WORDS = {
    "vertical_stress": "vertical stress",
    "vertical_stress_ratio": "vertical stress over that before draw",
    "vertical_stress_spatial_std": "sd of vertical stress from place to place",
    "movement_zone_height": "movement zone height",
    "movement_zone_width": "movement zone width",
}


def quantity_words(quantity: str) -> str:
    """A quantity with its unit for a reader."""
    unit = QUANTITIES[quantity]
    words = QUANTITY_WORDS[quantity]
    return words if unit == "1" else f"{words} ({unit})"


THRESHOLD_SD = 2.0
THRESHOLD_SHARE = 0.95


@dataclass(frozen=True)
class Agreement:
    """How many of `count` readings lie within `THRESHOLD_SD` measured standard deviations.

    `worst` is the largest |error| in standard deviations. Readings agree when their share within
    is `THRESHOLD_SHARE` or more.
    """

    count: int
    within: int
    worst: float

    @property
    def agrees(self) -> bool:
        """The verdict."""
        return self.within >= THRESHOLD_SHARE * self.count


def agreement(validation: Mapping[str, Any], run: str) -> Agreement | None:
    """Agreement of a run, `CALIBRATED` or `DECLARED`, with the readings; None without them.

    Where calibration changed nothing, both runs are the same.
    """
    errors = [
        abs(reading.get(run, reading[CALIBRATED])["error_in_sd"])
        for reading in validation["readings"]
    ]
    if not errors:
        return None
    return Agreement(len(errors), sum(e <= THRESHOLD_SD for e in errors), max(errors))


def is_assumed(experiment: Experiment, key: str) -> bool:
    """Whether a key, one above it or one below it is declared as assumed."""
    return any(
        key == entry or key.startswith(f"{entry}.") or entry.startswith(f"{key}.")
        for entry in experiment.assumed
    )
