"""Rule improved: the improved experiments run beside the baseline, to `improved.json`."""

from pathlib import Path

from pipeline.config.load import load_study
from pipeline.files.atomic import read_json, write_json
from pipeline.loop.problem import load_problem, measured_rows
from pipeline.loop.verify import improved_runs, rows_by_experiment
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
study = load_study(snakemake.params.study)
problem, experiments = load_problem(study, snakemake.params.experiments, snakemake.threads)
document = improved_runs(
    problem,
    read_json(snakemake.input.attribution),
    Path(snakemake.input.closed_loop).parent / "improved",
    rows_by_experiment(study, problem, measured_rows(study, experiments)),
    problem.model.execution,
)
write_json(snakemake.output.improved, document)
