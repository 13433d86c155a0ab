"""Rule grade: the extraction record to grade and dilution curves, `grade.nc` and `grade.csv`."""

from pipeline.config.load import load_experiment
from pipeline.files.grade_table import write_grade_table
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.montecarlo.grade import grade_curves
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
experiment = load_experiment(snakemake.params.file)
sources = [snakemake.input.block_model, snakemake.input.replicates]
write_dataset(
    snakemake.output.grade,
    grade_curves(experiment, *map(read_dataset, sources)),
    experiment,
    "grade",
    "Grade and dilution curves",
    sources,
    statistics=True,
)
write_grade_table(read_dataset(snakemake.output.grade), experiment.name, snakemake.output.table)
