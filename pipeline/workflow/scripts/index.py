"""Rule index: every experiment's results to `index.html` and `index.json`."""

from pipeline.config.load import load_experiment
from pipeline.report.index import write_index
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
write_index(
    [load_experiment(file) for file in snakemake.params.files],
    snakemake.input.calibrations,
    snakemake.input.validations,
    snakemake.input.reports,
    snakemake.input.flow_law,
    snakemake.output.index,
    snakemake.output.numbers,
    dict(zip(snakemake.params.studies, snakemake.input.studies, strict=True)),
    snakemake.input.comparisons,
    snakemake.params.blind_scores[0] if snakemake.params.blind_scores else None,
)
