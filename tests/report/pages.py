"""Pages of tiny experiments, made by the same calls as the rules."""

import csv
import re
from dataclasses import dataclass
from pathlib import Path

from pipeline.calibrate.calibration import calibrate
from pipeline.config.experiment import Experiment
from pipeline.config.measured import MeasuredRow
from pipeline.files.atomic import write_json
from pipeline.files.base_stress import NEEDED, write_base_stress
from pipeline.files.grade_table import write_grade_table
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.files.results import Results
from pipeline.lattice.block_model import build_block_model
from pipeline.montecarlo.grade import grade_curves
from pipeline.montecarlo.replicates import run_experiment
from pipeline.montecarlo.statistics import replicate_statistics
from pipeline.parameters import Parameters, declared_parameters
from pipeline.report.experiment import write_report
from pipeline.simulate.setup import make_setup
from pipeline.validate.validation import validate


@dataclass(frozen=True)
class Made:
    """An experiment's results and its page, all in `folder`."""

    experiment: Experiment
    inputs: dict[str, Path]
    folder: Path

    @property
    def html(self) -> str:
        """The page."""
        return (self.folder / "report.html").read_text("utf-8")

    @property
    def rows(self) -> list[dict[str, str]]:
        """The data beside the page."""
        with open(self.folder / "report_data.csv", encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    def series(self, figure: str, series: str, panel: str | None = None) -> list[tuple]:
        """(x, y) of a series of the data, as numbers."""
        return [
            (float(row["x"]), float(row["y"]))
            for row in self.rows
            if (row["figure"], row["series"]) == (figure, series) and panel in (None, row["panel"])
        ]


def shown_numbers(html: str) -> list[str]:
    """Values of the numbers that stand on a page."""
    return re.findall(r'<data value="([^"]*)">', html)


def row(quantity="vertical_stress", value=9.0, std=0.4, **changes) -> MeasuredRow:
    """A measured row of the whole base, changed key by key."""
    given = dict.fromkeys(("load_cell", "fill_height", "mass_drawn", "count"))
    given |= {"std_shared": 0.0, "line": 1} | changes
    return MeasuredRow(quantity=quantity, value=value, std=std, **given)


def make_page(experiment: Experiment, rows, folder: Path) -> Made:
    """Results and page of an experiment."""
    files = {name: folder / f"{name}.nc" for name in ("block_model", "replicates", "fields")}
    files["statistics"] = folder / "statistics.nc"
    files["base_stress"] = folder / "base_stress.csv"
    files |= {name: folder / f"{name}.json" for name in ("calibration", "validation")}
    model = build_block_model(experiment)
    write_dataset(files["block_model"], model, experiment, "block_model", "Block model")
    setup = make_setup(experiment, model, rows)
    calibration = calibrate(experiment, setup, declared_parameters(experiment), rows)
    write_json(files["calibration"], calibration)
    parameters = (
        Parameters.from_document(calibration[key]) for key in ("parameters_used", "declared")
    )
    replicates, fields = run_experiment(setup, *parameters)
    write_dataset(files["replicates"], replicates, experiment, "replicates", "Replicates")
    write_dataset(files["fields"], fields, experiment, "replicates", "Fields")
    statistics = replicate_statistics(read_dataset(files["replicates"]))
    write_dataset(
        files["statistics"], statistics, experiment, "aggregate", "Statistics", statistics=True
    )
    write_base_stress(Results(folder, NEEDED), files["base_stress"])
    document = validate(experiment, read_dataset(files["replicates"]), calibration, rows)
    write_json(files["validation"], document)
    if experiment.has_grade_curves:
        files |= {"grade": folder / "grade.nc", "grade_table": folder / "grade.csv"}
        sources = (read_dataset(files[name]) for name in ("block_model", "replicates"))
        curves = grade_curves(experiment, *sources)
        write_dataset(files["grade"], curves, experiment, "grade", "Grade", statistics=True)
        write_grade_table(curves, experiment.name, files["grade_table"])
    write_report(experiment, files, folder / "report.html", folder / "report_data.csv")
    return Made(experiment, files, folder)
