"""Rule blind_worlds: blind worlds, and the loop on each without its truth, to `runs.json`."""

from pathlib import Path

from pipeline.blind.loops import run_worlds
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
run_worlds(
    Path(snakemake.output.runs).parent,
    snakemake.params.worlds,
    snakemake.params.hard_nulls,
    snakemake.params.attacks,
    snakemake.params.seed,
    snakemake.threads,
    snakemake.params.code,
)
