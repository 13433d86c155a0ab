"""Rule calibrate: measured rows to `calibration.json`."""

from pipeline.calibrate.calibration import calibrate
from pipeline.calibrate.carried import carried_statements
from pipeline.config.load import check_measured, load_experiment
from pipeline.files.atomic import read_json, write_json
from pipeline.files.netcdf import read_dataset
from pipeline.montecarlo.workers import Execution, crew
from pipeline.parameters import Parameters, declared_parameters
from pipeline.simulate.setup import make_setup
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
experiment = load_experiment(snakemake.params.file)
rows = check_measured(experiment)
setup = make_setup(experiment, read_dataset(snakemake.input.block_model), rows)
sources = [read_json(path) for path in snakemake.input.sources]
declared = declared_parameters(
    experiment,
    {s["experiment"]: Parameters.from_document(s["parameters_used"]) for s in sources},
)
execution = Execution(snakemake.threads, snakemake.resources.dask_scheduler)
with crew(execution, experiment.name):  # one session of a cluster for all that is evaluated
    document = calibrate(experiment, setup, declared, rows, execution)
for source in sources:
    document["messages"] += carried_statements(experiment, source, declared)
write_json(snakemake.output.calibration, document)
