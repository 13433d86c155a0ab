"""Rule report: an experiment's results to `report.html` and `report_data.csv`."""

from pipeline.config.load import load_experiment
from pipeline.report.experiment import write_report
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
write_report(
    load_experiment(snakemake.params.file),
    {name: file for name, file in snakemake.input.items() if file},
    snakemake.output.report,
    snakemake.output.data,
)
