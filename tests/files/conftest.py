"""Small experiments and their files: filled, drawn, and drawn in a mine's coordinates."""

import pytest
from specs import MINE_ORIGIN

from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.lattice.block_model import build_block_model
from pipeline.montecarlo.grade import grade_curves
from pipeline.montecarlo.replicates import run_experiment
from pipeline.montecarlo.statistics import replicate_statistics
from pipeline.parameters import declared_parameters
from pipeline.simulate.setup import make_setup

KINDS = ("static", "draw")
REGIONS = [
    {"name": "ore", "box": {"z": [0, 0.8]}, "grade": {"Au": {"value": 1.5, "unit": "g/t"}}},
    {"name": "cap", "box": {"z": [0.4, 0.8]}, "bulk_density": 1400, "waste": True},
]


@pytest.fixture(scope="session")
def written(column, drawn, tmp_path_factory):
    """written(kind): the experiment and the folder with its four files."""
    done = {}

    def write(kind):
        if kind in done:
            return done[kind]
        folder = tmp_path_factory.mktemp(kind)
        material = {"particle_size": [4e-3, 14e-3]}
        if kind == "static":
            experiment = column(
                geometry={
                    "width": 0.52,
                    "length": 0.5,
                    "height": 0.95,
                    "mask": {"type": "cylinder"},
                },
                filling={"levels": [0.3]},
                material=material,
                keep_fields=True,
            )
        elif kind == "draw":
            experiment = drawn(material=material)
        elif kind == "regions":
            experiment = drawn("regions", geometry={"mask": {"type": "cylinder"}}, regions=REGIONS)
        else:
            experiment = drawn("mine", geometry={"origin": MINE_ORIGIN}, keep_fields=True)
        model = build_block_model(experiment)
        setup = make_setup(experiment, model)
        declared = declared_parameters(experiment)
        used = declared if kind == "static" else declared.with_values({"s": 2.0})
        replicates, fields = run_experiment(setup, used, declared)
        block_model, runs = folder / "block_model.nc", folder / "replicates.nc"
        write_dataset(
            block_model, model, experiment, "block_model", "Block model", attributes=model.attrs
        )
        write_dataset(runs, replicates, experiment, "replicates", "Replicates", [block_model])
        write_dataset(
            folder / "fields.nc", fields, experiment, "replicates", "Fields", [block_model]
        )
        write_dataset(
            folder / "statistics.nc",
            replicate_statistics(read_dataset(runs)),
            experiment,
            "aggregate",
            "Statistics",
            [runs],
            statistics=True,
        )
        if experiment.has_grade_curves:
            curves = grade_curves(experiment, read_dataset(block_model), read_dataset(runs))
            write_dataset(
                folder / "grade.nc", curves, experiment, "grade", "Grade", [runs], statistics=True
            )
        done[kind] = experiment, folder
        return done[kind]

    return write


@pytest.fixture(params=KINDS)
def folder(request, written):
    """Folder of each experiment that has no mine coordinates."""
    return written(request.param)[1]
