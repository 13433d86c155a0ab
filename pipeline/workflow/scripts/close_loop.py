"""Rule close_loop: held-out errors to `closed_loop.json`, the improved model to `improved/`."""

from pathlib import Path

from pipeline.config.load import load_study
from pipeline.files.atomic import read_json, write_json, write_text
from pipeline.files.netcdf import read_dataset
from pipeline.loop.documents import point_from
from pipeline.loop.improved import improved_documents
from pipeline.loop.problem import load_problem, measured_rows
from pipeline.loop.steps import closed
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
study = load_study(snakemake.params.study)
problem, experiments = load_problem(study, snakemake.params.experiments, snakemake.threads)
found = read_json(snakemake.input.attribution)
baseline = read_dataset(snakemake.input.baseline)
document, predictions = closed(problem, measured_rows(study, experiments), baseline, found)
folder = Path(snakemake.output.closed_loop).parent / "improved"
final = point_from(found["final"]["point"])
for name, text in improved_documents(study, problem.model, final, folder).items():
    write_text(folder / f"{name}.yaml", text)
write_json(snakemake.output.predictions, predictions)
write_json(snakemake.output.closed_loop, document)
