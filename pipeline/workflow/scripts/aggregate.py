"""Rule aggregate: `replicates.nc` to `statistics.nc`."""

from pipeline.config.load import load_experiment
from pipeline.files.netcdf import read_dataset, write_dataset
from pipeline.montecarlo.statistics import replicate_statistics
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
experiment = load_experiment(snakemake.params.file)
replicates = snakemake.input.replicates
statistics = replicate_statistics(read_dataset(replicates))
write_dataset(
    snakemake.output.statistics,
    statistics,
    experiment,
    "aggregate",
    "Statistics over replicates",
    [replicates],
    statistics=True,
)
