"""Effects fitted to measured and discrete-element data with scipy's least squares."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from pipeline.config.experiment import Experiment
from pipeline.config.load import check_measured, load_experiments
from pipeline.effects import Active, effects
from pipeline.montecarlo.parts import stack
from pipeline.montecarlo.replicates import replicates_dataset
from pipeline.montecarlo.streams import CALIBRATION_FLOW, CALIBRATION_PACKING, replicate_streams
from pipeline.observe import STRESS, simulated_rows
from pipeline.parameters import Parameters, declared_parameters
from pipeline.simulate.replicate import simulate
from pipeline.simulate.setup import make_setup

FOLDER = Path(__file__).parents[2] / "workflow_configs" / "experiments"


@cache
def experiments() -> dict[str, Experiment]:
    """Those of the repository."""
    return load_experiments(FOLDER)


class Case:
    """An experiment with its measured stresses, simulated on common random numbers."""

    def __init__(self, name: str, replicates: int = 1):
        self.experiment = experiments()[name]
        self.rows = [
            r
            for r in check_measured(self.experiment)
            if r.quantity in STRESS and (r.load_cell is None) != bool(self.experiment.load_cells)
        ]
        self.measured = np.array([row.value for row in self.rows])
        self.replicates = replicates
        source = self.experiment.stress.from_
        sources = {source: declared_parameters(experiments()[source])} if source else None
        self.parameters = declared_parameters(self.experiment, sources)
        self.setup = make_setup(self.experiment, rows=self.rows)
        if not self.experiment.is_draw:
            heights = {row.fill_height or self.experiment.geometry.height for row in self.rows}
            levels = tuple(h for h in self.setup.fill_levels if h in heights)
            self.setup = replace(self.setup, fill_levels=levels, true_levels=levels)

    def simulated(self, parameters: Parameters, active: Sequence[Active] = ()) -> np.ndarray:
        """Mean over replicates of each measured row."""
        setup = replace(self.setup, effects=tuple(active))
        readings = []
        for i in range(self.replicates):
            purposes = (CALIBRATION_PACKING, CALIBRATION_FLOW)
            streams = replicate_streams(self.experiment, i, purposes)
            readings.append(simulate(setup, parameters, *streams))
        dataset = replicates_dataset(setup, stack(readings))
        return simulated_rows(self.experiment, dataset, self.rows).mean(axis=0)


def on(name: str, **values) -> Active:
    """An effect that belongs to no load cell."""
    return Active(name, effects()[name].neutral | values)


def fit(residuals: Callable[[np.ndarray], np.ndarray], start, bounds, step=1e-4) -> np.ndarray:
    """The solution of a bounded least-squares problem."""
    return least_squares(residuals, start, bounds=bounds, diff_step=step, x_scale="jac").x


def rms(values) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
