"""Rule aggregate: `replicates.nc` to `statistics.nc` and `base_stress.csv`."""

from pathlib import Path

from pipeline.config.load import load_experiment
from pipeline.files.base_stress import NEEDED, write_base_stress
from pipeline.files.netcdf import write_dataset
from pipeline.files.results import Results
from pipeline.montecarlo.statistics import replicate_statistics
from pipeline.workflow.job import log_to

log_to(snakemake.log[0])
results = Results(Path(snakemake.input.replicates).parent, NEEDED)
write_dataset(
    snakemake.output.statistics,
    replicate_statistics(results["replicates"]),
    load_experiment(snakemake.params.file),
    "aggregate",
    "Statistics over replicates",
    [snakemake.input.replicates],
    statistics=True,
)
write_base_stress(results, snakemake.output.base_stress)
