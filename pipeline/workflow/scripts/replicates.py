"""Rule replicates: Monte Carlo replicates to `replicates.nc` and `fields.nc`."""

from pipeline.config.load import check_measured, load_experiment
from pipeline.files.atomic import read_json
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.montecarlo.checkpoints import Checkpoints
from pipeline.montecarlo.replicates import run_experiment
from pipeline.montecarlo.workers import Execution
from pipeline.parameters import Parameters
from pipeline.sensitivity.footprints import load_cell_footprint
from pipeline.simulate.setup import make_setup
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
experiment = load_experiment(snakemake.params.file)
block_model = snakemake.input.block_model
setup = make_setup(experiment, read_dataset(block_model), check_measured(experiment))
calibration = read_json(snakemake.input.calibration)
used, declared = (
    Parameters.from_document(calibration[key]) for key in ("parameters_used", "declared")
)
execution = Execution(snakemake.threads, snakemake.resources.dask_scheduler)
checkpoints = Checkpoints(
    snakemake.params.checkpoints, snakemake.params.code + snakemake.params.effects
)
replicates, fields = run_experiment(setup, used, declared, execution, checkpoints)
replicates["load_cell_footprint"] = load_cell_footprint(setup, used, Execution(snakemake.threads))
for path, dataset, title in (
    (snakemake.output.fields, fields, "Fields over replicates"),
    (snakemake.output.replicates, replicates, "Replicates"),
):
    write_dataset(path, dataset, experiment, "replicates", title, [block_model])
