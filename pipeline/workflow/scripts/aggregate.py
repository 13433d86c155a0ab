"""Rule aggregate: `replicates.nc` to `statistics.nc` and `base_stress.csv`."""

from pipeline.config.load import load_experiment
from pipeline.files.atomic import write_text
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.montecarlo.base_stress import COLUMNS, as_csv, base_stress_rows
from pipeline.montecarlo.statistics import replicate_statistics
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
experiment = load_experiment(snakemake.params.file)
replicates = read_dataset(snakemake.input.replicates)
write_dataset(
    snakemake.output.statistics,
    replicate_statistics(replicates),
    experiment,
    "aggregate",
    "Statistics over replicates",
    [snakemake.input.replicates],
    statistics=True,
)
write_text(snakemake.output.base_stress, as_csv(COLUMNS, base_stress_rows(replicates)))
