"""Rules export_*: an experiment's results to files that other tools open."""

from pathlib import Path

from pipeline.files.export import export
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
export(Path(snakemake.input.block_model).parent, snakemake.params.to, snakemake.output[0])
