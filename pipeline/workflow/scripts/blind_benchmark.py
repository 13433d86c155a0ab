"""Rule blind_benchmark: what the loop said of blind worlds against their truths, and a page."""

from pathlib import Path

from pipeline.blind.benchmark import score_benchmark
from pipeline.report.blind import write_blind_report
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
scores = score_benchmark(Path(snakemake.input.runs).parent)
write_blind_report(scores, snakemake.output.report, snakemake.output.data)
