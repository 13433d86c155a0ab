"""The page of a comparison made up by hand, by the same calls as the rules."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from pipeline.compare.comparison import compare
from pipeline.config.comparison import Comparison
from pipeline.config.experiment import Experiment
from pipeline.files.atomic import read_json, write_json
from pipeline.report.comparison import write_comparison_report


@dataclass(frozen=True)
class MadeComparison:
    """A comparison's page and the files beside it."""

    folder: Path

    @property
    def html(self) -> str:
        """The page."""
        return (self.folder / "report.html").read_text("utf-8")

    @property
    def data(self) -> str:
        """The data beside the page."""
        return (self.folder / "report_data.csv").read_text("utf-8")


def make_comparison(first: Experiment, second: Experiment, folder: Path, **about) -> MadeComparison:
    """The page for stresses of two experiments that fall at different times, three replicates."""
    mass = np.array([0.0, 4.0, 8.0, 12.0])
    scatter = np.linspace(0.98, 1.02, 3)[:, None, None]
    sides = []
    for falls in ([500.0, 400.0, 200.0, 150.0], [500.0, 250.0, 180.0, 160.0]):
        stress = scatter * np.array(falls)[:, None] * np.linspace(0.9, 1.1, len(first.load_cells))
        sides.append(
            xr.Dataset(
                {
                    "vertical_stress": (("replicate", "time", "load_cell"), stress),
                    "base_vertical_stress": (("replicate", "time"), stress.mean(axis=2)),
                    "mass_drawn": ("time", mass),
                }
            )
        )
    pair = first.name, second.name
    comparison = Comparison(experiments=pair, threshold_mpa=0.3, **about)
    numbers = folder / "comparison.json"
    write_json(numbers, compare(comparison.at(folder / "two.yaml"), [first, second], sides))
    write_comparison_report(read_json(numbers), folder / "report.html", folder / "report_data.csv")
    return MadeComparison(folder)
