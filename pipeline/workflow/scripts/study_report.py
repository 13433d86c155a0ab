"""Rule study_report: a study's results to `report.html` and `report_data.csv`."""

from pipeline.config.load import load_study
from pipeline.report.study import write_study_report
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
write_study_report(
    load_study(snakemake.params.study),
    dict(snakemake.input.items()),
    snakemake.output.report,
    snakemake.output.data,
)
