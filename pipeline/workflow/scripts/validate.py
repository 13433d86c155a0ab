"""Rule validate: simulated against measured and published values, to `validation.json`."""

from pipeline.config.load import check_measured, load_experiment
from pipeline.files.atomic import read_json, write_json
from pipeline.files.netcdf import read_dataset
from pipeline.validate.validation import validate
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
experiment = load_experiment(snakemake.params.file)
validation = validate(
    experiment,
    read_dataset(snakemake.input.replicates),
    read_json(snakemake.input.calibration),
    check_measured(experiment),
)
write_json(snakemake.output.validation, validation)
