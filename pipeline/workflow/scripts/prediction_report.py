"""Rule prediction_report: a prediction to `prediction.html` and `prediction_data.csv`."""

from pipeline.config.load import load_experiment
from pipeline.files.atomic import read_json
from pipeline.files.netcdf import read_dataset
from pipeline.report.prediction import write_prediction_report
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
write_prediction_report(
    load_experiment(snakemake.params.file),
    read_dataset(snakemake.input.samples),
    read_json(snakemake.input.numbers),
    snakemake.output.report,
    snakemake.output.data,
)
