"""Rule comparison_report: `comparison.json` to `report.html` and `report_data.csv`."""

from pipeline.files.atomic import read_json
from pipeline.report.comparison import write_comparison_report
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
write_comparison_report(
    read_json(snakemake.input.numbers), snakemake.output.report, snakemake.output.data
)
